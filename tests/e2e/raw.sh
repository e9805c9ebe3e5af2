#!/usr/bin/env bash
# A folder of raw photographs becomes a scene: DNGs of a simulated room at three exposures, of which
# only the files tell; and one that is cut off.
. tests/e2e/common.bash
succeed simulate --kind room --seed 23 --views 8 --size 224 --samples 2 \
    --exposures 0.25,1,4 --depth --out "$OUT/room"
mkdir "$OUT/raw"
exposures=(0.25 1 4)
for i in 0 1 2 3 4 5 6 7; do
    "$BIN/make_dng" "$OUT/room/images_hdr/train_hdr_00$i.exr" "${exposures[i % 3]}" \
        "$OUT/raw/$i.dng" || fail "make_dng $i"
done
unknown=(--rig none --model none --size 224 --refine 60)
succeed reconstruct --images "$OUT/raw" "${unknown[@]}" --out "$OUT/scene"
at_least "number of views placed" "$(number "$OUT/scene/report.json" cameras views_placed)" 8
at_least "PSNR of the raw photographs" \
    "$(number "$OUT/scene/report.json" quality ldr_input_psnr)" 24

# A damaged file is named, and nothing is written
head -c 20000 "$OUT/raw/3.dng" >"$OUT/cut.dng"
cp -r "$OUT/raw" "$OUT/bad" && mv "$OUT/cut.dng" "$OUT/bad/3.dng"
expect 1 '3\.dng: ' reconstruct --images "$OUT/bad" "${unknown[@]}" --out "$OUT/no"
nothing_at "$OUT/no"
finish
