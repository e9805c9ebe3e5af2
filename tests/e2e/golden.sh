#!/usr/bin/env bash
# The whole network against a golden set: hashed weights, its pictures, every tensor.
#   golden.sh [SET [PRECISION...]]
# By hand, for a set elsewhere:
#   make all tests && HDRIG=build/hdrig BIN=build/x86_64/tests/e2e OUT=/tmp/golden \
#       tests/e2e/golden.sh /path/of/full224 fp32
# MEMORY: bound in MB.
. tests/e2e/common.bash
set=${1:-tests/data/golden/mini}
shift
[ $# -gt 0 ] || set -- fp32 bf16 int8

mkdir -p "$OUT"
rm -rf "$OUT/inputs"
settings=$("$BIN/golden" prepare "$set" "$OUT/inputs") || fail "$set cannot be read"
size=$(echo "$settings" | sed 's/.*size=\([0-9]*\).*/\1/')
exposures=${settings##*exposures=}
seed=$(sed -n 's/.*"seed": \([0-9]*\).*/\1/p' "$set/index.json" | head -n 1)

for precision in "$@"; do
    model=$OUT/$precision.hdrig
    [ -s "$model" ] || succeed convert --hashed "$seed" --config "$set/index.json" \
        --precision "$precision" --max-memory "${MEMORY:-4000}" --out "$model"
    succeed reconstruct --images "$OUT/inputs" --model "$model" --precision "$precision" \
        --size "$size" --refine 0 --dump "$OUT/dump-$precision" --dump-exposures "$exposures" \
        --max-memory "${MEMORY:-4000}" --out "$OUT/scene-$precision"
    echo "== $precision"
    "$BIN/golden" compare "$set" "$OUT/dump-$precision" "$precision" ||
        fail "$precision is beyond its bars"
    grep -q "\"precision\": \"$precision\"" "$OUT/scene-$precision/report.json" ||
        fail "report.json does not tell $precision"
done
finish
