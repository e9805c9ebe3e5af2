#!/usr/bin/env bash
# The same input gives the same bytes with any number of threads, and with other instruction sets
# the same picture.
. tests/e2e/common.bash
make_set set 112 5 2
job=(--size 112 --refine 40 --seed 7)

for threads in 1 2 7; do
    scene=$OUT/threads$threads
    succeed reconstruct --images "$OUT/set" "${job[@]}" --threads $threads --out "$scene"
    hash=$(sha256sum <"$scene/scene.hdrig")
    [ "$hash" = "${first:=$hash}" ] || fail "scene.hdrig differs with $threads threads"
    hash=$(cat "$scene"/hdr/*.exr "$scene"/ldr/*.png | sha256sum)
    [ "$hash" = "${pictures:=$hash}" ] || fail "pictures differ with $threads threads"
done
succeed reconstruct --images "$OUT/set" "${job[@]}" --seed 8 --out "$OUT/seed"
[ "$(sha256sum <"$OUT/seed/scene.hdrig")" != "$first" ] || fail "the seed changes nothing"

# dB by which a level may differ: its sums are rounded differently, and refinement amplifies that
bound=0.05
for level in $("$HDRIG" doctor | sed -n 's/^instructions *//p') c; do
    mask="${mask:-} $level"
    [ $level = c ] && mask=c
    HDRIG_CPU_MASK=$mask succeed eval --data "$OUT/set" "${job[@]}" --json "$OUT/$level.json"
    psnr=$(number "$OUT/$level.json" ldr psnr)
    echo "$mask: $psnr dB"
    [ -n "$psnr" ] || fail "no figure for $mask"
    awk -v a="$psnr" -v b="${reference:=$psnr}" -v d=$bound \
        'BEGIN { exit !((a - b) ^ 2 <= d ^ 2) }' ||
        fail "$mask: $psnr dB, the first level $reference"
done
HDRIG_CPU_MASK=mmx expect 1 'mmx' eval --data "$OUT/set"
finish
