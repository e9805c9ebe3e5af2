#!/usr/bin/env bash
# rig.sh HDRIG OUT - what a calibrated rig is worth: rigs of 4, 8 and 16 simulated cameras, hung by
# hand, are calibrated from two takes in two rooms; in two other rooms scenes are made with the
# calibration, with the true cameras, and with cameras that are searched. Prints errors of the
# calibration, seconds for the cameras, and PSNR of held-back views, aligned as in the paper's
# protocol. CAMERAS="4 8 16" and STEPS="0 150" are changed in the environment.
set -euo pipefail
[ $# = 2 ] || { echo "usage: $0 HDRIG OUT" >&2; exit 2; }
hdrig=$(realpath "$1")
here=$(dirname "$(realpath "$0")")
mkdir -p "$2"
cd "$2"

world() { # name seed arguments...
    local name=$1 seed=$2
    shift 2
    [ -d "$name" ] || "$hdrig" simulate --kind room --seed "$seed" --samples 1 --spread 0.4 \
        --exposures 0.0625,0.25,1,4 --out "$name" "$@" &>/dev/null
}

scene() { # world what steps rig
    "$hdrig" reconstruct --images "$1" --rig "$4" --model none --refine "$3" --force --out scene \
        >/dev/null 2>scene.txt || { tail -n 1 scene.txt; return; }
    "$hdrig" eval --data "$1" --protocol native --scene scene --rig none --json eval.json \
        &>/dev/null
    printf '%s %s, %s steps: PSNR %.2f dB, cameras %.2f s\n' "$1" "$2" "$3" \
        "$(sed -n '/"ldr": {/,$p' eval.json | sed -n 's/.*"psnr": \([-0-9.e+]*\).*/\1/p' |
            head -n 1)" \
        "$(sed -n '/"seconds": {/,$s/.*"cameras": \([-0-9.e+]*\).*/\1/p' scene/report.json)"
    rm eval.json
}

for n in ${CAMERAS:-4 8 16}; do
    world "first$n" 401 --views "$n" --free-hand
    "$hdrig" rig calibrate "first$n" --out "truth$n.json" &>/dev/null
    for seed in 402 403 404 405; do
        world "room$seed-$n" $seed --rig "truth$n.json"
    done
    "$hdrig" rig calibrate "room402-$n" "room403-$n" --out "rig$n.json" 2>/dev/null | head -n 1
    python3 "$here/colmap_pose.py" --truth "room404-$n/sparse/0" --cameras "rig$n.json"
    for seed in 404 405; do
        for steps in ${STEPS:-0 150}; do
            scene "room$seed-$n" true "$steps" "room$seed-$n/sparse/0"
            scene "room$seed-$n" calibrated "$steps" "rig$n.json"
            scene "room$seed-$n" searched "$steps" none
        done
    done
done
