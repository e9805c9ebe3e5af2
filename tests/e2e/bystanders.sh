#!/usr/bin/env bash
# No file of the user is lost: the tool refuses to replace foreign files, also in CALLS random calls
# (300) from SEED against a tree of them. CALLS=20000 tests/e2e/bystanders.sh takes 10 minutes.
. tests/e2e/common.bash
tree=$OUT/template
mkdir "$tree"

# somebody else's, and ours with something of the user's in it
mkdir "$tree"/{photos,thesis,listed,empty,.tmp-new-99999999}
"$BIN/make_set" "$tree/world" 56 3 1 || exit 1
cp "$tree"/world/images/train_* "$tree/photos"
mv "$tree/photos/$(ls "$tree/photos" | head -n 1)" "$tree/photos/a.png"
for f in thesis/thesis.txt thesis/report.json listed/a foreign.{ply,json,mp4,hdrig,spz,glb,html} \
    .tmp-new-99999999/diary a.pending; do
    echo "written by somebody: $f" >"$tree/$f"
done
echo '{"generator": "somebody"}' >"$tree/thesis/report.json"
(cd "$tree/listed" && sha256sum a >files.sha256)
ln -s thesis "$tree/link"
ln -s foreign.ply "$tree/linked.ply"
(cd "$tree" && find . \( -type f -o -type l \) -printf '%P\n') >"$OUT/template.list"
for scene in made noted edited; do
    succeed reconstruct --images "$tree/world" --size 56 --refine 0 --out "$tree/$scene"
done
echo "mine" >"$tree/noted/notes.txt"
echo "mine" >>"$tree/edited/scene.ply"
echo noted/notes.txt >>"$OUT/template.list"
for kind in ply hdrig spz; do
    succeed convert-scene "$tree/made" --out "$tree/own.$kind"
done
succeed eval --data "$tree/world" --size 56 --refine 0 --json "$tree/own.json"

# the ways that lost something once
lost() { # regex command...
    local regex=$1
    shift
    cp -a "$tree" "$OUT/tree"
    (cd "$OUT/tree" && find . -type f -exec sha256sum {} + | sort) >"$OUT/before"
    (cd "$OUT/tree" && exec "$hdrig" "$@" --size 56) >"$OUT/stdout.txt" 2>"$ERR"
    [ $? = 1 ] || fail "hdrig $*: not refused"
    grep -Eq -e "$regex" "$ERR" || fail "hdrig $*: $(tail -n 1 "$ERR")"
    (cd "$OUT/tree" && find . -type f -exec sha256sum {} + | sort) | cmp -s - "$OUT/before" ||
        fail "hdrig $*: something changed"
    rm -rf "$OUT/tree"
}
hdrig=$(realpath "$HDRIG")
lost 'thesis: already exists and is no result' reconstruct --images world --out thesis
lost 'noted/notes.txt: was not written by hdrig' reconstruct --images world --out noted --force
lost 'edited/scene.ply: was changed' reconstruct --images world --out edited
lost 'photos is read from it' reconstruct --images photos --exposures world/exposure.json \
    --rig world/sparse/0 --out photos
lost 'world: already exists|is read from it' reconstruct --images world --out world --force
lost 'made is read from it' render --scene made --path inputs --out made --force
lost 'made/scene.ply is read from it' render --scene made/scene.ply --path inputs --out made
lost 'made/cameras.json is read from it' reconstruct --images world --rig made/cameras.json \
    --out made
lost 'own.ply: exists and is not a folder' render --scene made --path inputs --out own.ply
lost 'foreign.json: already exists' eval --data world --refine 0 --json foreign.json
cp -a "$tree" "$OUT/tree"
succeed reconstruct --images "$tree/world" --size 56 --refine 0 --force --out "$OUT/tree/edited"
succeed reconstruct --images "$tree/world" --size 56 --refine 0 --out "$OUT/tree/made"
(cd "$OUT/tree/made" && sha256sum --quiet -c files.sha256) || fail "files.sha256 does not verify"
grep -q mine "$OUT/tree/edited/scene.ply" && fail "--force: not replaced"

# warnings are told at the end, and counted
mkdir "$OUT/one"
cp "$tree"/world/images/train_*.png "$OUT/one"
sed 's/: [0-9.]*/: 1/' "$tree/world/exposure.json" >"$OUT/one/exposure.json"
one=(reconstruct --images "$OUT/one" --rig "$tree/world/sparse/0" --size 56 --refine 0)
succeed "${one[@]}" --out "$OUT/warned"
grep -Eq "dB.*, [0-9]+ warnings?$" "$OUT/stdout.txt" || fail "warnings are not counted"
grep -q '^hdrig reconstruct: warning: .*one exposure' "$ERR" || fail "a warning is not told"
expect 1 'warnings?, which --strict makes an error' "${one[@]}" --out "$OUT/warned" --strict
[ -f "$OUT/warned/scene.ply" ] || fail "--strict: no scene"

"$BIN/random_calls" "$hdrig" "$tree" "$OUT/stage" "${SEED:-1}" "${CALLS:-300}" ||
    fail "a random call did harm"
finish
