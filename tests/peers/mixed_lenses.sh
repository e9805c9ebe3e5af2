#!/usr/bin/env bash
# mixed_lenses.sh HDRIG OUT - three kinds of camera in one simulated rig, of other sizes and focal
# lengths, k1 from -0.35 to 0.1, one a fisheye of 150 degrees; 8 and 18 views, of which nothing is
# known but the names of the cameras in EXIF data. Prints how well lenses and poses are found, and
# the quality of held-back photographs as taken: with the lenses found, known, and ignored; beside
# them the same world through straight lenses, found and known.
# VIEWS="8 18", EDGE=1600 (px), SEED=31 and STEPS=300 are changed in the environment.
set -euo pipefail
[ $# = 2 ] || { echo "usage: $0 HDRIG OUT" >&2; exit 2; }
hdrig=$(realpath "$1")
here=$(dirname "$(realpath "$0")")
edge=${EDGE:-1600}
low=$((edge * 3 / 4)) side=$((edge * 7 / 8))
wide=${edge}x$low tall=${low}x$edge square=${side}x$side
mkdir -p "$2"
cd "$2"

make() { # name views lens...
    local name=$1 views=$2 lens
    local rig=(--kind room --seed "${SEED:-31}" --views "$views" --samples 1 --spread 0.5)
    shift 2
    for lens in "$@"; do rig+=(--lens "$lens"); done
    [ -d "$name" ] || "$hdrig" simulate "${rig[@]}" --exposures 0.25,1,4 --out "$name" &>/dev/null
}

quality() { # name what arguments...
    local name=$1 what=$2 figures
    figures=$name-${what// /-}.json
    shift 2
    rm -f "$figures"
    "$hdrig" eval --data "$name" --protocol native --refine "${STEPS:-300}" --model none \
        --json "$figures" "$@" >/dev/null 2>"$name.txt" || tail -n 1 "$name.txt"
    [ -e "$figures" ] || return 0
    printf '%s %s: PSNR %s\n' "$name" "$what" "$(sed -n '/"ldr": {/,$p' "$figures" |
        sed -n 's/.*"psnr": \([-0-9.e+]*\).*/\1/p' | head -n 1)"
}

for views in ${VIEWS:-8 18}; do
    make "mixed$views" "$views" "k1=-0.35,k2=0.1,fov=75,size=$wide" \
        "k1=0.1,fov=50,size=$tall" "fisheye,k1=-0.02,fov=150,size=$square"
    make "straight$views" "$views" "fov=75,size=$wide" "fov=50,size=$tall" \
        "fov=90,size=$square"
    "$hdrig" reconstruct --images "mixed$views" --rig none --refine 0 --model none --force \
        --out "scene$views" >/dev/null 2>"scene$views.txt" || tail -n 1 "scene$views.txt"
    python3 "$here/lens_truth.py" --truth "mixed$views/sparse/0" \
        --cameras "scene$views/cameras.json" || true
    quality "straight$views" known
    quality "straight$views" found --rig none
    quality "mixed$views" known
    quality "mixed$views" found --rig none
    quality "mixed$views" ignored --rig none --set cameras.lens=pinhole
done
