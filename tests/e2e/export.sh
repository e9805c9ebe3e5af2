#!/usr/bin/env bash
# A scene for other programs: cameras, undistorted photographs and points, read back by ourselves
# and, where it is installed (apt-get install colmap), by COLMAP, whose files we read in turn.
. tests/e2e/common.bash

succeed simulate --kind room --seed 21 --views 4 --size 140 --samples 1 --lens k1=-0.3,k2=0.06 \
    --out "$OUT/world"
succeed reconstruct --images "$OUT/world" --size 112 --refine 5 --out "$OUT/scene"
export=(export "$OUT/scene" --images "$OUT/world")
succeed "${export[@]}" --colmap "$OUT/colmap"
grep -Eq ': 12 images, [0-9]{4,} points$' "$OUT/stdout.txt" || fail "images and points: none told"
succeed "${export[@]}" --nerfstudio "$OUT/nerf/transforms.json"
succeed "${export[@]}" --lens photographed --colmap "$OUT/taken"
succeed "${export[@]}" --lens photographed --nerfstudio "$OUT/nerf-taken/transforms.json"
for set in colmap nerf taken nerf-taken; do
    (cd "$OUT/$set" && sha256sum --quiet -c files.sha256) || fail "$set: not the files of its list"
done
head -n 1 "$OUT/nerf/points.ply" | grep -q '^ply$' || fail "no points beside transforms.json"

# The same cameras and pictures by all ways: the same scene, and its cameras again.
cameras() { grep -E '"(q|w|model)"|photograph' "$1/cameras.json" | sed 's/"name": "[^"]*", //'; }
near() { # two files with the same numbers within 1e-5
    paste -d '\n' "$1" "$2" | awk '{ gsub(/[^-+.0-9e]+/, " ") } NR % 2 { n = split($0, a); next }
        { if (split($0, b) != n) exit 1
          for (i = 1; i <= n; i++) if ((a[i] - b[i]) ^ 2 > 1e-10) exit 1 }'
}
for set in colmap nerf taken nerf-taken; do
    succeed reconstruct --images "$OUT/$set" --size 112 --refine 5 --out "$OUT/again"
    lens=$(grep -c '"photograph": .*"RADIAL"' "$OUT/again/cameras.json")
    case $set in *taken) want=4 ;; *) want=0 ;; esac
    [ "$lens" = "$want" ] || fail "$set: $lens photographs with a lens, not $want"
    cameras "$OUT/again" | grep -v photograph >"$OUT/$set.txt"
done
near "$OUT/colmap.txt" "$OUT/nerf.txt" || fail "nerfstudio's cameras are not COLMAP's"
near "$OUT/taken.txt" "$OUT/nerf-taken.txt" || fail "nerfstudio's lenses are not COLMAP's"
succeed reconstruct --images "$OUT/world" --rig "$OUT/scene/cameras.json" --size 112 --refine 5 \
    --out "$OUT/again"
cmp -s "$OUT/again/cameras.json" "$OUT/scene/cameras.json" ||
    fail "a result's cameras are not those of its photographs"

# Photographs that the scene lacks are left out, and said.
cp -r "$OUT/world" "$OUT/more"
cp "$OUT/more/images/train_ldr_000_0.png" "$OUT/more/images/train_ldr_009_0.png"
succeed export "$OUT/scene" --images "$OUT/more" --colmap "$OUT/fewer"
grep -q ': 1 photographs are left out' "$ERR" || fail "the left out one is not told"

# Nothing of others is replaced.
mkdir "$OUT/thesis" && echo mine >"$OUT/thesis/notes.txt"
expect 1 'notes.txt|files.sha256' "${export[@]}" --colmap "$OUT/thesis"
expect 1 'notes.txt|files.sha256' "${export[@]}" --nerfstudio "$OUT/thesis/transforms.json"
expect 1 'is read from it' "${export[@]}" --colmap "$OUT/scene"
[ "$(cat "$OUT/thesis/notes.txt")" = mine ] || fail "notes are gone"
expect 2 'one of --colmap and --nerfstudio' "${export[@]}"
expect 2 'one of --colmap and --nerfstudio' "${export[@]}" --colmap "$OUT/a" \
    --nerfstudio "$OUT/b/t.json"
expect 2 'whose folder is written whole' "${export[@]}" --nerfstudio "$OUT/nerf"
expect 2 'the folder of a result' export "$OUT/scene/scene.ply" --images "$OUT/world" \
    --colmap "$OUT/a"
expect 2 '--lens is photographed' "${export[@]}" --colmap "$OUT/a" --lens fisheye
expect 1 'no pictures' export "$OUT/scene" --images "$OUT/thesis" --colmap "$OUT/a"
nothing_at "$OUT/a"

if ! command -v colmap >/dev/null; then
    echo "not checked: that COLMAP reads the export, it is not installed"
    finish
    exit
fi
for set in colmap taken; do
    colmap model_analyzer --path "$OUT/$set/sparse/0" >"$OUT/analyzed.txt" 2>&1
    grep -Eq 'Registered images: 12$' "$OUT/analyzed.txt" || fail "COLMAP does not read $set"
    grep -Eq 'Points: [0-9]{4,}$' "$OUT/analyzed.txt" || fail "COLMAP reads no points of $set"
    for kind in TXT BIN; do # what COLMAP writes says the same to us
        back=$OUT/$set-$kind
        mkdir -p "$back/sparse/0"
        colmap model_converter --input_path "$OUT/$set/sparse/0" --output_path "$back/sparse/0" \
            --output_type "$kind" >"$OUT/converted.txt" 2>&1 || fail "COLMAP cannot convert $set"
        ln -s "../$set/images" "$back/images"
        cp "$OUT/$set/exposure.json" "$back/"
        succeed reconstruct --images "$back" --size 112 --refine 0 --out "$OUT/back"
        cameras "$OUT/back" | grep -v photograph >"$OUT/back.txt"
        cmp -s "$OUT/back.txt" "$OUT/$set.txt" || fail "$set through COLMAP's $kind: other cameras"
    done
done
grep -q '^1 RADIAL 140 140 .* -0.29999' "$OUT/taken-TXT/sparse/0/cameras.txt" ||
    fail "COLMAP reads another lens"
finish
