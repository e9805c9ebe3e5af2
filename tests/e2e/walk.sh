#!/usr/bin/env bash
# More photographs than are compared all with all: a walk through a park whose cameras nobody knows,
# and the extremes of such sets.
. tests/e2e/common.bash

walk=(simulate --kind park --walk --samples 1 --lens size=256x192 --exposures 1)
locate=(reconstruct --rig none --model none --refine 0 --size 256)

# bad requests
expect 2 '--walk: only in --kind park' simulate --kind yard --walk --out "$OUT/no"
expect 2 '--views: 257 is not in 2..256' simulate --kind park --walk --views 257 --out "$OUT/no"
nothing_at "$OUT/no"

# just more than are compared all with all: all are placed; none is held out
succeed "${walk[@]}" --seed 3 --views 68 --out "$OUT/park"
[ "$(ls "$OUT/park/images" | wc -l)" -eq 68 ] || fail "a walk holds views out"
succeed "${locate[@]}" --images "$OUT/park" --out "$OUT/scene"
at_least "views that are placed" "$(number "$OUT/scene/report.json" cameras views_placed)" 67
at_least "their confidence" "$(number "$OUT/scene/report.json" cameras confidence)" 0.5

# of fewer, all centres at once are right for some only: they are grown, too; 37 to 40 are placed,
# by the processor's instructions
succeed simulate --kind park --walk --samples 1 --lens size=400x300 --exposures 1 --seed 3 \
    --views 40 --out "$OUT/short"
succeed "${locate[@]}" --images "$OUT/short" --out "$OUT/scene"
at_least "views of a short walk" "$(number "$OUT/scene/report.json" cameras views_placed)" 36
grep -Eq '[0-9] % of the pixels look like sky: put far' "$OUT/scene/report.json" ||
    fail "sky is not told: $(grep -A6 modelled "$OUT/scene/report.json")"

# every tenth is of another place, one is black: they are left out, and named
mkdir "$OUT/mixed"
succeed "${walk[@]}" --seed 8 --views 6 --out "$OUT/other"
cp "$OUT"/park/images/*.png "$OUT/mixed"
for i in 0 1 2 3 4 5; do
    cp "$OUT/other/images/train_ldr_00${i}_0.png" "$OUT/mixed/train_ldr_0${i}5_0.png"
done
"$BIN/make_flat" "$OUT/mixed/train_ldr_037_0.png" 256 0 || exit 1
cp "$OUT/park/exposure.json" "$OUT/mixed"
succeed "${locate[@]}" --images "$OUT/mixed" --out "$OUT/most"
at_least "views that are placed" "$(number "$OUT/most/report.json" cameras views_placed)" 60
[ "$(number "$OUT/most/report.json" cameras views_placed)" -le 61 ] ||
    fail "views of another place are placed"
grep -q 'train_ldr_037_0.png is left out: it is black all over' "$OUT/most/report.json" ||
    fail "nothing is said of a black photograph"

# round a pavilion, whose columns are taken for each other: that is said
succeed simulate --kind park --orbit 24 --views 6 --seed 7 --size 112 --samples 1 \
    --exposures 0.4,0.6,1 --out "$OUT/round"
mkdir "$OUT/alike"
cp "$OUT"/round/images/train_ldr_*_0.png "$OUT/round/exposure.json" "$OUT/alike"
succeed reconstruct --rig none --model none --refine 0 --size 112 --images "$OUT/alike" \
    --out "$OUT/wrong"
grep -q 'parts of a scene look alike' "$OUT/wrong/report.json" ||
    fail "nothing is said of cameras at the wrong columns"
for scene in scene most; do
    ! grep -q 'parts of a scene look alike' "$OUT/$scene/report.json" ||
        fail "$scene: right places are called wrong"
done

# more than can be found
mkdir "$OUT/crowd"
for i in $(seq 513); do
    ln "$OUT/park/images/train_ldr_000_0.png" "$OUT/crowd/$i.png"
done
printf '{%s"1.png": 1}\n' "$(for i in $(seq 2 513); do printf '"%d.png": 1, ' "$i"; done)" \
    >"$OUT/crowd/exposure.json"
expect 1 '513 views, cameras can be found for at most 512' "${locate[@]}" --images "$OUT/crowd" \
    --out "$OUT/no"
expect 3 'needs [0-9]+ MB' "${locate[@]}" --images "$OUT/park" --max-memory 100 --out "$OUT/no"
nothing_at "$OUT/no"
finish
