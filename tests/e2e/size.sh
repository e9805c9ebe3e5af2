#!/usr/bin/env bash
# Pictures larger than those that cameras and depth are found in: the size asked, that of the
# photographs, what memory allows; photographs that are narrow, or ten times smaller than others.
. tests/e2e/common.bash
succeed simulate --kind room --seed 21 --views 3 --size 600 --samples 1 --exposures 1 \
    --out "$OUT/set"

size_of() { # scene; prints the edge of its first camera
    sed -n 's/.*"w": \([0-9]*\).*/\1/p' "$OUT/$1/cameras.json" | head -n 1
}

cut() { # set crop
    local file
    mkdir -p "$OUT/$1/images"
    cp "$OUT/set/exposure.json" "$OUT/$1"
    for file in "$OUT"/set/images/train*.png; do
        ffmpeg -nostdin -v error -i "$file" -vf "$2" "$OUT/$1/images/${file##*/}" ||
            fail "ffmpeg $file"
    done
}

job=(reconstruct --images "$OUT/set" --gaussians-max 30000)
succeed "${job[@]}" --size full --refine 12 --out "$OUT/full"
[ "$(size_of full)" = 600 ] || fail "full size is $(size_of full) px"
grep -q 'pictures of 600 px, from photographs of up to 600 px; cameras and depth at 448 px' \
    "$OUT/full/report.json" || fail "the report does not tell the size"
succeed eval --data "$OUT/set" --scene "$OUT/full" --json "$OUT/own.json"
succeed eval --data "$OUT/set" --scene "$OUT/full" --size 300 --json "$OUT/small.json"
at_least "PSNR of smaller pictures" "$(number "$OUT/small.json" ldr psnr)" \
    "$(number "$OUT/own.json" ldr psnr)"

# what memory allows: refused with a size that fits, or chosen
expect 3 'needs [0-9]* MB.*; --size [0-9]+ would fit' "${job[@]}" --size full --max-memory 120 \
    --refine 1 --out "$OUT/no"
fits=$(sed -n 's/.*--size \([0-9]*\) would fit.*/\1/p' "$ERR")
succeed "${job[@]}" --max-memory 120 --refine 1 --out "$OUT/auto"
[ "$(size_of auto)" = "$fits" ] || fail "auto chose $(size_of auto) px where $fits px fit"
succeed "${job[@]}" --size "$fits" --max-memory 120 --refine 1 --out "$OUT/fits"

# one pixel wide
cut narrow crop=1:600
expect 1 'become a view that is less than [0-9]+ px narrow' reconstruct --images "$OUT/narrow" \
    --size full --out "$OUT/no"
nothing_at "$OUT/no"

# one camera has a tenth of the others' pixels: it is not enlarged beyond 448 px
cp -r "$OUT/set" "$OUT/mixed"
small=$(cd "$OUT/mixed/images" && ls train_ldr_001*)
ffmpeg -nostdin -v error -y -i "$OUT/set/images/$small" -vf scale=60:60 \
    "$OUT/mixed/images/$small" || fail "ffmpeg $small"
awk '{ print; print 2, $2, 60, 60, $5 / 10, $6 / 10, 30, 30 }' "$OUT/set/sparse/0/cameras.txt" \
    >"$OUT/mixed/sparse/0/cameras.txt"
sed -i "s/ 1 $small/ 2 $small/" "$OUT/mixed/sparse/0/images.txt"
succeed reconstruct --images "$OUT/mixed" --gaussians-max 30000 --refine 12 --out "$OUT/scene"
grep -q '"w": 448' "$OUT/scene/cameras.json" && grep -q '"w": 600' "$OUT/scene/cameras.json" ||
    fail "views of two sizes have other shapes"
finish
