#!/usr/bin/env bash
# board.sh HDRIG OUT - what a printed board is worth: rigs of 4 and 16 simulated cameras on an arc,
# calibrated from 5 and 10 takes of a moved board on A3, with the board (--tag 55) and without it
# (--no-board: from points alone, up to scale); and a rig of 4 cameras that look 35 degrees away
# from each other, from 6 and 12 takes. Prints errors against the truth. Takes come in turn, each in
# another room. RIGS="arc4 arc16 out4" is changed in the environment.
set -euo pipefail
[ $# = 2 ] || { echo "usage: $0 HDRIG OUT" >&2; exit 2; }
hdrig=$(realpath "$1")
here=$(dirname "$(realpath "$0")")
mkdir -p "$2"
cd "$2"

take() { # name rig seed arguments...
    local name=$1 rig=$2 seed=$3
    shift 3
    [ -d "$name" ] || "$hdrig" simulate --rig "$rig.json" --kind room --seed "$seed" --samples 1 \
        --exposures 0.25,1,4 --board a3 --out "$name" "$@" &>/dev/null
}

calibrate() { # rig takes arguments...
    local rig=$1 n=$2 i
    local folders=()
    shift 2
    for i in $(seq "$n"); do
        folders+=("$rig-$i")
    done
    echo "$rig, $n takes $*"
    local start=$SECONDS
    "$hdrig" rig calibrate "${folders[@]}" "$@" \
        --set cameras.same=size --out found.json 2>/dev/null | sed -n 1p
    echo "$((SECONDS - start)) s"
    python3 "$here/rig_pose.py" "$rig.json" found.json
}

for rig in ${RIGS:-arc4 arc16 out4}; do
    case $rig in
    arc4) python3 "$here/rig_pose.py" --make 4 6 -1.2 >arc4.json ;;
    arc16) python3 "$here/rig_pose.py" --make 16 5 -1.2 >arc16.json ;;
    out4) python3 "$here/rig_pose.py" --make 4 35 0.15 >out4.json ;;
    esac
    if [ "$rig" = out4 ]; then
        for i in $(seq 12); do
            first=$(((i - 1) % 3 + 1))
            take "out4-$i" out4 $((300 + i)) --before $first-$((first + 1)) --distance 0.8
        done
        calibrate out4 6 --tag 55
        calibrate out4 12 --tag 55
        continue
    fi
    for i in $(seq 10); do
        take "$rig-$i" "$rig" $((100 + i)) --distance 1
    done
    for n in 5 10; do
        calibrate "$rig" "$n" --tag 55
        calibrate "$rig" "$n" --no-board
    done
done
