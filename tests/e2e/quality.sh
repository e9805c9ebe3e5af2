#!/usr/bin/env bash
# From photographs to held-out views: figures above their floors, files under their promised names.
. tests/e2e/common.bash
make_set set 112 8 4

succeed eval --data "$OUT/set" --size 112 --refine 200 --json "$OUT/eval.json" --out "$OUT/eval"
grep -Eq '^LDR +[0-9.]+ +[0-9.]+ +20$' "$OUT/stdout.txt" || fail "no table on stdout"
at_least "LDR PSNR" "$(number "$OUT/eval.json" ldr psnr)" 25.5
at_least "LDR SSIM" "$(number "$OUT/eval.json" ldr ssim)" 0.87
at_least "HDR PSNR" "$(number "$OUT/eval.json" hdr psnr)" 28
at_least "minus radiance's error, stops" \
    "-$(sed -n 's/^  "hdr_stops": \([0-9.]*\).*/\1/p' "$OUT/eval.json")" -0.8
[ "$(grep -c '"exposure_seen": ' "$OUT/eval.json")" -eq 20 ] || fail "not 20 pictures"
grep -q '^worst: test_ldr_00[0-9]_[0-9].png, [0-9.]* dB$' "$OUT/stdout.txt" || fail "no worst one"
nearest=$(number "$OUT/eval.json" baseline_nearest psnr)
at_least "gain over the nearest view" \
    "$(awk -v a="$(number "$OUT/eval.json" ldr psnr)" -v b="$nearest" 'BEGIN { print a - b }')" 7
for name in test_ldr_000_0 test_ldr_003_4; do
    [ -s "$OUT/eval/ldr/$name.png" ] || fail "no ldr/$name.png"
done
[ "$(ls "$OUT/eval/ldr" | wc -l)" -eq 20 ] || fail "not 20 LDR pictures"
[ "$(ls "$OUT/eval/hdr" | wc -l)" -eq 4 ] || fail "not 4 EXR files"
cmp -s "$OUT/eval.json" "$OUT/eval/report.json" || fail "report.json and --json differ"

# fewer views, on stdout
succeed eval --data "$OUT/set" --size 56 --views 4 --refine 0 --json -
grep -q '"views": 4,' "$OUT/stdout.txt" || fail "--views 4 did not take 4 views"
head -n 1 "$OUT/stdout.txt" | grep -q '^{$' || fail "--json - prints more than JSON"
expect 1 '9 views requested, there are 8' eval --data "$OUT/set" --size 56 --views 9

# a result folder, and pictures from it
succeed reconstruct --images "$OUT/set" --size 112 --refine 100 --json - --out "$OUT/scene"
cmp -s "$OUT/stdout.txt" "$OUT/scene/report.json" || fail "report.json and --json - differ"
for file in scene.ply scene.hdrig cameras.json tone.json report.json; do
    [ -s "$OUT/scene/$file" ] || fail "no $file"
done
[ "$(ls "$OUT/scene/hdr" | wc -l) $(ls "$OUT/scene/ldr" | wc -l)" = "8 8" ] || fail "not 8 views"
succeed render --scene "$OUT/scene" --path inputs --out "$OUT/inputs"
succeed render --scene "$OUT/scene" --cameras "$OUT/scene/cameras.json" --out "$OUT/same"
for i in 0 7; do
    cmp -s "$OUT/inputs/frame_000$i.png" "$OUT/same/frame_000$i.png" || fail "frame $i differs"
done
succeed render --scene "$OUT/scene" --path orbit --frames 5 --size 64 --ev -2 --hdr \
    --out "$OUT/orbit"
[ "$(ls "$OUT/orbit" | wc -l)" -eq 12 ] || fail "not 5 frames twice, a report and a list"

# a result measured later gives the figures of eval, with the inputs that it was made from
"$BIN/make_set" "$OUT/staggered" 56 8 4 one || exit 1
succeed reconstruct --images "$OUT/staggered" --size 56 --refine 30 --seed 3 --out "$OUT/eight"
succeed eval --data "$OUT/staggered" --size 56 --refine 30 --seed 3 --json "$OUT/now.json"
succeed eval --data "$OUT/staggered" --scene "$OUT/eight" --json "$OUT/later.json"
for object in ldr hdr baseline_nearest; do
    now=$(number "$OUT/now.json" $object psnr)
    [ -n "$now" ] && [ "$now" = "$(number "$OUT/later.json" $object psnr)" ] ||
        fail "eval --scene: $object differs from eval: $now"
done
grep -q refine_steps "$OUT/later.json" && fail "eval --scene tells of a refinement"
grep -q 'another unit' "$ERR" && fail "exposures of its own photographs seem strange"
cp -r "$OUT/staggered" "$OUT/units"
sed -i 's/: \([0-9.]*\)/: \1e-3/' "$OUT/units/exposure.json"
succeed eval --data "$OUT/units" --scene "$OUT/eight"
grep -q 'exposed 1[01] stops less .* another unit' "$ERR" ||
    fail "milliseconds for seconds: $(cat "$ERR")"
expect 2 '--scene has its input views' eval --data "$OUT/set" --scene "$OUT/eight" --views 3
expect 1 'nowhere/scene.hdrig' eval --data "$OUT/set" --scene "$OUT/nowhere"
cp -r "$OUT/staggered" "$OUT/foreign"
for file in "$OUT"/foreign/images/train_ldr_0*; do
    mv "$file" "${file/train_ldr_0/train_ldr_9}"
done
sed -i 's/train_ldr_0/train_ldr_9/' "$OUT/foreign/exposure.json"
rm -r "$OUT/foreign/sparse"
expect 1 "foreign: none of the scene's 8 input views are in this folder" \
    eval --data "$OUT/foreign" --scene "$OUT/eight" --rig none

# inputs at one exposure only
succeed eval --data "$OUT/set" --size 56 --refine 0 --exposure-set 3 --json -
grep -q '"views": 8,' "$OUT/stdout.txt" || fail "--exposure-set 3 has not one picture of each view"
grep -q '"mid_exposure_log2": 0,' "$OUT/stdout.txt" || fail "--exposure-set 3 is not exposure 1"
[ "$(number "$OUT/stdout.txt" ldr_seen_exposures images) $(number "$OUT/stdout.txt" \
    ldr_unseen_exposures images)" = "4 16" ] || fail "exposures that no input has"
expect 1 'exposure 6 requested, its pictures have 5' eval --data "$OUT/set" --exposure-set 1,6
expect 2 '--exposure-set: "1;3" is not a list' eval --data "$OUT/set" --exposure-set '1;3'

# known cameras from our own file; settings from --set
succeed reconstruct --images "$OUT/set/images" --rig "$OUT/scene/cameras.json" --set size=56 \
    --set refine.steps=5 --out "$OUT/again"
grep -q '"refine_steps": 5,' "$OUT/again/report.json" || fail "--set refine.steps=5 was not heard"
succeed doctor
grep -q '^kernels' "$OUT/stdout.txt" || fail "doctor does not tell the kernels"
succeed config --print --set threads=3
grep -q '^threads = 3$' "$OUT/stdout.txt" || fail "config --print does not show --set"
succeed bench --what splat --gaussians 1000,2000 --size 56,64 --json "$OUT/bench.json"
for name in seconds_forward seconds_backward seconds_step gaussians pixels share_of_limit; do
    grep -q "\"$name\": [0-9]" "$OUT/bench.json" || fail "bench: no $name"
done
[ "$(sed -n '/"table"/,$p' "$OUT/bench.json" | grep -c '"seconds_step"')" -eq 4 ] ||
    fail "bench: not 2 x 2 figures in the table"
finish
