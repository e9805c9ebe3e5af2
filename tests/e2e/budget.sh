#!/usr/bin/env bash
# A scene within a time: size and steps follow it, and the report says which; time enough changes
# nothing.
. tests/e2e/common.bash
succeed simulate --kind room --seed 5 --views 4 --samples 1 --lens size=504x378 --out "$OUT/data"
make=(reconstruct --images "$OUT/data" --model none)

succeed "${make[@]}" --refine 0 --out "$OUT/start"
start=$(number "$OUT/start/report.json" seconds total)
seconds=$(awk -v x="$start" 'BEGIN { print int(x + 4) }')
succeed "${make[@]}" --budget "$seconds" --out "$OUT/short"
grep -Eq ": $seconds s in all: pictures of 448 px, .* s for refinement, [0-9]+ steps$" \
    "$OUT/stdout.txt" ||
    fail "not on the terminal"
grep -q "\"$seconds s in all: pictures of 448 px, " "$OUT/short/report.json" || fail "not told"
grep -q 'of 1000 steps: no more fit into the time"' "$OUT/short/report.json" || fail "all steps"
# all 1000 steps take more than five times as long; other tests take of this machine what they want
at_least "2 x $seconds s" "$(awk -v x="$seconds" 'BEGIN { print 2 * x }')" \
    "$(number "$OUT/short/report.json" seconds total)"

# the size is not ours to choose if it is given
succeed "${make[@]}" --budget 4 --size 504 --out "$OUT/given"
grep -q '"pictures of 504 px' "$OUT/given/report.json" || fail "the size was not kept"

# no time at all gives a scene, too
succeed "${make[@]}" --budget 1 --out "$OUT/none"
grep -Eq '"refine_steps": [0-9]{1,2},' "$OUT/none/report.json" || fail "steps without time"

steps=(--refine 3 --size 300)
succeed "${make[@]}" "${steps[@]}" --out "$OUT/any"
succeed "${make[@]}" "${steps[@]}" --budget 3600 --out "$OUT/plenty"
cmp "$OUT/any/scene.hdrig" "$OUT/plenty/scene.hdrig" || fail "time that is left changes a scene"

for bad in -1 x 1e9 1.5; do
    expect 2 budget "${make[@]}" --budget "$bad" --out "$OUT/bad"
    [ ! -e "$OUT/bad" ] || fail "$bad: a result"
done
finish
