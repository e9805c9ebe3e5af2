#!/usr/bin/env bash
# hdrig calibrate and hdrig selftest on simulated cameras: each fault fails its checks, no other.
. tests/e2e/common.bash
sim=sim:kind=room,seed=5,size=56,samples=1,fps=100,clock=virtual
export TMPDIR=$OUT/tmp
mkdir "$TMPDIR"
real=sim:kind=room,seed=5,size=56,samples=1,fps=20 # slow enough for a busy machine

# bad requests
expect 1 'no daemon answers' calibrate --set control.socket="$OUT/none.socket"
expect 2 '--camera is needed' selftest
expect 2 '--what: "focus" is none of latency, range' calibrate --camera $sim --what focus
expect 2 '--longest: 0 is not in' calibrate --camera $sim --longest 0
expect 1 'begins with none of v4l2:' selftest --camera nothing
expect 1 'nowhere' selftest --camera v4l2:/dev/nowhere
expect 1 'exposure has no effect' calibrate --camera "$sim,faults=at frame 0 ignore 0" \
    --out "$OUT/none"
expect 3 'too dark' calibrate --camera "$sim,full=1e8,longest=1000" --out "$OUT/none"
[ ! -e "$OUT/none" ] || fail "a calibration that failed was written"
expect 1 'proc/calib' calibrate --camera $sim --longest 0.1 --out /proc/calib

# a calibration, and a part of it again
succeed calibrate --camera "$sim,curve=agx,claim=-1" --longest 0.2 --out "$OUT/calib"
file=$(ls "$OUT"/calib/*_56x56_rgb8.conf) || fail "no file"
grep -q '^delay      2 frames in all of 14 steps; the device does not say$' "$OUT/stdout.txt" ||
    fail "delay: $(grep delay "$OUT/stdout.txt")"
grep -q '^delay_hi = 2$' "$file" && grep -q '^crf.green = ' "$file" || fail "$file: $(cat "$file")"
curve=$(grep crf.green "$file")
succeed calibrate --camera "$sim,curve=agx,claim=-1" --what latency --out "$OUT/calib"
[ "$(grep crf.green "$file")" = "$curve" ] || fail "--what latency changes the curve"

# Checks that must fail, in their order; all others pass or are skipped.
check() { # failing options
    local want=$1 code=1 got
    [ -n "$want" ] || code=0
    "$HDRIG" selftest --camera "$2" --longest 0.2 --json "$OUT/report.json" \
        --set calibration.path="$OUT/empty" >"$OUT/stdout.txt" 2>"$ERR"
    got=$?
    [ $got -eq $code ] || fail "$2: exit $got, expected $code"
    got=$(awk '/^fail/ { printf "%s%s", n++ ? " " : "", $2 }' "$OUT/stdout.txt")
    [ "$got" = "$want" ] || fail "$2: fails \"$got\", expected \"$want\""
    grep -q "\"pass\": $([ -n "$want" ] && echo false || echo true)" "$OUT/report.json" ||
        fail "$2: the report says something else"
}
check '' "$real"
check '' "$sim,format=bggr,delay=4,gaindelay=4,metadata=absent,readback=cached"
check '' "$sim,curve=agx,claim=-1"
check 'reported' "$sim,metadata=late"
check 'delay' "$sim,claim=4"
check 'sequence' "$sim,faults=at frame 0 sequence stuck"
check 'drops' "$sim,faults=at frame 0 lose 0.05"
check 'drops' "$sim,faults=at frame 150 drop 3 nogap"
check 'timestamps' "$sim,faults=at frame 20 stamp realtime"
check 'timestamps' "$sim,faults=at frame 60 stamp jump 5"
check 'timestamps' "$sim,faults=at frame 20 stamp zero"
check 'sequence timestamps' "$sim,faults=at frame 200 duplicate"
check 'errors' "$sim,faults=at frame 50 error"
check 'ratios monotone' "$sim,faults=at frame 0 rollover 1500"
check 'reported ratios monotone bracket3 bracket5' "$sim,faults=at frame 0 quantum 0.001"
check 'gains bracket3 bracket5' "$sim,faults=at frame 0 digital 2"
for i in 364 365 366 367 368; do # while 14 requests go out back to back: see "frames" of stream
    echo "at frame $i repeat"
done >"$OUT/frozen"
check 'latching reported' "$sim,faults=$OUT/frozen"
check 'effect' "$sim,faults=at frame 0 ignore 0"
check 'stream' "$real,faults=at frame 60 stall 0"

# the daemon's calibration is used
"$HDRIG" selftest --camera "$sim,curve=agx,claim=-1" --longest 0.1 --json - \
    --set calibration.path="$OUT/calib" >"$OUT/stdout.txt" 2>"$ERR" ||
    fail "calibrated: $(cat "$ERR")"
grep -q '"calibrated": true' "$OUT/stdout.txt" || fail "the calibration was not used"
[ -z "$(ls -A "$TMPDIR")" ] || fail "left behind: $(ls "$TMPDIR")"

# Ctrl-C
"$HDRIG" calibrate --camera "$real" --out "$OUT/none" >"$OUT/stdout.txt" 2>"$ERR" &
pid=$!
while kill -INT $pid 2>/dev/null; do # ignored until the tool listens
    sleep 0.2
done
wait $pid
code=$?
[ $code -eq 130 ] || fail "Ctrl-C: exit $code, expected 130"
finish
