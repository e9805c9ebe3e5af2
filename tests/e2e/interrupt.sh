#!/usr/bin/env bash
# Ctrl-C, kill or a full disk stop the tool: the former result stays whole and no partial one
# appears.
. tests/e2e/common.bash
make_set set 56 3 1
job=(reconstruct --images "$OUT/set" --size 56)
mkdir "$OUT/results"
result=$OUT/results/scene
succeed "${job[@]}" --refine 0 --out "$result"
before=$(cd "$result" && sha256sum report.json scene.hdrig)

unchanged() { # why
    [ "$(cd "$result" && sha256sum report.json scene.hdrig)" = "$before" ] ||
        fail "$1: former result changed"
}

only_the_result() { # why
    [ "$(ls -A "$OUT/results")" = scene ] || fail "$1: left behind: $(ls -A "$OUT/results")"
}

# Start a long refinement, wait until it runs, send a signal.
stop_by() { # signal
    : >"$ERR" # the former progress must not be taken for the new one
    "$HDRIG" "${job[@]}" --refine 100000 --out "$result" >"$OUT/stdout.txt" 2>"$ERR" &
    local pid=$! i
    for ((i = 0; i < 300; i++)); do
        grep -q '^refine' "$ERR" && break
        sleep 0.1
    done
    kill -"$1" $pid
    wait $pid
}

for signal in INT TERM; do
    stop_by $signal
    code=$?
    [ $code -eq 130 ] || fail "$signal: exit $code, expected 130"
    grep -q 'reconstruct: interrupted$' "$ERR" || fail "$signal: $(tail -n 1 "$ERR")"
    unchanged $signal
    rm "$OUT/results/.scene.checkpoint" || fail "$signal: no checkpoint"
    only_the_result $signal
done

stop_by KILL
unchanged KILL
[ "$(ls -A "$OUT/results" | wc -l)" -eq 2 ] || fail "KILL: expected the result and a .tmp folder"
succeed "${job[@]}" --refine 0 --out "$result"
only_the_result "run after KILL"
before=$(cd "$result" && sha256sum report.json scene.hdrig)

# kill -9 while files are being written
for delay in 0.00 0.02 0.04 0.06 0.08 0.10 0.12 0.14; do
    "$HDRIG" "${job[@]}" --refine 0 --out "$result" >"$OUT/stdout.txt" 2>"$ERR" &
    pid=$!
    for ((i = 0; i < 300; i++)); do
        [ -e "$OUT/results/.tmp-scene-$pid/ldr" ] && break
        kill -0 $pid 2>/dev/null || break
    done
    sleep $delay
    kill -9 $pid 2>/dev/null
    wait $pid 2>/dev/null
    succeed render --scene "$result" --path inputs --out "$OUT/frames"
    [ -f "$result/report.json" ] || fail "kill -9 after $delay s: no report.json"
done
succeed "${job[@]}" --refine 0 --out "$result"
only_the_result "run after kill -9"
before=$(cd "$result" && sha256sum report.json scene.hdrig)

# no space: a limit on the size of files, and where we may mount one, a small file system
(
    ulimit -f 30 # KiB
    expect 3 'scene.*: .*there is room for 30720' "${job[@]}" --refine 0 --out "$result"
    exit "$failures"
) || fail "file size limit"
unchanged "file size limit"
only_the_result "file size limit"
mkdir "$OUT/small"
if mount -t tmpfs -o size=200k tmpfs "$OUT/small" 2>/dev/null; then
    trap 'umount "$OUT/small"' EXIT
    expect 3 'small/scene: the result takes up to [0-9]+ bytes, there is room for' \
        "${job[@]}" --refine 100000 --out "$OUT/small/scene"
    ! grep -q ' step ' "$ERR" || fail "no space is told after work: $(head -n 1 "$ERR")"
    nothing_at "$OUT/small/scene"
else
    echo "no right to mount a small file system: left out"
fi
finish
