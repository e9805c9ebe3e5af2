#!/usr/bin/env bash
# barrel.sh HDRIG OUT - whether a few photographs tell how a lens distorts: rooms, yards and parks
# by 4, 6 and 8 cameras near each other and far apart, through a perfect lens and through barrels
# that move the corners by 3 and 6 of 448 px, each calibrated from one take. Prints the lens found,
# its focal length over the true one, and errors of rotations between cameras, degrees.
set -euo pipefail
[ $# = 2 ] || { echo "usage: $0 HDRIG OUT" >&2; exit 2; }
hdrig=$(realpath "$1")
here=$(dirname "$(realpath "$0")")
mkdir -p "$2"
cd "$2"

seed=700
for kind in room yard park; do
    for views in 4 6 8; do
        for spread in 0.3 0.6; do
            seed=$((seed + 1))
            for k1 in 0 -0.02 -0.05; do
                take=$seed$k1
                [ -d "$take" ] || "$hdrig" simulate --kind $kind --seed $seed --spread $spread \
                    --views $views --lens size=448x336,k1=$k1 --samples 1 --exposures 0.5,2 \
                    --out "$take" &>/dev/null
                printf '%s %s, %s views, spread %s, k1 %s: ' $kind $seed $views $spread $k1
                "$hdrig" rig calibrate "$take" --set cameras.same=size --out rig.json \
                    >found.txt 2>/dev/null || { echo "not calibrated"; continue; }
                printf '%s, ' "$(sed -n 's/.*cameras: \([A-Z_]*\),.*/\1/p' found.txt)"
                python3 "$here/colmap_pose.py" --truth "$take/sparse/0" --cameras rig.json |
                    sed 's/.*\(rotation[^,]*\),.*, \(focal [0-9.]*\).*/\1, \2/'
            done
        done
    done
done
