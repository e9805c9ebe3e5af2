#!/usr/bin/env bash
# Photographs through lenses that distort: a simulated rig with a barrel lens and with a fisheye,
# its pictures undistorted because sparse/0 says how, the radiance with them; and the same set with
# the distortion kept secret, which must be worse.
. tests/e2e/common.bash
simulate=(simulate --kind room --seed 21 --views 5 --size 140 --samples 2)

measure() { # set; prints the mean PSNR of its test pictures
    succeed eval --data "$1" --size 140 --refine 40 --protocol native --json "$OUT/eval.json"
    number "$OUT/eval.json" ldr psnr
}

succeed "${simulate[@]}" --out "$OUT/straight"
straight=$(measure "$OUT/straight")

succeed "${simulate[@]}" --lens k1=-0.3,k2=0.06 --out "$OUT/barrel"
grep -q '^1 RADIAL 140 140 .* -0.2999' "$OUT/barrel/sparse/0/cameras.txt" ||
    fail "no lens is written"
barrel=$(measure "$OUT/barrel")
grep -q '5 photographs of 140 x 140 px undistorted (RADIAL): ' "$ERR" || fail "the lens is not told"
hdr=$(number "$OUT/eval.json" hdr psnr)
at_least "PSNR through a barrel lens" "$barrel" "$(awk -v x="$straight" 'BEGIN { print x - 1 }')"
at_least "PSNR of radiance through a barrel lens" "$hdr" 20

# The paper's squares are undistorted, and their radiance with them
succeed eval --data "$OUT/barrel" --size 140 --refine 40 --json "$OUT/eval.json"
at_least "PSNR of radiance of squares through a barrel lens" \
    "$(number "$OUT/eval.json" hdr psnr)" 26

# Held-back photographs are compared as they were taken
likeness() { "$BIN/compare" display "$1" "$2" | cut -d ' ' -f 1; }
succeed eval --data "$OUT/barrel" --size 140 --refine 40 --protocol native --out "$OUT/as_taken"
held=test_ldr_000_1.png
at_least "PSNR of a held-back photograph as taken" \
    "$(likeness "$OUT/as_taken/ldr/$held" "$OUT/barrel/images/$held")" 20

cp -r "$OUT/barrel" "$OUT/secret"
sed -i 's/^1 RADIAL 140 140 \([0-9.]*\) .*/1 PINHOLE 140 140 \1 \1 70 70/' \
    "$OUT/secret/sparse/0/cameras.txt"
secret=$(measure "$OUT/secret")
at_least "PSNR with the distortion told" "$barrel" "$(awk -v x="$secret" 'BEGIN { print x + 0.5 }')"

succeed "${simulate[@]}" --fov 120 --lens fisheye,k1=-0.02 --out "$OUT/fisheye"
succeed reconstruct --images "$OUT/fisheye" --size 140 --refine 0 --out "$OUT/scene"
grep -q 'undistorted (OPENCV_FISHEYE)' "$ERR" || fail "the fisheye is not told"
grep -q '"undistorted": \[' "$OUT/scene/report.json" || fail "the report lacks the fisheye"

# Nobody says anything about cameras or lens
succeed simulate --kind room --seed 31 --views 9 --size 224 --samples 1 --lens k1=-0.2 \
    --out "$OUT/unknown"
succeed reconstruct --images "$OUT/unknown" --rig none --size 224 --refine 0 --out "$OUT/found"
grep -q '9 photographs undistorted: the lens was found to be SIMPLE_RADIAL' "$ERR" ||
    fail "the lens that was found is not told"
k1=$(sed -n 's/.*"k1": *\(-[0-9.]*\).*/\1/p' "$OUT/found/report.json")
at_least "the k1 that was found" "$k1" -0.22
at_least "the true k1 and 0.02 more" -0.18 "$k1"
succeed reconstruct --images "$OUT/unknown" --rig none --size 224 --refine 0 \
    --set cameras.lens=pinhole --model none --out "$OUT/ignored"
grep -q '"k1"' "$OUT/ignored/report.json" && fail "a pinhole was asked for"

# The axis of the lens does not meet the middle: 9 and -6.7 px of 224
succeed simulate --kind room --seed 31 --views 9 --size 224 --samples 1 \
    --lens k1=-0.15,centre=0.54/0.47 --out "$OUT/shifted"
succeed reconstruct --images "$OUT/shifted" --rig none --size 224 --refine 0 \
    --set cameras.principal=1 --out "$OUT/axis"
right=$(grep -A 1 '"principal_px"' "$OUT/axis/report.json" | sed -n 's/^ *\([-0-9.]*\),$/\1/p')
at_least "the principal point, px right of the middle" "$right" 7
at_least "the principal point, from above" 11 "$right"
grep -q '"principal_px"' "$OUT/found/report.json" && fail "nobody asked for the principal point"

# The scene as its photographs were taken, those 2 stops below the middle exposure
view=$(grep -o '"name": "[^"]*"' "$OUT/found/cameras.json" | grep -n '_2.png' | head -n 1)
frame=$(printf 'frame_%04d.png' "$((${view%%:*} - 1))")
photograph=$OUT/unknown/images/$(sed 's/.*: "\(.*\)"/\1/' <<<"$view")
succeed render --scene "$OUT/found" --path inputs --ev -2 --lens photographed --out "$OUT/taken"
succeed render --scene "$OUT/found" --path inputs --ev -2 --out "$OUT/drawn"
taken=$(likeness "$OUT/taken/$frame" "$photograph")
drawn=$(likeness "$OUT/drawn/$frame" "$photograph")
at_least "PSNR of a photograph drawn with its lens" "$taken" 20
at_least "PSNR with its lens and 2 dB less" "$taken" \
    "$(awk -v x="$drawn" 'BEGIN { print x + 2 }')"
succeed render --scene "$OUT/found" --cameras "$OUT/found/cameras.json" --lens photographed \
    --size 112 --hdr --out "$OUT/half"
expect 2 '--lens is photographed' render --scene "$OUT/found" --path inputs --lens wide \
    --out "$OUT/no"
expect 2 'a path has no photographs' render --scene "$OUT/found" --path orbit \
    --lens photographed --out "$OUT/no"

# Three kinds of camera in one rig, each with its own size; which one took a photograph is in its
# EXIF data.
succeed "${simulate[@]}" --lens k1=-0.35,k2=0.1,fov=75,size=160x120,v2=-0.4 \
    --lens k1=0.1,fov=50,size=100x150,gain=1.3,wb=1.1/1/0.8 --lens fisheye,fov=150,cos4 \
    --out "$OUT/mixed"
grep -q '^3 OPENCV_FISHEYE 140 140 ' "$OUT/mixed/sparse/0/cameras.txt" || fail "no third camera"
for i in 1 2 3; do
    grep -aq "simulated camera $i" "$OUT/mixed/images/train_ldr_00$((i - 1))_0.png" ||
        fail "no EXIF data of camera $i"
done
succeed reconstruct --images "$OUT/mixed" --size 140 --refine 0 --out "$OUT/scene"

# Two kinds of camera that differ in vignetting, gain and white balance, which are found, and make
# up for what they cost; the paper's protocol knows nothing of them.
light=(simulate --kind room --seed 31 --views 8 --size 224 --samples 1 --spread 0.5
    --exposures 0.25,1,4)
succeed "${light[@]}" --lens v2=-0.4,gain=1.25,wb=1.1/1/0.9 --lens v2=-0.1,gain=0.8,fov=55 \
    --out "$OUT/light"
succeed eval --data "$OUT/light" --size 224 --refine 60 --protocol native --json "$OUT/eval.json"
gain=$(sed -n 's/.*"gain_stops": \[[-0-9.]*, \([-0-9.]*\).*/\1/p' "$OUT/eval.json" | head -n 1)
corner=$(sed -n 's/.*"corner_stops": \([-0-9.]*\).*/\1/p' "$OUT/eval.json" | head -n 1)
at_least "the gain that was found, stops (0.32)" "$gain" 0.27
at_least "the gain that was found, from above" 0.37 "$gain"
at_least "the light in the corners, stops (-0.74)" "$corner" -0.84
at_least "the light in the corners, from above" -0.6 "$corner"
known=$(number "$OUT/eval.json" ldr psnr)
succeed reconstruct --images "$OUT/light" --size 224 --refine 60 --out "$OUT/lit"
succeed eval --data "$OUT/light" --scene "$OUT/lit" --json "$OUT/stored.json"
at_least "PSNR of the scene as stored, with its light" "$(number "$OUT/stored.json" ldr psnr)" \
    "$(awk -v x="$known" 'BEGIN { print x - 0.2 }')"
succeed eval --data "$OUT/light" --size 224 --refine 60 --json "$OUT/eval.json"
grep -q '"light"' "$OUT/eval.json" && fail "the paper's protocol models light"
at_least "PSNR with light modelled" "$known" \
    "$(awk -v x="$(number "$OUT/eval.json" ldr psnr)" 'BEGIN { print x + 1 }')"

expect 2 '--lens: k1 of 11, allowed are -10 to 10' "${simulate[@]}" --lens k1=11 --out "$OUT/no"
for bad in '' k9=1 k1=1,k1=2 k1=nan fisheye,p1=1 k1=0.1,; do
    expect 2 '^hdrig simulate: --lens: ".*" is not a list like' "${simulate[@]}" --lens "$bad" \
        --out "$OUT/no"
done
nothing_at "$OUT/no"
finish
