#!/usr/bin/env bash
# From a simulated world to a scene without known cameras: cameras and quality within stated bounds,
# the same bytes with any number of threads, worlds at the extremes, bad requests.
. tests/e2e/common.bash

simulate() { # name arguments...
    local name=$1
    shift
    succeed simulate --out "$OUT/$name" --samples 1 "$@"
}

# bad requests
expect 2 '--out is needed' simulate
expect 2 '--kind: "moon" is none of room.yard' simulate --out "$OUT/no" --kind moon
expect 2 '--kind: "room.yard" is none of' simulate --out "$OUT/no" --kind 'room|yard'
expect 2 '--views: 2.5 is not a whole number' simulate --out "$OUT/no" --views 2.5
expect 2 '--views: 1 is not in 2..128' simulate --out "$OUT/no" --views 1
expect 2 '--moving: 0.31 is not in 0.002..0.3' simulate --out "$OUT/no" --moving 0.31
expect 2 '--flicker: 3.5 is not in 0..3' simulate --out "$OUT/no" --flicker 3.5
expect 2 '--local-tone: "x" is none of' simulate --out "$OUT/no" --local-tone x
expect 2 '--lamp-switch: 1.5 is not in 0..1' simulate --out "$OUT/no" --lamp-switch 1.5
expect 2 '--orbit: only --kind park' simulate --out "$OUT/no" --kind yard --orbit 20
expect 2 '--orbit: 181 is not in 1..180' simulate --out "$OUT/no" --kind park --orbit 181
expect 2 '--exposures: .*like 0.125,1,8' simulate --out "$OUT/no" --exposures 1,x
expect 2 '--exposures: 1 does not come after' simulate --out "$OUT/no" --exposures 4,1
expect 3 'needs [0-9]+ MB' simulate --out "$OUT/no" --size 1008 --views 32 --max-memory 64
nothing_at "$OUT/no"

# an orbit in a park, depth of every view
simulate park --seed 3 --kind park --views 4 --size 112 --orbit 20 --depth
for i in 0 1 2 3; do
    [ -s "$OUT/park/images_hdr/train_hdr_00$i.exr" ] || fail "no depth of input $i"
done

# the layout, twice the same
simulate room --seed 7 --kind room --views 7 --size 224
grep -Eq '^draw [0-9]+ % step [1-9]' "$ERR" && grep -q '^write 100 % ' "$ERR" ||
    fail "no progress is shown: $(cat "$ERR")"
simulate again --seed 7 --kind room --views 7 --size 224 --threads 3
diff -r "$OUT/room" "$OUT/again" >/dev/null || fail "a world is not the same with three threads"
[ "$(ls "$OUT/room/images" | wc -l)" -eq $((7 * 3 + 6 * 5)) ] || fail "not every picture is there"

# somebody passes by: the world and what is held out stay
simulate passed --seed 7 --kind room --views 7 --size 224 --moving 0.1
diff -r "$OUT/room/images_hdr" "$OUT/passed/images_hdr" >/dev/null || fail "another truth"
differ=$(diff -qr "$OUT/room/images" "$OUT/passed/images" | sed 's/.*images.//; s/ differ//' | sort)
[ "$differ" = "$(ls "$OUT/passed/truth/masks")" ] && [ "$(wc -l <<<"$differ")" -eq 7 ] ||
    fail "somebody passes by in $differ"

# a telephone's tones: the same radiance, other photographs
simulate toned --seed 3 --kind park --views 4 --size 112 --orbit 20 --depth --local-tone base
diff -r "$OUT/park/images_hdr" "$OUT/toned/images_hdr" >/dev/null || fail "tones: another truth"
cmp -s "$OUT"/{park,toned}/images/train_ldr_000_0.png && fail "no tones"

# light flickers: what is held out stays, and reconstruction finds it
simulate lit --seed 7 --kind room --views 7 --size 224 --flicker 0.3
diff -r "$OUT/room/images_hdr" "$OUT/lit/images_hdr" >/dev/null || fail "flicker: another truth"
simulate tinted --seed 7 --kind room --views 7 --size 224 --white-balance 0.3
diff -r "$OUT/room/images_hdr" "$OUT/tinted/images_hdr" >/dev/null || fail "balance: another truth"
for set in room lit; do
    succeed eval --data "$OUT/$set" --size 224 --refine 0 --json "$OUT/$set.json"
done
grep -q '"used": false' "$OUT/room.json" && ! grep -q light_stops "$OUT/room.json" ||
    fail "drift where light is steady"
grep -q '"used": true' "$OUT/lit.json" && grep -q 'light was not the same' "$OUT/lit.json" ||
    fail "light that flickers is not found"
[ "$(grep -c '"light_stops"' "$OUT/lit.json")" -eq 7 ] || fail "not every photograph has its light"
at_least "stops that a left-out surface is better with drift" "$(awk \
    -v a="$(number "$OUT/lit.json" drift left_out_error_without)" \
    -v b="$(number "$OUT/lit.json" drift left_out_error_with)" 'BEGIN { print a - b }')" 0.02

# so is white balance
for set in room tinted; do
    succeed eval --data "$OUT/$set" --protocol native --size 224 --refine 0 --json "$OUT/$set.json"
done
grep -q '"white_balance": false' "$OUT/room.json" || fail "white balance of none changes"
grep -q 'white balance was not the same' "$OUT/tinted.json" || fail "white balance is not found"
[ "$(grep -c '"gain_stops"' "$OUT/tinted.json")" -ge 7 ] || fail "not each photograph has its gains"
at_least "stops that a surface left out is better with balance" "$(awk \
    -v a="$(number "$OUT/tinted.json" drift left_out_error_without_white_balance)" \
    -v b="$(number "$OUT/tinted.json" drift left_out_error_with)" 'BEGIN { print a - b }')" 0.02

# so is light that changes within a bracket
for set in room lit; do
    succeed reconstruct --images "$OUT/$set" --size 224 --refine 0 --model none \
        --out "$OUT/$set-all"
done
grep -q light_stops "$OUT/room-all/report.json" && fail "brackets of steady light are changed"
at_least "share of the light that is found within brackets" "$(awk -F'[":, ]+' '
    FNR == NR { if ($2 ~ /png$/) truth[$2] = $3; next }
    $2 == "name" { name = $3 }
    $2 == "place" { place = $3; n[place]++; name_of[place, n[place]] = name }
    $2 == "light_stops" { found[name] = $3 }
    END {
        for (p in n) {
            t = f = 0
            for (k = 1; k <= n[p]; k++) {
                t += truth[name_of[p, k]] / n[p]
                f += found[name_of[p, k]] / n[p]
            }
            for (k = 1; k <= n[p]; k++) {
                a = truth[name_of[p, k]] - t
                b = found[name_of[p, k]] - f
                all += a * a
                left += (a - b) * (a - b)
            }
        }
        print (all > 0 ? 1 - sqrt(left / all) : 0)
    }' "$OUT/lit/truth/light.json" "$OUT/lit-all/report.json")" 0.4

# a lamp is on in some places: that is said of them, and of no other set
simulate lamp --seed 7 --kind room --views 6 --size 112 --lamp-switch 0.34
succeed reconstruct --images "$OUT/lamp" --size 112 --refine 0 --out "$OUT/lamp-scene"
said='a lamp or the sun lights (train_ldr_[0-9]+_[0-9].png(, )?){2} otherwise'
grep -Eq "warning: $said" "$ERR" && grep -Eq "$said" "$OUT/lamp-scene/report.html" ||
    fail "a lamp that is switched is not told: $(cat "$ERR")"
lit=$(sed -n 's/.*"\(train.*\)": 1,*/\1/p' "$OUT/lamp/truth/lamp.json")
other=$(awk -F'"' '/"name":/ { name = $4 } /"other_light": true/ { print name }' \
    "$OUT/lamp-scene/report.json" | sort)
[ "$lit" = "$other" ] && [ "$(wc -l <<<"$lit")" -eq 6 ] ||
    fail "a lamp is on in $lit, not in $other"
! grep -q 'lights .* otherwise' "$OUT/room.json" "$OUT/lit.json" || fail "a lamp that is not there"

# nobody knows the cameras
succeed eval --data "$OUT/room" --size 224 --rig none --refine 100 --json "$OUT/found.json"
at_least "PSNR without cameras" "$(number "$OUT/found.json" ldr psnr)" 21
at_least "one degree less the error of cameras" \
    "$(awk -v e="$(number "$OUT/found.json" pose rot_deg_median)" 'BEGIN { print 1 - e }')" 0

# one of the test views shows something else: it is named, and moves no other camera
simulate elsewhere --seed 8 --kind yard --views 2 --size 224 --exposures 0.015625,0.0625,0.25,1,4
mkdir "$OUT/strange"
cp -r "$OUT/room"/{images,exposure.json,sparse} "$OUT/strange"
cp "$OUT"/elsewhere/images/test_ldr_000_*.png "$OUT/strange/images"
succeed eval --data "$OUT/strange" --size 224 --rig none --refine 0 --json "$OUT/strange.json"
grep -q '1 of the test views (test_ldr_000_0.png) has too little in common' "$ERR" ||
    fail "a test view of another place: $(cat "$ERR")"
at_least "one degree less the error of cameras, with one of another place" \
    "$(awk -v e="$(number "$OUT/strange.json" pose rot_deg_median)" 'BEGIN { print 1 - e }')" 0

# the same bytes with any number of threads
for threads in 1 3; do
    succeed reconstruct --images "$OUT/room" --size 224 --rig none --refine 0 --threads $threads \
        --out "$OUT/threads$threads"
    hash=$(sha256sum <"$OUT/threads$threads/scene.hdrig")
    [ "$hash" = "${first:=$hash}" ] || fail "cameras differ with $threads threads"
done
succeed eval --data "$OUT/room" --scene "$OUT/threads3" --rig none --json -
grep -q '"rot_deg_median": [0-9]' "$OUT/stdout.txt" || fail "eval --scene --rig none: no pose"
seen=$(number "$OUT/stdout.txt" ldr_seen_exposures images)
[ $((2 * seen)) -eq $((3 * $(number "$OUT/stdout.txt" ldr_unseen_exposures images))) ] ||
    fail "$seen test pictures have the exposures of inputs: three of five"

# extremes: a scene, or a sentence that says why not
extreme() { # name arguments of simulate
    local name=$1 code
    shift
    simulate "$name" --size 112 "$@"
    "$HDRIG" reconstruct --images "$OUT/$name" --size 112 --rig none --refine 20 \
        --out "$OUT/$name-scene" --json - >"$OUT/stdout.txt" 2>"$ERR"
    code=$?
    if [ $code -eq 0 ]; then
        grep -Eqi '\b(nan|inf)' "$OUT/stdout.txt" && fail "$name: not finite"
    else
        [ $code -eq 1 ] && grep -q 'cameras cannot be found' "$ERR" ||
            fail "$name: exit $code: $(tail -n 1 "$ERR")"
    fi
}
extreme lamp --kind dark --views 4 --exposures 0.0009765625,1,1024
extreme plain --kind plain --views 4
extreme mirror --kind mirror --views 4
extreme black --kind room --views 4 --exposures 1e-9,1e-8,1
extreme white --kind room --views 4 --exposures 1,1e8,1e9
extreme still --kind room --views 4 --spread 0
extreme wide --kind yard --views 3 --spread 1
extreme many --kind room --views 16

# two of eight photographs show something: that the scene may be wrong is said
simulate few --seed 5 --kind room --views 8 --exposures 1e-9,1e-8,1 --size 112 --samples 2
succeed eval --data "$OUT/few" --size 112 --rig none --refine 0 --json -
grep -q 'only 2 of 8 photographs could be placed' "$OUT/stdout.txt" || fail "few: no warning"

# where even the cameras of these are a guess, the others are left out all the same
mkdir -p "$OUT/fewer"
for i in 2 5 0 1 3 4 6 7; do
    for copy in 0 1 2 3; do
        [ $copy -gt 0 ] && { [ $i = 2 ] || [ $i = 5 ]; } && continue
        cp "$OUT/few/images/train_ldr_00${i}_$((i % 3)).png" "$OUT/fewer/$i$copy.png"
    done
done
echo '{"*": 1}' >"$OUT/fewer/exposure.json"
succeed reconstruct --images "$OUT/fewer" --size 112 --refine 0 --model none \
    --out "$OUT/fewer-scene"
grep -q 'cameras are a guess: 24 of 26 photographs are black' "$ERR" || fail "fewer: $(cat "$ERR")"
grep -q 'only 2 of 26 photographs could be placed' "$ERR" || fail "fewer: $(cat "$ERR")"

# far apart: cameras of all are found by a closer look
simulate far --kind room --seed 35 --views 5 --spread 0.7 --exposures 1 --size 224 --samples 2
succeed reconstruct --images "$OUT/far" --size 224 --rig none --refine 0 --model none \
    --out "$OUT/far-scene"
at_least "views far apart" "$(number "$OUT/far-scene/report.json" cameras views_placed)" 5
at_least "px, closer" "$(number "$OUT/far-scene/report.json" cameras edge_px)" 448

# which is not taken where there is no memory for it
mkdir -p "$OUT/copies"
for i in {10..49}; do
    cp "$OUT/far/images/train_ldr_000_0.png" "$OUT/copies/$i.png"
done
echo '{"*": 1}' >"$OUT/copies/exposure.json"
short() { # exit code, sentence, MB
    expect "$1" "$2" reconstruct --images "$OUT/copies" --size 224 --model none --refine 0 \
        --out "$OUT/copies-scene" --max-memory "$3"
}
short 3 'needs [0-9]* MB' 64
short 0 'cameras are a guess: no parallax' "$(sed -n 's/.* needs \([0-9]*\) MB.*/\1/p' "$ERR")"
finish
