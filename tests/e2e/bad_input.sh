#!/usr/bin/env bash
# Every wrong input ends with its exit code and a sentence that names the object, without a result.
. tests/e2e/common.bash
make_set good 56 3 1

refused() { # code regex arguments of reconstruct...
    local code=$1 regex=$2
    shift 2
    expect "$code" "$regex" reconstruct --out "$OUT/result" --size 56 --refine 0 "$@"
    nothing_at "$OUT/result"
}

copy() { # name: a data set to spoil, in $set
    set=$OUT/$1
    cp -r "$OUT/good" "$set"
}

# usage
expect 2 'unknown command "frobnicate"' frobnicate
expect 2 'usage: hdrig COMMAND'
expect 2 'unknown option --frobnicate' reconstruct --frobnicate
expect 2 'unknown option -x' reconstruct -x
expect 2 'unexpected argument "stray"' reconstruct --images "$OUT/good" stray
expect 2 '--out needs an argument' reconstruct --out
expect 2 '--images and --out are needed' reconstruct --images "$OUT/good"
expect 2 '--size: size: 55 is not in 56..4080' reconstruct --size 55
expect 2 '--refine: .*"many" is not a whole number' reconstruct --refine many
expect 2 '--set: unknown key "color"' reconstruct --set color=1
expect 1 'no-such.conf' reconstruct --config "$OUT/no-such.conf"
expect 2 'give either --cameras or --path' render --scene x --out y
expect 2 '--path: "moon"' render --scene x --out y --path moon
expect 2 '--what: "coffee"' bench --what coffee
expect 2 '--degree: 1.5 is not a whole number' bench --degree 1.5
expect 2 '--cameras: 2.5 is not a whole number' bench --what capture --cameras 2.5
expect 2 '--port: 80.5 is not a whole number' view "$OUT" --port 80.5
for command in reconstruct render eval bench doctor config; do
    succeed $command --help
    grep -q "^usage: hdrig $command" "$OUT/stdout.txt" || fail "no help of $command"
done

# pictures
refused 1 "$OUT/nowhere: no such folder" --images "$OUT/nowhere"
mkdir "$OUT/empty"
refused 1 "$OUT/empty: no pictures" --images "$OUT/empty"
copy one
rm "$set"/images/train_ldr_00[12]_*
refused 1 '1 view, a scene needs at least 2' --images "$set"
copy truncated
truncate -s 1000 "$set/images/train_ldr_001_0.png"
refused 1 'truncated/images/train_ldr_001_0.png' --images "$set"
copy text
echo 'not a picture' >"$set/images/train_ldr_001_0.png"
refused 1 'text/images/train_ldr_001_0.png' --images "$set"

# headers of 12000 x 9000 px before next to nothing: a PNG, a JPEG, a TIFF of one strip
mkdir "$OUT/vast"
cp tests/data/room/images/train_ldr_003_2.png "$OUT/vast/a.png"
printf '\211PNG\r\n\032\n\0\0\0\rIHDR' >"$OUT/vast.png"
printf '\0\0\056\340\0\0\043\050\010\002\0\0\0BK\346\277' >>"$OUT/vast.png"
printf '\0\0\0\nIDATx\234\003\0\0\0\0\001xx\337\213\314\020' >>"$OUT/vast.png"
cp tests/data/img/rgb.jpg "$OUT/vast.jpg"
printf '\043\050\056\340' | dd of="$OUT/vast.jpg" bs=1 seek=257 conv=notrunc 2>/dev/null
{
    printf 'II*\0\010\0\0\0\007\0'
    printf '\0\001\004\0\001\0\0\0\340.\0\0'       # width
    printf '\001\001\004\0\001\0\0\0(#\0\0'         # height
    printf '\002\001\003\0\001\0\0\0\010\0\0\0'   # 8 bits
    printf '\003\001\003\0\001\0\0\0\001\0\0\0'   # uncompressed
    printf '\006\001\003\0\001\0\0\0\001\0\0\0'   # black is 0
    printf '\021\001\004\0\001\0\0\0\152\0\0\0'   # the strip
    printf '\027\001\004\0\001\0\0\0\0\365\157\006' # its bytes
    printf '\0\0\0\0'
} >"$OUT/vast.tif"
for kind in png jpg tif; do
    cp "$OUT/vast.$kind" "$OUT/vast/b.$kind"
    echo "{\"a.png\": 1, \"b.$kind\": 1}" >"$OUT/vast/exposure.json"
    expect 1 "vast/b.$kind" reconstruct --images "$OUT/vast" --size 112 --refine 0 \
        --out "$OUT/result"
    nothing_at "$OUT/result"
    rm "$OUT/vast/b.$kind"
done

# what is not read is told at the end, and in the report
copy mixed
: >"$set/images/IMG_0001.HEIC"
succeed reconstruct --images "$set" --size 56 --refine 0 --out "$OUT/mixed_scene"
grep -q 'warning: 1 file is not read (IMG_0001.HEIC): pictures must be PNG' "$ERR" ||
    fail "nobody says that a HEIC file beside PNGs is not read"
grep -q 'IMG_0001.HEIC' "$OUT/mixed_scene/report.json" || fail "the report says nothing of it"

# exposures
mkdir -p "$OUT/phone/images"
cp tests/data/img/rgb.jpg "$OUT/phone/images/a.jpg"
cp tests/data/img/progressive.jpg "$OUT/phone/images/b.jpg"
refused 1 'EXIF of b.jpg lacks the f-number, that of a.jpg has it: .*write exposure.json' \
    --images "$OUT/phone"
mkdir "$OUT/plain"
for i in 0 1 2; do
    cp "$OUT/mixed/images/train_ldr_00${i}_0.png" "$OUT/plain/frame$i.png"
done
succeed reconstruct --images "$OUT/plain" --size 112 --refine 0 --out "$OUT/plain_scene"
grep -q 'no picture has an exposure in its EXIF: all are taken' "$OUT/plain_scene/report.json" ||
    fail "nobody says that exposures are assumed"
copy unexposed
rm "$set/exposure.json"
refused 1 "EXIF has no exposure for train_ldr_000_0.png, .* and 6 others, of 9" --images "$set"
copy gap
sed -i '/train_ldr_001_0/d' "$set/exposure.json"
refused 1 'train_ldr_001_0.png' --images "$set"
copy twice
sed -i 's/ "train_ldr_001_0.png": .*/&\n "train_ldr_001_0.png": 3,/' "$set/exposure.json"
refused 1 'exposure.json.*train_ldr_001_0.png' --images "$set"
copy negative
sed -i 's/"train_ldr_001_0.png": .*/"train_ldr_001_0.png": -1,/' "$set/exposure.json"
refused 1 'exposure.json.*train_ldr_001_0.png' --images "$set"
copy garbled
echo '{"a": ' >"$set/exposure.json"
refused 1 'garbled.*exposure.json: not JSON, or cut short: ends after 5 bytes' --images "$set"
copy not_a_number
sed -i 's/"train_ldr_001_0.png": .*/"train_ldr_001_0.png": NaN,/' "$set/exposure.json"
refused 1 'exposure.json: line [0-9]+: not JSON from "NaN," on: JSON has finite numbers only' \
    --images "$set"
sed -i 's|NaN|1/30|' "$set/exposure.json"
refused 1 'exposure.json: line [0-9]+: not JSON from "/30," on: a fraction is written' \
    --images "$set"

# cameras
mkdir "$OUT/blank"
for i in 1 2 3; do
    "$BIN/make_flat" "$OUT/blank/$i.png" 56 $((60 * i))
done
echo '{"1.png": 1, "2.png": 2, "3.png": 4}' >"$OUT/blank/exposure.json"
refused 1 'the cameras cannot be found: .*give --rig' --images "$OUT/blank" --size 70
refused 1 'views of 56 px are too small' --images "$OUT/blank"

# the cause is named: nothing to see, no parallax
mkdir "$OUT/black" "$OUT/same"
for i in 1 2 3; do
    "$BIN/make_flat" "$OUT/black/$i.png" 70 0
    cp tests/data/room/images/train_ldr_003_2.png "$OUT/same/$i.png"
    cp "$OUT/blank/exposure.json" "$OUT/black"
    echo '{"1.png": 1, "2.png": 1, "3.png": 1}' >"$OUT/same/exposure.json"
done
refused 1 'cannot be found: 3 of 3 photographs are black or saturated all over \(1.png\)' \
    --images "$OUT/black" --size 70
succeed reconstruct --images "$OUT/same" --size 224 --refine 0 --out "$OUT/same_scene"
grep -q 'guess: no parallax, 2 of 3 photographs are copies (2.png is 1.png)' \
    "$OUT/same_scene/report.json" || fail "nobody says that photographs are copies"
cp -r tests/data/room "$OUT/lost"
"$BIN/make_flat" "$OUT/lost/images/train_ldr_003_2.png" 224 0
"$BIN/make_flat" "$OUT/lost/images/train_ldr_005_4.png" 224 255
succeed reconstruct --images "$OUT/lost" --size 112 --refine 0 --out "$OUT/lost_scene"
succeed reconstruct --images "$OUT/lost" --rig none --size 112 --refine 0 --out "$OUT/found_scene"
for words in lost:'train_ldr_003_2.png is black all over and shows nothing' \
    lost:'train_ldr_005_4.png is saturated all over and shows nothing' \
    found:'train_ldr_003_2.png is left out: it is black all over'; do
    grep -q "${words#*:}" "$OUT/${words%%:*}_scene/report.json" || fail "not told: $words"
done

crowd() { # folder format-of-names count: copies of one photograph, added to its exposure.json
    local i name
    mkdir -p "$OUT/$1/images"
    for ((i = 0; i < $3; i++)); do
        printf -v name "$2" $i
        ln "$OUT/blank/1.png" "$OUT/$1/images/$name"
        echo "$([ -s "$OUT/$1/exposure.json" ] && echo , || echo '{') \"$name\": 1" \
            >>"$OUT/$1/exposure.json"
    done
}
crowd many %d.png 513
echo '}' >>"$OUT/many/exposure.json"
refused 1 '513 views, cameras can be found for at most 512' --images "$OUT/many/images" --size 448
crowd halves train_ldr_%03d_0.png 257
crowd halves test_ldr_%03d_0.png 256
echo '}' >>"$OUT/halves/exposure.json"
expect 1 '257 input and 256 test views, cameras can be found for at most 512 together' \
    eval --data "$OUT/halves" --rig none --size 70 --out "$OUT/result"
nothing_at "$OUT/result"
refused 1 "$OUT/nowhere" --images "$OUT/good" --rig "$OUT/nowhere"
copy lacking
sed -i '/train_ldr_001/d' "$set/sparse/0/images.txt"
refused 1 'sparse/0.*train_ldr_001_0.png' --images "$set"
copy aspect
sed -i 's/PINHOLE 56 56/PINHOLE 56 100/' "$set/sparse/0/cameras.txt"
refused 1 'sparse/0.*train_ldr_00.*56 x 100' --images "$set"
copy lens
sed -i 's/PINHOLE.*/FULL_OPENCV 56 56 47 47 28 28 0.1 0 0 0 0 0 0 0/' "$set/sparse/0/cameras.txt"
refused 1 'cameras.txt.*FULL_OPENCV' --images "$set"
sed -i 's/FULL_OPENCV.*/OPENCV 56 56 47 47 -5 28 0.1 0 0 0/' "$set/sparse/0/cameras.txt"
refused 1 'principal point -5, 28 outside its 56 x 56 px' --images "$set"

# memory and what is in the way
refused 3 'needs [0-9]+ MB, --max-memory is 64 MB' --images "$OUT/good" --size 448 --max-memory 64
mkdir "$OUT/precious"
echo 'do not lose me' >"$OUT/precious/thesis.txt"
expect 1 'precious: already exists and is no result of hdrig' \
    reconstruct --images "$OUT/good" --out "$OUT/precious"
[ -f "$OUT/precious/thesis.txt" ] || fail "the stranger's folder was touched"
expect 1 'thesis.txt: exists and is not a folder' \
    reconstruct --images "$OUT/good" --out "$OUT/precious/thesis.txt"

# a full disk, the kernel's stand-in for one
if [ -c /dev/full ]; then
    expect 3 '/dev/full: .*No space left' bench --what splat --gaussians 1000 --size 56 \
        --json /dev/full
    "$HDRIG" bench --what splat --gaussians 1000 --size 56 --json - >/dev/full 2>"$ERR"
    [ $? -eq 3 ] || fail "full stdout: not exit 3"
fi

# a report that does not come to be leaves the former one
echo '{"generator": "hdrig"}' >"$OUT/former.json"
expect 1 '/dev/no-camera' selftest --camera v4l2:/dev/no-camera --json "$OUT/former.json"
# ... and a place where none can be is refused before the work
expect 1 'no/folder.json' bench --what splat --gaussians 1000 --size 56 --json "$OUT/no/folder.json"
refused 1 'no/folder.json' --images "$OUT/good" --json "$OUT/no/folder.json"
expect 1 'no/folder.json' eval --data "$OUT/good" --size 56 --json "$OUT/no/folder.json"
grep -q ' step ' "$ERR" && fail "eval works before it looks where its figures go"
expect 1 'no/weights.hdrig: .*no' convert --hashed 1 --config mini --out "$OUT/no/weights.hdrig"
expect 1 "written to $OUT/precious/thesis.txt" calibrate --camera v4l2:/dev/no-camera \
    --out "$OUT/precious/thesis.txt"
expect 1 'no-such.hdrig' bench --what all --model "$OUT/no-such.hdrig"
grep -q generator "$OUT/former.json" || fail "the former report is lost"
[ -z "$(find "$OUT" -maxdepth 1 -name '.tmp-*')" ] || fail "something unfinished is left"

# scenes
expect 1 'nowhere: No such file' render --scene "$OUT/nowhere" --path orbit --out "$OUT/frames"
succeed reconstruct --images "$OUT/good" --size 56 --refine 0 --out "$OUT/fine"
cp -r "$OUT/fine" "$OUT/cut"
truncate -s -1 "$OUT/cut/scene.hdrig"
expect 1 'cut/scene.hdrig' render --scene "$OUT/cut" --path orbit --out "$OUT/frames"
echo '{"cams": []}' >"$OUT/cameras.json"
expect 1 'cameras.json' render --scene "$OUT/fine" --cameras "$OUT/cameras.json" --out "$OUT/frames"
expect 3 'needs [0-9]+ MB' render --scene "$OUT/fine" --path orbit --size 4000 --max-memory 100 \
    --out "$OUT/frames"
nothing_at "$OUT/frames"
finish
