#!/usr/bin/env bash
# Checkpoints become weights files; everything wrong ends with its exit code, a sentence that names
# the object, and no file.
. tests/e2e/common.bash
tiny=tests/data/ckpt
to=$OUT/model.hdrig

refused() { # code regex arguments of convert...
    local code=$1 regex=$2
    shift 2
    expect "$code" "$regex" convert "$@" --out "$to"
    nothing_at "$to"
}

copy() { # name: a safetensors file to spoil, in $bad
    bad=$OUT/$1
    cp "$OUT/tiny.safetensors" "$bad"
}

# The header of $bad with the first match of a basic regular expression replaced by a text of the
# same length.
replace() { # regex text
    LC_ALL=C sed -i "0,/$1/s//$2/" "$bad"
}

# usage
expect 2 '--out and either a file or --hashed are needed' convert
expect 2 '--out and either a file or --hashed are needed' convert "$tiny/tiny.ckpt"
expect 2 '--out and either a file or --hashed are needed' convert x --hashed 1 --out y
expect 2 '--hashed needs --config' convert --hashed 1 --out y
expect 2 '--hashed: "many" is not a whole number' convert --hashed many --config mini --out y
expect 2 '--hashed: "-1" is not' convert --hashed -1 --config mini --out y
expect 2 '--hashed: "18446744073709551616" is' convert --hashed 18446744073709551616 \
    --config mini --out y
expect 2 '--precision: "fp64" is none of' convert x --out y --precision fp64
expect 2 'unexpected argument "stray"' convert x --out y stray
succeed convert --help
grep -q 'usage: hdrig convert FILE' "$OUT/stdout.txt" || fail "no help"

# what is converted
for precision in fp32 bf16 int8; do
    succeed convert "$tiny/tiny.ckpt" --config "$tiny/tiny.json" --precision $precision \
        --out "$OUT/$precision.hdrig"
    grep -q 'tensors are not of this network and left out (2): encoder.losses.count' "$ERR" ||
        fail "no word about strangers"
    succeed doctor --model "$OUT/$precision.hdrig"
    grep -q "$precision" "$OUT/stdout.txt" || fail "doctor does not tell $precision"
done
succeed convert --hashed 123456789012345 --config "$tiny/tiny.json" --out "$OUT/hashed.hdrig"
succeed convert --hashed 123456789012345 --config "$tiny/tiny.json" --threads 1 \
    --out "$OUT/again.hdrig"
cmp -s "$OUT/hashed.hdrig" "$OUT/again.hdrig" || fail "another number of threads, other bytes"
succeed convert "$tiny/tiny.ckpt" --config "$tiny/tiny.json" --out "$OUT/again.hdrig"
cmp -s "$OUT/fp32.hdrig" "$OUT/again.hdrig" || fail "not the same bytes again"
"$BIN/make_tensors" "$tiny/tiny.ckpt" "$OUT/tiny.safetensors" || exit 1
succeed convert "$OUT/tiny.safetensors" --config "$tiny/tiny.json" --out "$OUT/again.hdrig"
tiny_json='{"weight_map": {"encoder.camera_head.token_norm.bias": "tiny.safetensors"}}'
echo "$tiny_json" >"$OUT/tiny.safetensors.index.json"
succeed convert "$OUT/tiny.safetensors.index.json" --config "$tiny/tiny.json" \
    --out "$OUT/sharded.hdrig"
cmp -s <(tail -c 1000000 "$OUT/sharded.hdrig") <(tail -c 1000000 "$OUT/again.hdrig") ||
    fail "an index gives other weights"

# LPIPS, whose weights are no network of scenes
echo '{"model": {"lpips": "alexnet"}}' >"$OUT/alexnet.json"
succeed convert --hashed 1 --config "$OUT/alexnet.json" --out "$OUT/lpips.hdrig"
succeed doctor --model "$OUT/lpips.hdrig"
grep -q 'LPIPS of alexnet' "$OUT/stdout.txt" || fail "doctor does not tell LPIPS"
refused 1 'weights of LPIPS are fp32 only' --hashed 1 --config "$OUT/alexnet.json" --precision int8
for other in '--hashed 1 --config mini' 'x --config mini' 'x --precision bf16'; do
    # shellcheck disable=SC2086
    expect 2 '--lpips goes with neither --hashed nor --config' convert $other --lpips x --out y
done
refused 1 'tiny.ckpt: has no tensor features.0.weight of kernels' "$tiny/tiny.ckpt" \
    --lpips "$tiny/tiny.ckpt"
refused 1 'old.pt: has no tensor features.0.weight' "$tiny/old.pt" --lpips "$tiny/old.pt"

# inputs
config=(--config "$tiny/tiny.json")
refused 1 "$OUT/nowhere" "$OUT/nowhere" "${config[@]}"
refused 1 'tests/data/ckpt: not a regular file' "$tiny" "${config[@]}"
refused 1 '4 frame blocks: which layers to keep' "$tiny/tiny.ckpt"
refused 1 'tiny.ckpt: tensors are missing \([0-9]+\): .*, \.\.\.' "$tiny/tiny.ckpt" --config full
refused 1 'nowhere.json' "$tiny/tiny.ckpt" --config "$OUT/nowhere.json"
echo '{"model": {"embed": 32, "heads": 5}}' >"$OUT/odd.json"
refused 1 'odd.json: dimension heads is 5' "$tiny/tiny.ckpt" --config "$OUT/odd.json"
head -c 500000 "$tiny/tiny.ckpt" >"$OUT/cut.ckpt"
refused 1 'cut.ckpt: ' "$OUT/cut.ckpt" "${config[@]}"
echo 'not weights' >"$OUT/text.pt"
refused 1 'text.pt: ' "$OUT/text.pt" "${config[@]}"
copy cut.safetensors
truncate -s -1 "$bad"
refused 1 'cut.safetensors: .*' "$bad" "${config[@]}"
copy gone.safetensors
replace 'encoder.hdr_conv.0.bias' 'encoder.hdr_conv.9.bias'
refused 1 'gone.safetensors: .*missing.*encoder.hdr_conv.0.bias' "$bad" "${config[@]}"
copy shape.safetensors
replace '\[1926,4\]' '[4,1926]'
refused 1 'shape.safetensors: .*another shape \(1\): encoder.*\[4,1926\], not \[1926,4\]' "$bad" \
    "${config[@]}"
copy type.safetensors
replace 'F32' 'I32'
refused 1 'not float32, bfloat16 or float16 \(1\): encoder\..* is I32; save' "$bad" "${config[@]}"
copy nan.safetensors
printf '\377\377\377\177' | dd of="$bad" bs=1 conv=notrunc status=none \
    seek=$(($(stat -c %s "$bad") - 4))
refused 1 'tensor encoder\..*: element [0-9]+ is nan, weights are within' "$bad" "${config[@]}"
printf '\377\377\177\177' | dd of="$bad" bs=1 conv=notrunc status=none \
    seek=$(($(stat -c %s "$bad") - 4))
refused 1 'tensor encoder\..*: element [0-9]+ is 3.40282e\+38, weights are within' "$bad" \
    "${config[@]}"

# outputs
expect 1 'such/a/file' convert "$tiny/tiny.ckpt" "${config[@]}" --out "$OUT/no/such/a/file"
refused 3 'needs [0-9]+ MB, --max-memory is 64 MB' --hashed 1 --config full --max-memory 64
if [ -c /dev/full ]; then
    expect 3 '/dev/full: .*No space left' convert "$tiny/tiny.ckpt" "${config[@]}" --out /dev/full
fi
echo '{"generator": "hdrig"}' >"$to"
expect 1 'weights are within' convert "$bad" "${config[@]}" --out "$to"
grep -q generator "$to" || fail "a failed conversion touched what was there"

# weights files that are none
bad=$OUT/version.hdrig
cp "$OUT/fp32.hdrig" "$bad"
replace '"version":"1"' '"version":"2"'
expect 1 'weights of version "2"' doctor --model "$bad"
cp "$OUT/fp32.hdrig" "$OUT/damaged.hdrig"
printf '\0\0\0\0' | dd of="$OUT/damaged.hdrig" bs=1 conv=notrunc status=none seek=300000
expect 1 'damaged' doctor --model "$OUT/damaged.hdrig"
finish
