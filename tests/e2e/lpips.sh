#!/usr/bin/env bash
# LPIPS in eval: beside PSNR and SSIM wherever these stand, the same for any number of threads and
# nearly so without instruction sets, of the values that the protocol says; wrong weights and
# pictures that are too small.
. tests/e2e/common.bash

for net in alexnet vgg16; do
    echo "{\"model\": {\"lpips\": \"$net\"}}" >"$OUT/$net.json"
    succeed convert --hashed 1 --config "$OUT/$net.json" --out "$OUT/$net.hdrig"
done
succeed simulate --out "$OUT/world" --seed 3 --kind room --views 4 --size 84 --samples 1
eval=(eval --data "$OUT/world" --model none --refine 0 --size 56)
with=("${eval[@]}" --lpips "$OUT/alexnet.hdrig")

members() { # file: all values of lpips but what they were measured with
    sed -n 's/.*"lpips": \([^{,]*\),\{0,1\}$/\1/p' "$1"
}

succeed "${eval[@]}" --json "$OUT/without.json"
[ "$(members "$OUT/without.json" | sort -u)" = null ] || fail "LPIPS without weights"
grep -q LPIPS "$OUT/stdout.txt" && fail "a column of nothing"
succeed "${with[@]}" --threads 1 --json "$OUT/one.json"
grep -q 'PSNR dB *SSIM *LPIPS *images' "$OUT/stdout.txt" || fail "no column of LPIPS"
grep -q 'exposure.* 0\.[0-9]* * 0\.[0-9]* *[0-9]*$' "$OUT/stdout.txt" || fail "no numbers in it"
[ "$(grep -c '"psnr":' "$OUT/one.json")" -ge 20 ] || fail "too few figures"
members "$OUT/one.json" | grep -q null && fail "a figure without LPIPS"
grep -q '"net": "alexnet"' "$OUT/one.json" || fail "the network is not named"
tr -d '\n ' <"$OUT/one.json" | grep -q '"range":\[0,1\]' || fail "the paper's range"
succeed "${with[@]}" --threads 2 --json "$OUT/two.json"
[ "$(members "$OUT/one.json")" = "$(members "$OUT/two.json")" ] || fail "threads matter"
HDRIG_CPU_MASK=c succeed "${with[@]}" --json "$OUT/plain.json"
paste <(members "$OUT/one.json") <(members "$OUT/plain.json") |
    awk '{ if ($1 < 0.999 * $2 || $1 > 1.001 * $2) exit 1 }' || fail "instruction sets matter"
succeed "${with[@]}" --protocol native --json "$OUT/native.json"
tr -d '\n ' <"$OUT/native.json" | grep -q '"range":\[-1,1\]' || fail "the native range"
[ "$(members "$OUT/native.json")" = "$(members "$OUT/one.json")" ] && fail "the range does nothing"
succeed reconstruct --images "$OUT/world" --out "$OUT/scene" --model none --refine 0 --size 56
succeed eval --data "$OUT/world" --scene "$OUT/scene" --lpips "$OUT/vgg16.hdrig" \
    --json "$OUT/stored.json"
members "$OUT/stored.json" | grep -q null && fail "a figure of a scene without LPIPS"
grep -q '"net": "vgg16"' "$OUT/stored.json" || fail "the other network is not named"

# what cannot be measured with
expect 1 'alexnet.hdrig holds weights of LPIPS' "${eval[@]/none/$OUT/alexnet.hdrig}"
expect 1 'nowhere.hdrig: No such file' "${eval[@]}" --lpips "$OUT/nowhere.hdrig"
succeed convert --hashed 1 --config tests/data/ckpt/tiny.json --out "$OUT/tiny.hdrig"
expect 1 'tiny.hdrig: these are weights of a network of scenes, not of LPIPS' "${eval[@]}" \
    --lpips "$OUT/tiny.hdrig"
succeed simulate --out "$OUT/wide" --seed 3 --kind room --views 4 --samples 1 \
    --lens k1=-0.1,size=160x64
expect 1 'test_ldr_.*: LPIPS of alexnet needs pictures of at least 31 px, these have 56 x 2[0-9]' \
    "${with[@]/world/wide}" --protocol native
cp "$OUT/alexnet.hdrig" "$OUT/kept"
expect 1 'kept' "${eval[@]}" --lpips "$OUT/kept" --out "$OUT/kept"
cmp -s "$OUT/alexnet.hdrig" "$OUT/kept" || fail "a result replaced the weights"
finish
