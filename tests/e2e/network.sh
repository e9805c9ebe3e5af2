#!/usr/bin/env bash
# A network inside a job: refusals, known and unknown cameras, models of every kind, the same bytes
# with any number of threads, interruption. Weights are hashed, so pictures show nothing.
. tests/e2e/common.bash
golden=tests/data/golden/mini
"$BIN/make_set" "$OUT/good" 56 3 1 one || exit 1
"$BIN/golden" prepare $golden "$OUT/inputs" >"$OUT/settings.txt" || fail "no inputs"
settings=$(tr -d '\n' <$golden/index.json | sed 's/.*"model": {\([^}]*\)}.*/\1/')

model() { # name precision dimensions: $OUT/NAME.hdrig
    echo "{\"voxel_size\": 0.08, \"image_size\": 112, \"model\": {$settings$3}}" >"$OUT/$1.json"
    sed -i "s/\"name\": \"mini\", //; s/\"gs_oc\": [^]]*\], \(.*\"gs_oc\"\)/\1/" "$OUT/$1.json"
    succeed convert --hashed 1 --config "$OUT/$1.json" --precision "$2" --out "$OUT/$1.hdrig"
}
model hdr int8 ''
model exact fp32 ''
model ldr int8 ', "appearance": false'
model geometry bf16 \
    ', "appearance": false, "gauss": false, "hdr": 0, "gs_feat": 0, "gs_oc": [0, 0, 0, 0]'

refused() { # code regex arguments of reconstruct...
    local code=$1 regex=$2
    shift 2
    expect "$code" "$regex" reconstruct --out "$OUT/result" --refine 0 "$@"
    nothing_at "$OUT/result"
}
images=(--images "$OUT/inputs")

# what does not fit together
refused 2 '--dump .*--model' "${images[@]}" --dump "$OUT/dump"
refused 2 '--precision .*--model' "${images[@]}" --precision int8
refused 2 '--precision is fp32, bf16 or int8' "${images[@]}" --model x --precision fp64
refused 2 '--dump-exposures' "${images[@]}" --model x --dump "$OUT/dump" --dump-exposures 1,2
refused 1 "$OUT/nowhere.hdrig" "${images[@]}" --model "$OUT/nowhere.hdrig"
refused 1 'hdr.hdrig holds int8 weights.*fp32' "${images[@]}" --model "$OUT/hdr.hdrig" \
    --precision fp32
head -c 100000 "$OUT/hdr.hdrig" >"$OUT/cut.hdrig"
refused 1 'cut.hdrig' "${images[@]}" --model "$OUT/cut.hdrig"
expect 1 'cut.hdrig' doctor --model "$OUT/cut.hdrig"
expect 2 '--scene is finished' eval --data "$OUT/good" --scene x --model "$OUT/hdr.hdrig"
expect 2 '--what network needs --model' bench --what network

# what is missing, and what is too much
mkdir "$OUT/one" "$OUT/bare"
cp "$OUT/inputs/images/000_view0.png" "$OUT/one"
cp "$OUT"/inputs/images/*.png "$OUT/bare"
refused 1 '1 view, a scene needs at least 2' --images "$OUT/one" \
    --exposures "$OUT/inputs/exposure.json" --model "$OUT/hdr.hdrig"
refused 3 'needs [0-9]+ MB, --max-memory is 64 MB$' "${images[@]}" --model "$OUT/hdr.hdrig" \
    --max-memory 64
mb=$("$HDRIG" reconstruct "${images[@]}" --out "$OUT/result" --model "$OUT/hdr.hdrig" --refine 0 \
    --max-memory 64 2>&1 | sed -n 's/.*needs \([0-9]*\) MB.*/\1/p')
refused 3 '2 of 3 photographs would fit' "${images[@]}" --model "$OUT/hdr.hdrig" --refine 0 \
    --max-memory $((mb - 1))

# a network that overflows says where; conversion would not have let this weight through
cp "$OUT/exact.hdrig" "$OUT/huge.hdrig"
read -r header < <(od -A n -t u8 -N 8 "$OUT/huge.hdrig")
at=$(head -c $((8 + header)) "$OUT/huge.hdrig" | tr '}' '\n' |
    sed -n 's/.*"encoder.aggregator.camera_token":.*"data_offsets":\[\([0-9]*\),.*/\1/p')
printf '\377\377\177\177' | dd of="$OUT/huge.hdrig" bs=1 conv=notrunc status=none \
    seek=$((8 + header + at)) || fail "no camera_token"
overflows='the network overflows: element [0-9]+ of its agg.frame00 is .*, allowed are '
refused 1 "$overflows" "${images[@]}" --model "$OUT/huge.hdrig"
refused 1 "$overflows" "${images[@]}" --model "$OUT/huge.hdrig" --refine 5
refused 1 "$overflows" "${images[@]}" --model "$OUT/huge.hdrig" --refine 5 --set start.stereo=0
expect 1 "$overflows" eval --data "$OUT/good" --model "$OUT/huge.hdrig" --size 56 --refine 5 \
    --rig none

# cameras and exposures that nobody knows
for kind in hdr ldr geometry; do
    succeed reconstruct "${images[@]}" --model "$OUT/$kind.hdrig" --refine 0 --json - \
        --out "$OUT/$kind"
    for stage in preprocess backbone heads render total; do
        grep -q "\"$stage\": [0-9]" "$OUT/stdout.txt" || fail "$kind: no time of $stage"
    done
    succeed reconstruct "${images[@]}" --model "$OUT/$kind.hdrig" --refine 10 \
        --out "$OUT/$kind-refined"
    succeed render --scene "$OUT/$kind-refined" --path orbit --frames 2 --out "$OUT/$kind-orbit"
done
for kind in ldr geometry; do
    succeed reconstruct --images "$OUT/bare" --model "$OUT/$kind.hdrig" --refine 0 \
        --out "$OUT/$kind-bare"
done

# known cameras stay as they are, unless they are not wanted
succeed reconstruct --images "$OUT/good" --model "$OUT/hdr.hdrig" --size 56 --refine 0 \
    --out "$OUT/known"
succeed reconstruct --images "$OUT/good" --size 56 --refine 0 --out "$OUT/stereo"
cmp -s "$OUT/known/cameras.json" "$OUT/stereo/cameras.json" || fail "known cameras were changed"
succeed reconstruct --images "$OUT/good" --model "$OUT/hdr.hdrig" --size 56 --refine 0 --rig none \
    --out "$OUT/unknown"
cmp -s "$OUT/unknown/cameras.json" "$OUT/known/cameras.json" && fail "--rig none knows cameras"
succeed eval --data "$OUT/good" --model "$OUT/hdr.hdrig" --size 56 --refine 5 --json -
grep -q '"precision": "int8"' "$OUT/stdout.txt" || fail "eval does not tell the precision"
succeed eval --data "$OUT/good" --model "$OUT/hdr.hdrig" --size 56 --refine 5 --rig none --json -
for name in rot_deg_median trans_rel_median focal_rel psnr; do
    grep -q "\"$name\": [0-9]" "$OUT/stdout.txt" || fail "eval --rig none: no $name"
done

# threads
for threads in 1 2 7; do
    succeed reconstruct "${images[@]}" --model "$OUT/hdr.hdrig" --refine 0 --threads $threads \
        --out "$OUT/threads$threads"
    hash=$(sha256sum <"$OUT/threads$threads/scene.hdrig")
    [ "$hash" = "${first:=$hash}" ] || fail "scene.hdrig differs with $threads threads"
done

# a signal inside the network
interrupt_at backbone reconstruct "${images[@]}" --model "$OUT/hdr.hdrig" --size 448 --refine 0 \
    --dump "$OUT/dump" --out "$OUT/result"
code=$?
[ $code -eq 130 ] || fail "SIGINT inside the network: exit $code"
nothing_at "$OUT/result"
nothing_at "$OUT/dump"

# figures
succeed doctor --model "$OUT/hdr.hdrig"
grep -q '^model  *InstantHDR' "$OUT/stdout.txt" || fail "doctor does not tell the model"
succeed bench --what network --model "$OUT/hdr.hdrig" --views 2 --size 56 --json "$OUT/bench.json"
for name in seconds gmac gmac_per_s limit_gmac_per_s share_of_limit; do
    grep -q "\"$name\": [0-9]" "$OUT/bench.json" || fail "bench: no $name"
done
expect 1 '--size: .* multiples of 14 px, not 60' bench --what trade --size 60 \
    --model "$OUT/hdr.hdrig"
succeed bench --what trade --model "$OUT/exact.hdrig,$OUT/hdr.hdrig" --views 2,4 --size 56 \
    --images "$OUT/inputs" --json "$OUT/trade.json"
[ "$(grep -c '^int8 + attention .* 56 ' "$OUT/stdout.txt")" -eq 1 ] ||
    fail "trade: not one row with attention in floats"
for name in rotation_deg depth_aligned_percent radiance_stops psnr_db; do
    [ "$(grep -c "\"$name\": [0-9]" "$OUT/trade.json")" -eq 6 ] || fail "trade: not 6 x $name"
done
finish
