#!/usr/bin/env bash
# A scene goes through every kind of file: the losses stay below their bounds, and a file that is no
# scene is refused by name.
. tests/e2e/common.bash
make_set set 112 4 1

figure() { # file member
    sed -n "s/.*\"$2\": \\([-0-9.e+]*\\).*/\\1/p" "$1" | head -n 1
}

# converted IN OUT dB [arguments]: display and radiance both keep at least so many dB
converted() {
    local in=$1 out=$2 least=$3
    shift 3
    succeed convert-scene "$in" --out "$out" --json "$OUT/loss.json" "$@"
    at_least "$out: display" "$(figure "$OUT/loss.json" display_psnr_least)" "$least"
    at_least "$out: radiance" "$(figure "$OUT/loss.json" radiance_psnr_least)" "$least"
}

# usage
expect 2 'a scene and --out are needed' convert-scene
expect 2 'a scene and --out are needed' convert-scene x.ply
expect 2 'y.obj: scenes are files' convert-scene x.ply --out y.obj
expect 2 '--spz' convert-scene x.ply --out y.spz --spz 2
succeed convert-scene --help
grep -q 'usage: hdrig convert-scene IN' "$OUT/stdout.txt" || fail "no help"

# degree 0: the sizes that were promised
succeed reconstruct --images "$OUT/set" --size 112 --refine 100 --degree-max 0 --out "$OUT/flat"
for version in 3 4; do
    converted "$OUT/flat" "$OUT/flat.spz" 40 --spz $version
    at_least "room in 12 bytes a splat of SPZ $version" \
        "$(awk -v b="$(figure "$OUT/loss.json" bytes_per_gaussian)" 'BEGIN { print 12 - b }')" 0
done

# there and back through every kind
succeed reconstruct --images "$OUT/set" --size 112 --refine 30 --out "$OUT/scene"
converted "$OUT/scene" "$OUT/a.ply" 60
grep -q 'display 100.0 dB' "$OUT/stdout.txt" && fail "half floats that lose nothing"
converted "$OUT/a.ply" "$OUT/b.glb" 90
converted "$OUT/b.glb" "$OUT/c.hdrig" 100
converted "$OUT/c.hdrig" "$OUT/d.spz" 40
converted "$OUT/d.spz" "$OUT/e.ply" 60
succeed convert-scene "$OUT/e.ply" --out "$OUT/f.html"
[ -s "$OUT/f.html" ] || fail "no page"
succeed convert-scene "$OUT/flat" --out "$OUT/flat.html"
succeed convert-scene "$OUT/flat" --out "$OUT/whole.html" --lossless
for name in flat whole; do # bytes a splat in the page, before base64
    n=$(sed -n 's/.*{"n":\([0-9]*\),.*/\1/p' "$OUT/$name.html")
    chars=$(sed -n 's/.*octet-stream">\(.*\)<.script>/\1/p' "$OUT/$name.html" | wc -c)
    declare "$name=$(awk -v n="$n" -v c="$chars" 'BEGIN { print c * 0.75 / n }')"
done
at_least "bytes a splat that the page is below 16" "$(awk -v b="$flat" 'BEGIN { print 16 - b }')" 0
at_least "bytes a splat without loss" "$whole" 32
expect 2 'lossless is for .html' convert-scene "$OUT/flat" --out "$OUT/x.ply" --lossless
[ -z "$(find "$OUT" -name '.tmp-*')" ] || fail "temporary files are left"
for kind in a.ply b.glb c.hdrig d.spz; do
    succeed render --scene "$OUT/$kind" --path inputs --size 56 --out "$OUT/render"
    [ "$(ls "$OUT/render"/*.png | wc -l)" -eq 4 ] || fail "$kind: not 4 pictures"
done

# what is left out
expect 2 '"1,2,3" is not six numbers' convert-scene x.ply --out y.ply --crop 1,2,3
expect 2 'is not six numbers' convert-scene x.ply --out y.ply --crop 0,0,0,1,1,1,2
expect 2 'is not six numbers' convert-scene x.ply --out y.ply --crop 0,0,0,1,1,inf
expect 2 'from 1 to 1 in y there is nothing' convert-scene x.ply --out y.ply --crop 0,1,0,1,1,1
expect 1 'scene: none of [0-9]* splats would be left' convert-scene "$OUT/scene" \
    --out "$OUT/g.hdrig" --crop 1e8,1e8,1e8,2e8,2e8,2e8
expect 1 'a.ply: does not say which splats are guesses' convert-scene "$OUT/a.ply" \
    --out "$OUT/g.hdrig" --without-guesses
[ ! -e "$OUT/g.hdrig" ] || fail "a file without splats"
leave_out() { # what remains and what is left out of IN, with these arguments
    succeed convert-scene "$@" --out "$OUT/g.hdrig" --json "$OUT/left.json"
    echo "$(figure "$OUT/left.json" gaussians) $(figure "$OUT/left.json" left_out)"
}
read -r all none < <(leave_out "$OUT/scene")
[ "$none" = 0 ] || fail "$none splats are left out unasked"
read -r near far < <(leave_out "$OUT/scene" --crop -1e9,-1e9,-1e9,0.1,1e9,1e9)
read -r rest near_too < <(leave_out "$OUT/scene" --crop 0.1,-1e9,-1e9,1e9,1e9,1e9)
[ "$near $far" = "$near_too $rest" ] && [ $((near + far)) = "$all" ] && [ "$far" -gt 0 ] ||
    fail "halves of $near + $far and $rest + $near_too splats of $all"
read -r proven guesses < <(leave_out "$OUT/scene" --without-guesses)
[ "$guesses" -gt 0 ] && [ $((proven + guesses)) = "$all" ] || fail "$guesses guesses of $all"
cp "$OUT/g.hdrig" "$OUT/proven.hdrig"
[ "$(leave_out "$OUT/proven.hdrig" --without-guesses)" = "$proven 0" ] ||
    fail "guesses are left, or their mark moved"

# without radiance: what is said is what happens
says() { # words of the last command
    for word; do grep -q "$word" "$ERR" || fail "no \"$word\": $(cat "$ERR")"; done
}
hide() { # FROM TO WORD...: other programs know none of these words
    cp "$1" "$2"
    for word in "${@:3}"; do LC_ALL=C sed -i "s/$word/X${word#?}/g" "$2"; done
}
hide "$OUT/b.glb" "$OUT/ldr.glb" HDRIG_gaussian_splatting_radiance
hide "$OUT/a.ply" "$OUT/ldr.ply" ihdr_log_ 'ihdr ev'
hide "$OUT/a.ply" "$OUT/ev.ply" ihdr_log_
succeed convert-scene "$OUT/d.spz" --out "$OUT/ldr.spz" --spz 4
printf '\0' | dd of="$OUT/ldr.spz" bs=1 seek=35 conv=notrunc status=none # the record's name
mv "$OUT/ldr.json" "$OUT/kept"
for kind in ply glb spz; do
    succeed convert-scene "$OUT/ldr.$kind" --out "$OUT/out.hdrig"
    says "ldr.$kind: display colours, taken as sRGB; their exposure is not known"
done
says 'splats are brighter than white: light more than 1.2 stops above it is lost'
succeed convert-scene "$OUT/ev.ply" --out "$OUT/out.hdrig"
says 'ev.ply: display colours, taken as sRGB at its own .* stops'
says 'splats are brighter than white and are kept'
mv "$OUT/kept" "$OUT/ldr.json"
for kind in ply glb spz; do
    succeed convert-scene "$OUT/ldr.$kind" --out "$OUT/back.hdrig"
    says "ldr.$kind: .* at the middle exposure of its sidecar"
done
head=$(printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 \
    rot_0 rot_1 rot_2 rot_3)
printf 'ply\nformat binary_little_endian 1.0\nelement vertex 1\n%s\nend_header\n' "$head" \
    >"$OUT/grey.ply"
head -c 56 /dev/zero >>"$OUT/grey.ply"
succeed convert-scene "$OUT/grey.ply" --out "$OUT/out.hdrig"
says 'no splat is brighter than white: if the scene had brighter light, it is lost'
converted "$OUT/scene" "$OUT/same.ply" 60
grep -q 'display colours' "$ERR" && fail "a word about display colours where there is radiance"

# files of other programs: text, and kinds that are only read
{
    sed -n '1,/end_header/p' "$OUT/grey.ply" | sed 's/binary_little_endian/ascii/'
    echo 1 2 3 0.5 0.5 0.5 2 -3 -3 -3 1 0 0 0
} >"$OUT/text.ply"
succeed convert-scene "$OUT/text.ply" --out "$OUT/out.hdrig"
says 'text.ply: display colours, taken as sRGB'
{
    head -c 12 /dev/zero
    printf '\0\0\200\077%.0s' 1 2 3 # 1.0
    printf '\377\200\020\377\377\200\200\200'
} >"$OUT/one.splat"
succeed convert-scene "$OUT/one.splat" --out "$OUT/out.hdrig"
says 'one.splat: no splat is brighter than white'
expect 2 'x.splat: such files are read, not written' convert-scene "$OUT/scene" --out x.splat
data=tests/data/splats
for name in two.sog one.sog one/meta.json one level2.ksplat; do
    succeed convert-scene $data/$name --out "$OUT/other.hdrig" --json "$OUT/other.json"
    says "$data/$name: display colours, taken as sRGB; their exposure is not known"
    [ "$(figure "$OUT/other.json" gaussians)" = 48 ] || fail "$name: not 48 splats"
done
for kind in ksplat sog; do
    expect 2 "x.$kind: such files are read, not written" convert-scene "$OUT/scene" --out x.$kind
done

# what is no scene, and places that do not do
for name in a.ply b.glb c.hdrig d.spz; do
    head -c 1000 "$OUT/$name" >"$OUT/cut.${name#*.}"
    expect 1 "cut.${name#*.}: " convert-scene "$OUT/cut.${name#*.}" --out "$OUT/none.ply"
    head -c 1000 /dev/urandom >"$OUT/noise.${name#*.}"
    expect 1 "noise.${name#*.}: " convert-scene "$OUT/noise.${name#*.}" --out "$OUT/none.ply"
done
for kind in splat ksplat sog; do
    head -c 5000 /dev/urandom >"$OUT/noise.$kind"
    expect 1 "noise.$kind: " convert-scene "$OUT/noise.$kind" --out "$OUT/none.ply"
done
head -c 9000 $data/two.sog >"$OUT/cut.sog"
expect 1 'cut.sog: ' convert-scene "$OUT/cut.sog" --out "$OUT/none.ply"
mkdir "$OUT/lone"
cp $data/one/meta.json "$OUT/lone"
expect 1 'lone/.*webp: ' convert-scene "$OUT/lone" --out "$OUT/none.ply"
expect 1 'nowhere.ply' convert-scene "$OUT/nowhere.ply" --out "$OUT/none.ply"
expect 1 'set/scene.hdrig' convert-scene "$OUT/set" --out "$OUT/none.ply"
expect 1 'no/.*such' convert-scene "$OUT/scene" --out "$OUT/no/such.ply"
echo '{"mine": 1}' >"$OUT/none.json"
expect 2 'none.json is not a sidecar' convert-scene "$OUT/scene" --out "$OUT/none.ply"
[ ! -e "$OUT/none.ply" ] || fail "a refused conversion left a file"
finish
