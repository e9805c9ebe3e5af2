#!/usr/bin/env bash
# Masks beside photographs: what they hide changes no byte of the scene, with known cameras and with
# cameras that are found; the report tells it; takes and other layouts; masks that fit nothing.
. tests/e2e/common.bash

# one world, empty and with somebody in it: photographs differ only where the masks are black
world=(--seed 7 --kind room --views 5 --size 160 --samples 2)
succeed simulate --out "$OUT/empty" "${world[@]}"
succeed simulate --out "$OUT/passed" "${world[@]}" --moving 0.12
small=(--model none --refine 60 --size 120)
scene() { # set result options...
    succeed reconstruct --images "$OUT/$1" --out "$OUT/$2" "${small[@]}" "${@:3}"
}
for set in empty passed; do
    scene $set bare_$set
    cp -r "$OUT/passed/truth/masks" "$OUT/$set/masks"
done
! cmp -s "$OUT/bare_empty/scene.hdrig" "$OUT/bare_passed/scene.hdrig" || fail "nobody passed"
same_scene() { # name options...
    for set in empty passed; do
        scene $set "$1_$set" "${@:2}"
    done
    cmp "$OUT/$1_empty/scene.hdrig" "$OUT/$1_passed/scene.hdrig" ||
        fail "$1: what masks hide is in the scene"
}
same_scene known
same_scene found --rig none
cmp -s "$OUT/known_empty/scene.hdrig" "$OUT/bare_empty/scene.hdrig" && fail "masks do nothing"

black() { # set photograph...
    local set=$1 name
    for name in "${@:2}"; do
        "$BIN/make_flat" "$OUT/$set/masks/$name" 160 0
    done
}

# what masks of test photographs hide is not measured: inputs and test photographs change places
echo '{"model": {"lpips": "alexnet"}}' >"$OUT/alexnet.json"
succeed convert --hashed 1 --config "$OUT/alexnet.json" --out "$OUT/alexnet.hdrig"
swap=(-e 's/train_/X/' -e 's/test_/train_/' -e 's/X/test_/')
for set in empty passed; do
    mkdir -p "$OUT/swap_$set/images" "$OUT/swap_$set/masks"
    cp -r "$OUT/$set/sparse" "$OUT/swap_$set/sparse"
    sed -i "${swap[@]}" "$OUT/swap_$set/sparse/0/images.txt"
    sed "${swap[@]}" "$OUT/$set/exposure.json" >"$OUT/swap_$set/exposure.json"
    for path in "$OUT/$set"/images/*.png "$OUT/$set"/masks/*.png; do
        name=$(sed "${swap[@]}" <<<"${path##*/}")
        cp "$path" "$OUT/swap_$set/$(basename "${path%/*}")/$name"
    done
    figures=(eval --data "$OUT/swap_$set" --model none --refine 0 --size 120
        --lpips "$OUT/alexnet.hdrig")
    succeed "${figures[@]}" --json "$OUT/swap_$set.json"
    sed -i '/"seconds": {/,$d' "$OUT/swap_$set.json"
done
cmp "$OUT/swap_empty.json" "$OUT/swap_passed.json" || fail "what masks hide is measured"
mv "$OUT/swap_passed/masks" "$OUT/swap_passed/other"
succeed "${figures[@]}" --json "$OUT/swap_bare.json"
sed -i '/"seconds": {/,$d' "$OUT/swap_bare.json"
cmp -s "$OUT/swap_passed.json" "$OUT/swap_bare.json" && fail "masks of test photographs do nothing"
names=("$OUT"/swap_empty/images/test_*.png)
names=("${names[@]##*/}")
black swap_empty "${names[0]}"
succeed "${figures[@]/passed/empty}" --json "$OUT/swap_one.json"
grep -q "${names[0]}: its mask hides all of it: it is not measured" "$ERR" || fail "a black mask"
black swap_empty "${names[@]}"
expect 1 'masks hide all of every test photograph' "${figures[@]/passed/empty}"

# one exposure of each place, so that stereo sees the masks too, through a lens that distorts
world=(--seed 7 --kind room --views 8 --samples 1 --exposures 0.25,0.35,0.5,0.7,1)
world+=(--lens k1=-0.3,size=320x240)
succeed simulate --out "$OUT/still" "${world[@]}"
succeed simulate --out "$OUT/walked" "${world[@]}" --moving 0.1
for set in still walked; do
    mkdir -p "$OUT/one_$set/masks"
    sed 's/train_ldr_/v/' "$OUT/$set/exposure.json" >"$OUT/one_$set/exposure.json"
    for view in 0 1 2 3 4 5 6 7; do
        names=("$OUT/walked/truth/masks/train_ldr_00${view}"_*.png)
        name=train_ldr_00${view}_2.png
        [ -e "${names[0]}" ] && name=${names[0]##*/} &&
            cp "${names[0]}" "$OUT/one_$set/masks/${name/train_ldr_/v}"
        cp "$OUT/$set/images/$name" "$OUT/one_$set/${name/train_ldr_/v}"
    done
    succeed reconstruct --images "$OUT/one_$set" --out "$OUT/seen_$set" --rig none --model none \
        --size 240 --refine 20
done
cmp "$OUT/seen_still/scene.hdrig" "$OUT/seen_walked/scene.hdrig" ||
    fail "single exposures: what masks hide is in the scene"
grep -q 'undistorted: the lens was found' "$OUT/seen_still/report.json" ||
    fail "no lens was found: masks did not go through it"

# the report
hidden=$(grep -c '"masked": 0\.1' "$OUT/known_passed/report.json")
[ "$hidden" -ge 2 ] || fail "report.json: $hidden photographs are masked"
! grep -q '"masked"' "$OUT/bare_passed/report.json" || fail "report.json: masked without masks"

# masks of everything; names and shapes that fit no photograph
names=("$OUT"/empty/images/train_*.png)
names=("${names[@]##*/}")
black empty "${names[0]}"
succeed reconstruct --images "$OUT/empty" --out "$OUT/one" "${small[@]}"
grep -q '1 photograph is masked all over (train_ldr_000_0.png)' "$ERR" || fail "no word of black"
black empty "${names[@]}"
expect 1 'masks hide all of every photograph: what is black in a mask does not count, white does' \
    reconstruct --images "$OUT/empty" --out "$OUT/no" "${small[@]}"
"$BIN/make_flat" "$OUT/passed/masks/stranger.png" 160 255
succeed reconstruct --images "$OUT/passed" --out "$OUT/one" "${small[@]}"
grep -q '1 file is not read (stranger.png): in masks, but no photograph has their name' "$ERR" ||
    fail "no word of the stranger"
"$BIN/make_flat" "$OUT/passed/masks/train_ldr_000_0.png" 80 255
expect 1 'masks/train_ldr_000_0.png: 80 x 80 px, but the photograph train_ldr_000_0.png has 160' \
    reconstruct --images "$OUT/passed" --out "$OUT/no" "${small[@]}"
nothing_at "$OUT/no"

# somebody walks by while a rig captures: the take has masks and asks for another one; its scene
# does not see what they hide
rig=()
camera=sim:kind=room,seed=5,size=112,samples=1,fps=20,clock=virtual,views=4,moving=0.1
for view in 0 1 2 3; do
    rig+=(--camera "$camera,view=$view")
done
succeed capture "${rig[@]}" --out "$OUT/take"
grep -q "of camera .'s picture moved between its exposures: take it again" \
    "$OUT/take/manifest.json" || fail "manifest.json does not say that somebody moved"
masks=("$OUT"/take/masks/train_0?_0?.png)
at_least "masks of a take" "${#masks[@]}" 2
succeed reconstruct --images "$OUT/take" --out "$OUT/taken" --model none --refine 0
at_least "masked photographs" "$(grep -c '"masked"' "$OUT/taken/report.json")" 1
finish
