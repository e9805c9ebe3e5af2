#!/usr/bin/env bash
# same_results.sh HDRIG_BEFORE HDRIG_AFTER - proves that a change of the code did not change what it
# computes: both programs make worlds, scenes, exports and simulated takes, and every file and every
# line of them is compared, but for times and the list of sums.
set -euo pipefail
cd "$(dirname "$0")/.."
[ $# = 2 ] || { echo "usage: $0 HDRIG_BEFORE HDRIG_AFTER" >&2; exit 2; }
before=$(realpath "$1") after=$(realpath "$2")
work=$(mktemp -d)
[ -n "${KEEP:-}" ] || trap 'rm -rf "$work"' EXIT
virtual=samples=1,clock=virtual,fps=200,size=112

results() { # hdrig: everything in the present folder
    local h=$1 model=$here/build/small.hdrig set=$here/tests/data/sets
    "$h" simulate --kind room --seed 11 --views 6 --size 112 --samples 2 --out room
    "$h" simulate --kind yard --seed 4 --views 5 --size 112 --samples 1 --out yard
    "$h" simulate --kind room --seed 12 --views 6 --samples 2 --lens fov=60,size=84x112,k1=-0.1 \
        --out portraits
    "$h" reconstruct --images room --size 112 --refine 60 --out known
    "$h" reconstruct --images room --rig none --size 112 --refine 30 --out unknown
    "$h" reconstruct --images yard --rig none --model none --size 112 --refine 0 --out yard-scene
    "$h" reconstruct --images portraits --rig none --size 112 --refine 30 --out portraits-scene
    "$h" reconstruct --images room --model "$model" --precision int8 --size 112 --refine 0 \
        --dump dump --out network
    "$h" eval --data room --rig none --size 112 --refine 20 --json eval.json
    "$h" eval --data yard --size 112 --refine 20 --json eval-known.json
    "$h" render --scene known --path orbit --frames 3 --ev 1 --out frames
    for kind in spz glb ply; do "$h" convert --scene known --out "known.$kind"; done
    "$h" convert --hashed 3 --config "$here/tests/data/golden/mini/index.json" \
        --precision int8 --out hashed.hdrig
    for take in "kind=room,seed=5" "kind=room,seed=7,format=rggb" "kind=yard,seed=3,shadow=1" \
        "kind=room,seed=9,flicker=0.3"; do
        "$h" capture --camera "sim:$take,$virtual" --out "take-$take" || echo "refused: $?"
    done
    "$h" config --print
    "$h" convert --help
}

here=$PWD
for side in before after; do
    mkdir "$work/$side"
    (cd "$work/$side" && results "${!side}" >stdout.txt 2>stderr.txt) || {
        tail -n 3 "$work/$side/stderr.txt" >&2
        exit 1
    }
    # what a clock writes, and the paths of sources in comments of pages
    find "$work/$side" -name files.sha256 -delete
    find "$work/$side" -type f \( -name '*.json' -o -name '*.html' -o -name 'std*.txt' \) -exec \
        sed -i -E -e '/"seconds": \{/,/\}/d' \
        -e '/_(s|mb)"/d; / [0-9]+ %/d; /: core\//d; /merged\/.*sha256/d' \
        -e 's/"[a-z]+time_ns": "[0-9]+"//g; s/[0-9.]+ (s|min|MB)\b//g' {} +
    find "$work/$side" -name '*.exr' -exec \
        env LC_ALL=C sed -i -E 's/20[0-9:]{8} [0-9:]{8}//g; s/[0-9]{10,}//g' {} +
done
files=$(find "$work/before" -type f | wc -l)
diff -rq "$work/before" "$work/after" >"$work/differ.txt" || {
    head -n 20 "$work/differ.txt"
    echo "$(wc -l <"$work/differ.txt") of $files files differ"
    exit 1
}
echo "$files files and their folders are the same"
