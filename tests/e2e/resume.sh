#!/usr/bin/env bash
# A job that was killed at any moment goes on with --resume to the same bytes; a checkpoint that
# does not fit, or is damaged, is refused.
. tests/e2e/common.bash
make_set set 88 4 1
mkdir "$OUT/results"
result=$OUT/results/scene
checkpoint=$OUT/results/.scene.checkpoint
job=(reconstruct --images "$OUT/set" --size 88 --refine 1200 --set job.checkpoint_s=1)

figures() { # folder: the report without times and memory
    sed '/"seconds": {/,/}/d; /peak/d' "$1/report.json"
}

# kill -9 at a random moment after its next checkpoint
kill_after() { # checkpoint arguments...
    local checkpoint=$1 before pid k
    shift
    before=$(stat -c %i "$checkpoint" 2>/dev/null)
    "$HDRIG" "$@" >"$OUT/stdout.txt" 2>"$ERR" &
    pid=$!
    for ((k = 0; k < 600; k++)); do
        kill -0 $pid 2>/dev/null || break
        [ "$(stat -c %i "$checkpoint" 2>/dev/null)" = "$before" ] || break
        sleep 0.05
    done
    sleep "0.$((RANDOM % 10))$((RANDOM % 10))"
    kill -9 $pid 2>/dev/null && kills=$((kills + 1))
    wait $pid 2>/dev/null
}

# A former result of this name does not matter, nor does a checkpoint that is not asked for.
succeed "${job[@]}" --resume --out "$OUT/whole"
grep -q 'no checkpoint, the job starts from the beginning' "$ERR" || fail "nothing to go on from"
[ ! -e "$OUT/.whole.checkpoint" ] || fail "a complete job left its checkpoint"

# Ctrl-C keeps what was done since
interrupt_at refine "${job[@]}" --resume --out "$result"
[ $? -eq 130 ] || fail "Ctrl-C: no interruption: $(tail -n 1 "$ERR")"
grep -q 'step [0-9]* is kept in .*: --resume goes on from there' "$ERR" ||
    fail "Ctrl-C: $(tail -n 2 "$ERR")"
cp "$checkpoint" "$OUT/kept"
# another job, a damaged file, a file of another program
expect 1 'other options' "${job[@]}" --resume --seed 9 --out "$result"
expect 1 'other photographs' "${job[@]}" --resume --size 80 --out "$result"
printf 'x' | dd of="$checkpoint" bs=1 seek=5000 conv=notrunc 2>/dev/null
expect 1 'scene.checkpoint is damaged: start without --resume' "${job[@]}" --resume \
    --out "$result"
head -c 3000 "$OUT/kept" >"$checkpoint"
expect 1 'scene.checkpoint is damaged' "${job[@]}" --resume --out "$result"
cp "$OUT/kept" "$checkpoint"

kills=0
for ((i = 0; i < 6; i++)); do
    kill_after "$checkpoint" "${job[@]}" --resume --out "$result"
    [ -e "$result" ] && break
done
echo "$kills kills"
[ "$kills" -ge 2 ] || fail "only $kills kills"

succeed "${job[@]}" --resume --out "$result"
cmp "$OUT/whole/scene.hdrig" "$result/scene.hdrig" || fail "other bytes after interruptions"
diff <(figures "$OUT/whole") <(figures "$result") || fail "other figures after interruptions"
[ "$(ls -A "$OUT/results")" = scene ] || fail "left behind: $(ls -A "$OUT/results")"

# ---- eval: the same, with its pictures and its report ----

measure=(eval --data "$OUT/set" --size 88 --refine 1200 --set job.checkpoint_s=1)
result=$OUT/results/measured
checkpoint=$OUT/results/.measured.checkpoint
expect 2 'resume needs --out' "${measure[@]}" --resume
expect 2 'scene is finished' eval --data "$OUT/set" --scene "$OUT/whole" --resume --out "$result"
succeed "${measure[@]}" --out "$OUT/measured"
cp "$OUT/stdout.txt" "$OUT/table.txt"

interrupt_at refine "${measure[@]}" --out "$result"
[ $? -eq 130 ] || fail "eval, Ctrl-C: no interruption: $(tail -n 1 "$ERR")"
[ -e "$checkpoint" ] || fail "eval, Ctrl-C: no checkpoint: $(tail -n 2 "$ERR")"
cp "$checkpoint" "$OUT/kept"
expect 1 'other options' "${measure[@]}" --resume --seed 9 --out "$result"
kills=0
kill_after "$checkpoint" "${measure[@]}" --resume --out "$result"
[ "$kills" -eq 1 ] || fail "eval ended before it could be killed"

succeed "${measure[@]}" --resume --out "$result"
for pictures in ldr hdr; do
    diff -r "$OUT/measured/$pictures" "$result/$pictures" || fail "eval: other $pictures"
done
diff <(figures "$OUT/measured") <(figures "$result") || fail "eval: other figures"
diff <(sed 1d "$OUT/table.txt") <(sed 1d "$OUT/stdout.txt") || fail "eval: another table"
[ ! -e "$checkpoint" ] || fail "a complete eval left its checkpoint"

# a budget: no checkpoint
succeed "${job[@]}" --resume --budget 20 --refine 5 --out "$OUT/timed"
grep -q 'with a time budget has no checkpoint: it starts from the beginning' "$ERR" ||
    fail "budget: $(head -n 1 "$ERR")"

# no room for a checkpoint: a warning, and the job goes on
if [ "$(id -u)" -eq 0 ]; then
    mkdir "$OUT/small"
    if mount -t tmpfs -o size=200k tmpfs "$OUT/small" 2>/dev/null; then
        trap 'umount "$OUT/small"' EXIT
        expect 3 'the result takes up to' "${job[@]}" --out "$OUT/small/scene"
        need=$(sed -n 's/.*takes up to \([0-9]*\) bytes.*/\1/p' "$ERR")
        mount -o remount,size=$((need + 400000)) "$OUT/small"
        succeed "${job[@]}" --out "$OUT/small/scene"
        [ "$(grep -c 'no checkpoint, the job goes on without' "$ERR")" -eq 1 ] ||
            fail "no room: $(head -n 3 "$ERR")"
    fi
fi
finish
