#!/usr/bin/env bash
# Photographs of any shape: a simulated set cut to landscape format, the same turned to portrait,
# which must be as good, and both in one set. Cameras are found.
. tests/e2e/common.bash
succeed simulate --kind room --seed 21 --views 6 --size 224 --samples 2 --out "$OUT/square"

cut() { # set filter-of-even-views filter-of-odd-views
    mkdir -p "$OUT/$1/images"
    cp "$OUT/square/exposure.json" "$OUT/$1"
    local file view
    for file in "$OUT"/square/images/*.png; do
        view=${file##*ldr_}
        view=$((10#${view%_*} / 2 % 2))
        ffmpeg -nostdin -v error -i "$file" -vf "$([ $view = 0 ] && echo "$2" || echo "$3")" \
            "$OUT/$1/images/${file##*/}" || fail "ffmpeg $file"
    done
}

measure() { # set; prints the mean PSNR of its test pictures
    succeed eval --data "$OUT/$1" --rig none --size 224 --refine 30 --protocol native \
        --json "$OUT/eval.json"
    number "$OUT/eval.json" ldr psnr
}

cut landscape crop=224:168 crop=224:168
cut portrait crop=224:168,transpose=1 crop=224:168,transpose=1
cut mixed crop=224:168 crop=168:224
landscape=$(measure landscape)
portrait=$(measure portrait)
echo "landscapes $landscape dB, portraits $portrait dB"
at_least "PSNR of landscapes" "$landscape" 24
at_least "PSNR of portraits" "$portrait" "$(awk -v x="$landscape" 'BEGIN { print x - 0.7 }')"
at_least "PSNR of landscapes" "$landscape" "$(awk -v x="$portrait" 'BEGIN { print x - 0.7 }')"
at_least "PSNR of both shapes" "$(measure mixed)" 22

# a scene of both: pictures, cameras and page have the shapes of the photographs
succeed reconstruct --images "$OUT/mixed" --rig none --size 168 --refine 10 --out "$OUT/scene"
for shape in '4 "w": 168, "h": 126' '2 "w": 126, "h": 168'; do
    [ "$(grep -c "${shape#* }" "$OUT/scene/cameras.json")" = "${shape%% *}" ] ||
        fail "cameras: not $shape"
done
grep -q '"px":\[168,126\]' "$OUT/scene/view.html" || fail "the page has another shape"
succeed render --scene "$OUT/scene/scene.hdrig" --path inputs --out "$OUT/frames"
succeed eval --data "$OUT/mixed" --scene "$OUT/scene" --rig none

# pictures of another shape than the scene's are no reason to fail: memory for both was counted
succeed reconstruct --images "$OUT/square" --rig none --size 168 --refine 0 --out "$OUT/squares"
succeed eval --data "$OUT/landscape" --scene "$OUT/squares" --rig none

# two zooms of one camera whose pictures do not tell: found when asked, else there is a hint
succeed simulate --kind room --seed 93 --views 8 --samples 1 --spread 0.5 --exposures 0.25,1,4 \
    --lens fov=70,size=448x336 --lens fov=45,size=448x336 --out "$OUT/zooms"
mkdir "$OUT/bare"
cp "$OUT/zooms/exposure.json" "$OUT/bare"
for view in 0 1 2 3 4 5 6 7; do
    ffmpeg -nostdin -v error -i "$OUT/zooms/images/train_ldr_00${view}_$((view % 3)).png" \
        "$OUT/bare/train_ldr_00${view}_$((view % 3)).png" || fail ffmpeg
done
bare=(reconstruct --images "$OUT/bare" --rig none --refine 0)
succeed "${bare[@]}" --out "$OUT/alike"
grep -q 'if photographs were zoomed or cropped' "$OUT/alike/report.json" || fail "no hint"
succeed "${bare[@]}" --set cameras.same=each --out "$OUT/each"
at_least "views placed" "$(number "$OUT/each/report.json" cameras views_placed)" 6

expect 1 'become a view that is less than 64 px narrow' reconstruct --images "$OUT/mixed" \
    --rig none --size 70 --out "$OUT/no"
nothing_at "$OUT/no"
finish
