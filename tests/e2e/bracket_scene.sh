#!/usr/bin/env bash
# A scene from full brackets of simulated cameras is better than one from a single exposure of each
# place, and photographs that show nothing more change nothing.
. tests/e2e/common.bash
places=5
unit=0.00493 # s: what the data set calls 1, by its pictures compared with those of the cameras
camera=kind=room,seed=5,size=112,samples=4,spread=0.3,full=10000,clock=virtual,fps=1000

succeed simulate --out "$OUT/data" --kind room --seed 5 --views $places --size 112 --curve srgb \
    --noise-free --exposures 0.015625,0.125,1,8,64
rig=()
for ((v = 0; v < places; v++)); do
    rig+=(--camera "sim:$camera,views=$((2 * places - 1)),view=$((2 * v))")
done
succeed capture "${rig[@]}" --bracket -4,0,4 --middle 0.005 --set store.merge=0 --out "$OUT/three"

# the exposures in the unit of the data set, the cameras by the names of the take
awk -v unit=$unit '$2 + 0 { comma = /,$/ ? "," : ""; print $1, $2 / unit comma; next } { print }' \
    "$OUT/three/exposure.json" >"$OUT/exposure.json"
mkdir "$OUT/rig"
cp "$OUT/data/sparse/0/"* "$OUT/rig"
sed -i 's/train_ldr_0\([0-9]*\)_[0-9]*.png/train_\1_00.png/' "$OUT/rig/images.txt"

reconstruct() { # name
    succeed reconstruct --images "$OUT/$1" --exposures "$OUT/exposure.json" --rig "$OUT/rig" \
        --size 112 --refine 200 --out "$OUT/$1.scene"
}

score() { # name: of a scene
    succeed eval --data "$OUT/data" --scene "$OUT/$1.scene" --json "$OUT/$1.json"
    ldr=$(number "$OUT/$1.json" ldr psnr)
    hdr=$(number "$OUT/$1.json" hdr psnr)
    echo "$1: LDR $ldr dB, HDR $hdr dB"
}

gain() { # after before
    awk -v a="$1" -v b="$2" 'BEGIN { print a - b }'
}

mkdir -p "$OUT/one/images"
cp "$OUT"/three/images/*_01.png "$OUT/one/images"
reconstruct one
score one
one_ldr=$ldr one_hdr=$hdr
reconstruct three
score three
at_least "LDR gain of three exposures" "$(gain "$ldr" "$one_ldr")" 1
at_least "HDR gain of three exposures" "$(gain "$hdr" "$one_hdr")" 1
grep -q '"views": 5,' "$OUT/three.scene/report.json" || fail "not 5 places"
grep -q '"photographs": 15,' "$OUT/three.scene/report.json" || fail "not 15 photographs"
[ "$(ls "$OUT/three.scene/ldr" | wc -l)" -eq 5 ] || fail "not one picture of each place"

# the same photograph twice
mkdir -p "$OUT/more/images"
cp "$OUT"/three/images/* "$OUT/more/images"
for ((v = 0; v < places; v++)); do
    cp "$OUT/three/images/train_0${v}_01.png" "$OUT/more/images/train_0${v}_03.png"
    time=$(sed -n "s/.*\"train_0${v}_01.png\": *\([^,]*\).*/\1/p" "$OUT/exposure.json")
    sed -i "s/^{/{ \"train_0${v}_03.png\": $time,/" "$OUT/exposure.json"
done
reconstruct more
cmp -s "$OUT/more.scene/scene.hdrig" "$OUT/three.scene/scene.hdrig" ||
    fail "photographs that show nothing more change the scene"
grep -q '15 of 20 photographs: the others show nothing more' "$OUT/more.scene/report.json" ||
    fail "the report does not tell of photographs that were left out"

# nobody knows the cameras
succeed reconstruct --images "$OUT/three" --size 112 --refine 20 --out "$OUT/found.scene"
grep -q '"photographs": 15,' "$OUT/found.scene/report.json" || fail "found: not 15 photographs"

# names that tell of nothing, as from a camera on a tripod
mkdir "$OUT/tripod"
n=0
for ((v = 0; v < places; v++)); do
    for exposure in 01 00; do
        name=DSC_$((1000 + n++)).png
        cp "$OUT/three/images/train_0${v}_$exposure.png" "$OUT/tripod/$name"
        time=$(sed -n "s/.*\"train_0${v}_$exposure.png\": *\([^,]*\).*/\1/p" "$OUT/exposure.json")
        echo "\"$name\": $time"
    done
done | sed '1s/^/{/; $!s/$/,/; $s/$/}/' >"$OUT/times.json"
mv "$OUT/times.json" "$OUT/tripod/exposure.json"
succeed reconstruct --images "$OUT/tripod" --size 112 --refine 20 --out "$OUT/tripod.scene"
grep -q '"10 photographs from 5 places: those of a bracket share one"' \
    "$OUT/tripod.scene/report.json" || fail "the report does not tell of brackets on a tripod"
succeed export "$OUT/tripod.scene" --images "$OUT/tripod" --colmap "$OUT/tripod.export"
[ "$(ls "$OUT/tripod.export/images" | wc -l)" -eq 10 ] || fail "not all exposures are exported"
succeed reconstruct --images "$OUT/tripod" --rig "$OUT/tripod.scene/cameras.json" --size 112 \
    --refine 20 --out "$OUT/again.scene"
grep -q '"photographs": 10,' "$OUT/again.scene/report.json" || fail "again: not 10 photographs"
finish
