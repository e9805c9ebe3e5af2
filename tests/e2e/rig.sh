#!/usr/bin/env bash
# A rig of six simulated cameras: calibrated from takes, then known to reconstructions, which check
# it; a camera that is elsewhere than the calibration says; takes that do not fit; bad files.
. tests/e2e/common.bash
RIG=$OUT/rig.json

camera() { # view
    echo "sim:kind=room,seed=5,size=224,samples=1,fps=100,views=6,view=$1"
}

take() { # name, views...
    local name=$1 view cameras=()
    shift
    for view in "$@"; do
        cameras+=(--camera "$(camera "$view")")
    done
    succeed capture "${cameras[@]}" --out "$OUT/$name"
}

quick() { # scene, arguments...: of the second take, without refinement
    local scene=$1
    shift
    succeed reconstruct --images "$OUT/two" --out "$OUT/$scene" --refine 0 --model none "$@"
}

moved() { # scene: how many cameras the report says have moved
    grep -c '"moved": true' "$OUT/$1/report.json"
}

take one 0 1 2 3 4 5
take two 0 1 2 3 4 5
take one-few 0 1 2 3 4
succeed rig calibrate "$OUT/one" "$OUT/two" --out "$RIG"
grep -q '6 cameras from 2 takes' "$OUT/stdout.txt" || fail "it says: $(cat "$OUT/stdout.txt")"
[ "$(grep -c deviation "$RIG")" = 6 ] || fail "no deviations in $(cat "$RIG")"
[ "$(grep -c covariance "$RIG")" = 6 ] || fail "no covariances in $(cat "$RIG")"
[ "$(grep -c '^  train_0._0.*png  *+- 0\.[0-9]* degrees, [0-9.]* % of' "$OUT/stdout.txt")" = 6 ] ||
    fail "not every camera has its error: $(cat "$OUT/stdout.txt")"

# again, over the former one, but over nothing else
succeed rig calibrate "$OUT/one" --out "$RIG"
cp "$RIG" "$OUT/first.json"
echo mine >"$OUT/mine.json"
expect 1 'mine.json' rig calibrate "$OUT/one" --out "$OUT/mine.json"
grep -q mine "$OUT/mine.json" || fail "a file of another program was replaced"
succeed rig calibrate "$OUT/one" "$OUT/two" --out "$RIG"
cmp -s "$OUT/first.json" "$RIG" && fail "the second take changes nothing"

# a rig photographs other worlds, and is calibrated from them as well; camera 5 fits them worst, by
# half a pixel of these small photographs
SIX=tests/data/rig.json
for seed in 62 63; do
    succeed simulate --rig "$SIX" --seed $seed --samples 1 --exposures 0.25,1,4 \
        --out "$OUT/w$seed"
done
[ "$(grep -c '^[0-9]* PINHOLE 224 224 ' "$OUT/w62/sparse/0/cameras.txt")" = 6 ] ||
    fail "a simulated rig has cameras $(cat "$OUT/w62/sparse/0/cameras.txt")"
succeed rig calibrate "$OUT/w62" "$OUT/w63" --out "$OUT/again.json" --set cameras.same=size
grep -q warning "$ERR" && fail "a rig that stays: $(cat "$ERR")"
awk '/"fx"/ {
        sub(/.*"fx": /, "")
        if (NR == FNR) was = $0 + 0
        away = (NR == FNR ? was / 194 : $0 / was) - 1
        if (away ^ 2 > 0.02 ^ 2) exit 1
        n++
    }
    END { if (n != 12) exit 1 }' "$SIX" "$OUT/again.json" ||
    fail "focal lengths of the rig and again: $(grep -ho '"fx": [0-9.]*' "$SIX" "$OUT/again.json")"

# the fourth camera had been knocked by 0.7 degrees in one take: said where all can be placed, else
# it is the camera that cannot
awk -F', ' -v OFS=', ' '/"q":/ && ++n == 4 { $2 += 0.006 } 1' "$SIX" >"$OUT/knocked.json"
succeed simulate --rig "$OUT/knocked.json" --seed 8 --samples 1 --exposures 0.25,1,4 --out "$OUT/w8"
"$HDRIG" rig calibrate "$OUT/w62" "$OUT/w63" "$OUT/w8" --out "$OUT/again.json" \
    --set cameras.same=size >/dev/null 2>"$ERR"
grep -Eq 'w8: the camera of train_ldr_003_0.png stands .* leave this take out|the camera of '\
'train_ldr_003_0.png has too few points that agree .* or leave out' "$ERR" ||
    fail "a take of another rig is not named: $(cat "$ERR")"
expect 2 'no --views, --lens' simulate --rig "$SIX" --views 4 --out "$OUT/refused"
expect 2 'none.json' simulate --rig "$OUT/none.json" --out "$OUT/refused"

# known, and as the calibration says, also as a former version wrote it
sed -z 's/,\n *"covariance": \[[^]]*\]//g' "$RIG" >"$OUT/former.json"
quick former --set "rig.file=$OUT/former.json"
quick known --set "rig.file=$RIG"
cmp -s "$OUT/known/scene.ply" "$OUT/former/scene.ply" || fail "a former rig.json is another rig"
[ "$(grep -c '"checked": true' "$OUT/known/report.json")" = 6 ] || fail "cameras are not checked"
[ "$(moved known)" = 0 ] || fail "still cameras are accused: $(cat "$ERR")"
grep -q '"found": true' "$OUT/known/report.json" && fail "known cameras were searched"

# without the setting, or with other cameras given, they are not
quick alone
grep -q '"rig"' "$OUT/alone/report.json" && fail "a rig is checked without rig.file"
quick other --set "rig.file=$RIG" --rig none
grep -q '"rig"' "$OUT/other/report.json" && fail "--rig none does not win"

# the fourth camera looks two pixels to the side
awk '/"cx"/ && ++n == 4 { sub(/"cx": [0-9.]*/, "\"cx\": 115") } { print }' "$RIG" >"$OUT/off.json"
quick solved --set "rig.file=$OUT/off.json"
[ "$(moved solved)" = 1 ] || fail "solve: $(cat "$ERR")"
grep -q 'warning: the camera of train_03_0[0-9].png has moved.*as it is now' "$ERR" ||
    fail "solve does not name the camera: $(cat "$ERR")"
quick warned --set "rig.file=$OUT/off.json" --set rig.moved=warn
grep -q 'train_03_0[0-9].png has moved.*calibrate the rig again' "$ERR" ||
    fail "warn: $(cat "$ERR")"
expect 1 'train_03_0[0-9].png has moved' reconstruct --images "$OUT/two" --out "$OUT/refused" \
    --refine 0 --model none --set "rig.file=$OUT/off.json" --set rig.moved=refuse
nothing_at "$OUT/refused"

# the daemon hands it to every reconstruction
socket=$(mktemp -d)/control
settings() { # rig.file
    printf '%s\n' "store.path = $OUT/store" "results.path = $OUT/results" "store.reserve_mb = 1" \
        "control.socket = $socket" "http.port = 0" "rig.file = $1" "refine.steps = 0" \
        "calibration.path = $OUT/calibration" >"$OUT/hdrig.conf"
    for view in 0 1 2 3 4 5; do
        echo "camera.$((view + 1)) = $(camera $view)"
    done >>"$OUT/hdrig.conf"
}
settings "$RIG"
"${HDRIG%/*}/hdrigd" --config "$OUT/hdrig.conf" 2>"$OUT/hdrigd.txt" &
daemon=$!
for _ in $(seq 300); do
    id=$("$HDRIG" capture --config "$OUT/hdrig.conf" 2>"$ERR") && break
    sleep 0.1
done
id=${id##*/}
for _ in $(seq 1800); do
    [ -e "$OUT/results/$id/report.json" ] && break
    sleep 0.1
done
[ "$(grep -c '"checked": true' "$OUT/results/$id/report.json")" = 6 ] ||
    fail "the daemon does not use rig.file: $(cat "$OUT/hdrigd.txt")"
kill -TERM $daemon
wait $daemon || fail "the daemon ends with $?"
rm -r "${socket%/*}"
refuse() { # sentence
    "${HDRIG%/*}/hdrigd" --check --config "$OUT/hdrig.conf" 2>"$ERR" && fail "accepted: no $1"
    grep -q "$1" "$ERR" || fail "hdrigd says: $(cat "$ERR")"
}
settings "$OUT/none.json"
refuse 'rig.file: .*none.json'
succeed rig calibrate "$OUT/one-few" --out "$OUT/few.json"
settings "$OUT/few.json"
refuse 'few.json has no camera.6: calibrate'

# takes that are not of this rig, or of none
expect 1 'few has 5 cameras, .*one has 6: all takes must be of one rig' \
    rig calibrate "$OUT/one" "$OUT/one-few" --out "$OUT/no.json"
nothing_at "$OUT/no.json"
expect 1 'none/rig.json: ' reconstruct --images "$OUT/two" --out "$OUT/refused" \
    --set "rig.file=$OUT/none/rig.json"
printf '{"cameras": [' >"$OUT/cut.json"
expect 1 'cut.json: ' reconstruct --images "$OUT/two" --out "$OUT/refused" \
    --set "rig.file=$OUT/cut.json"
take single 0
expect 1 'single: 1 cameras, a rig of 2 to 128' rig calibrate "$OUT/single" --out "$OUT/no.json"
expect 1 'two/images/none: ' rig calibrate "$OUT/two/images/none" --out "$OUT/no.json"
expect 1 'nowhere' rig calibrate "$OUT/one" --out "$OUT/nowhere/rig.json"
expect 2 'is none of its commands' rig --out "$OUT/no.json"
expect 2 'takes and --out are needed' rig calibrate --out "$OUT/no.json"
finish
