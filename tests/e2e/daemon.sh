#!/usr/bin/env bash
# The daemon with simulated cameras: captures on command, by timer and over HTTP, refusals, ends,
# and its state after a crash.
. tests/e2e/common.bash
DAEMON=${HDRIG%/*}/hdrigd
LOG=$OUT/hdrigd.txt
SOCKET=$(mktemp -d)/control # a socket's path is short
PORT=$((20000 + $$ % 20000))
pid=

settings() { # lines...
    printf '%s\n' "store.path = $OUT/store" "results.path = $OUT/results" "job.run = 0" \
        "calibration.path = $OUT/calibration" "control.socket = $SOCKET" "http.port = $PORT" \
        "store.reserve_mb = 1" "camera.1 = $(camera 0)" "$@" >"$OUT/hdrig.conf"
}

camera() { # view options
    echo "sim:kind=room,seed=5,size=56,samples=1,fps=100,views=4,view=$1${2-}"
}

start() {
    "$DAEMON" --config "$OUT/hdrig.conf" 2>"$LOG" &
    pid=$!
    for _ in $(seq 300); do
        [ -S "$SOCKET" ] && state >/dev/null && return
        sleep 0.1
    done
    fail "the daemon does not answer: $(cat "$LOG")"
}

ask() { # command...
    "$HDRIG" "$@" --config "$OUT/hdrig.conf"
}

state() {
    ask status --json 2>/dev/null | sed 's/^{"ok": true, "state": "\([a-z]*\)".*/\1/'
}

wait_for() { # state
    for _ in $(seq 300); do
        [ "$(state)" = "$1" ] && return
        sleep 0.1
    done
    fail "never $1, but $(state)"
}

count() { # name
    ask status --json | sed "s/.*\"$1\": \\([0-9]*\\).*/\\1/"
}

stop() {
    local code
    kill -TERM $pid
    wait $pid
    code=$?
    [ $code -eq 0 ] || fail "the daemon ends with $code: $(tail -n 1 "$LOG")"
    [ ! -e "$SOCKET" ] || fail "the socket is left"
}

http() { # method path header
    exec 3<>"/dev/tcp/127.0.0.1/$PORT" || return
    printf '%s %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n' "$1" "$2" >&3
    printf 'Content-Length: 0\r\n%s\r\n\r\n' "$3" >&3
    cat <&3
    exec 3>&-
}

# ends with this code and a sentence
refused() { # code regex arguments...
    local code=$1 regex=$2 got
    shift 2
    timeout 20 "$DAEMON" "$@" >"$OUT/stdout.txt" 2>"$ERR"
    got=$?
    [ $got -eq "$code" ] || fail "hdrigd $*: exit $got, expected $code: $(tail -n 1 "$ERR")"
    grep -Eq -e "$regex" "$ERR" || fail "hdrigd $*: \"$(tail -n 1 "$ERR")\" does not match $regex"
}

# settings
settings
[ "$("$DAEMON" --config "$OUT/hdrig.conf" --check)" = "the settings are good" ] || fail "--check"
refused 2 'unknown option --now' --now
settings "camera.sharpness = 3"
refused 78 'hdrig.conf:9: unknown key "camera.sharpness"' --config "$OUT/hdrig.conf"
settings "trigger.busy = later"
refused 78 'hdrig.conf:9: trigger.busy: "later" is none of reject\|queue\|coalesce' \
    --config "$OUT/hdrig.conf"
settings "http.address = 0.0.0.0"
refused 78 'http.token must be set' --config "$OUT/hdrig.conf"
settings "camera.2 = webcam:0"
refused 78 'camera webcam:0: begins with none of .*v4l2:' --config "$OUT/hdrig.conf"
settings "trigger.1 = timer:0"
refused 78 'timer' --config "$OUT/hdrig.conf"
settings
expect 1 'no daemon answers.*systemctl start hdrigd, or give the --config FILE' \
    capture --config "$OUT/hdrig.conf"

# a capture on command
settings "camera.2 = $(camera 1)"
start
wait_for armed
for words in "camera.1: $(camera 0)" "captures: $OUT/store, scenes: none are made" \
    "page: http://127.0.0.1:$PORT" \
    "commands: hdrig capture|session|calibrate|status|cancel --config $OUT/hdrig.conf, at"; do
    grep -qF "$words" "$LOG" || fail "hdrigd does not say what it serves: $words"
done
take=$(ask capture 2>"$ERR") || fail "capture: $(cat "$ERR")"
[ -f "$take/manifest.json" ] && [ -f "$take/exposure.json" ] || fail "no take at \"$take\""
[ "$(ls "$take"/merged/*.exr | wc -l)" -eq 2 ] || fail "not every camera's bracket is merged"
refused 1 'another (hdrigd|process)' --config "$OUT/hdrig.conf"

# calibrated by the daemon, which has the cameras; captures wait for it
ask calibrate --what latency >"$OUT/calibrate.txt" 2>"$ERR" || fail "calibrate: $(cat "$ERR")"
[ "$(grep -c '^delay ' "$OUT/calibrate.txt")" -eq 2 ] && grep -q '^camera.2: sim:' \
    "$OUT/calibrate.txt" || fail "calibrate says: $(cat "$OUT/calibrate.txt")"
[ "$(find "$OUT/calibration" -type f | wc -l)" -eq 2 ] || fail "no calibration of each camera"
wait_for armed
ask calibrate >/dev/null 2>"$ERR" &
asking=$!
wait_for calibrating
ask capture 2>"$OUT/refused.txt" && fail "a capture during a calibration"
grep -q 'calibrates camera.1' "$OUT/refused.txt" || fail "refused: $(cat "$OUT/refused.txt")"
ask cancel || fail "cancel"
wait $asking && fail "a cancelled calibration counts as done"
grep -q 'camera.1 is not calibrated: cancelled' "$ERR" || fail "calibrate says: $(cat "$ERR")"
wait_for armed

# over HTTP
http GET / '' | grep -q '<title>hdrig</title>' || fail "no page"
http GET /status.json '' | grep -q "\"id\": \"${take##*/}\"" ||
    fail "the page does not know the take"
http GET "/captures/${take##*/}/images/train_00_00.png" '' | head -c 400 | grep -aq 'image/png' ||
    fail "no picture over HTTP"
http POST /capture '' | grep -q 403 || fail "another site may press the button"
http POST /capture 'X-Hdrig: 1' | grep -q '"ok": true' || fail "no capture over HTTP"
wait_for armed
stop
[ "$(find "$OUT/store" -maxdepth 1 -name '*-00000[12]' | wc -l)" -eq 2 ] ||
    fail "two takes are not there"
"$HDRIG" reconstruct --images "$take" --size 70 --refine 0 --out "$OUT/scene" 2>"$ERR" ||
    grep -q 'cameras cannot be found' "$ERR" || fail "a take cannot be read: $(tail -n 1 "$ERR")"

# a hundred presses a second: every one is counted
settings "trigger.1 = timer:0.01" "trigger.lockout_ms = 20"
start
for _ in $(seq 300); do
    [ "$(count takes)" -ge 1 ] && [ "$(count presses)" -ge 100 ] && break
    sleep 0.1
done
at_least "presses" "$(count presses)" 100
at_least "takes" "$(count takes)" 1
ask status --json >"$OUT/status.json"
sum=0
for name in takes aborted locked_out rejected refused; do
    sum=$((sum + $(sed "s/.*\"$name\": \\([0-9]*\\).*/\\1/" "$OUT/status.json")))
done
total=$(sed 's/.*"presses": \([0-9]*\).*/\1/' "$OUT/status.json")
[ $((total - sum)) -ge 0 ] && [ $((total - sum)) -le 2 ] || # one may run, one be written
    fail "of $total presses $sum are accounted for"
stop

# SIGTERM in a bracket of 18 s, whose end is not waited for; the take is kept as aborted
settings "bracket.mode = list" "bracket.ev = 0 0 0 0 0 0 0 0 0" "bracket.middle_us = 2000000"
start
wait_for armed
ask capture >/dev/null 2>"$ERR" &
asking=$!
wait_for shooting
sleep 0.5
stop
wait $asking && fail "a capture that was cut off counts as done"
[ "$(find "$OUT/store" -maxdepth 1 -name 'aborted-*' | wc -l)" -ge 1 ] || fail "no aborted take"
grep -q '"reason": "shutdown"' "$OUT"/store/aborted-*/manifest.json || fail "its reason is missing"

# cancelled
start
wait_for armed
ask capture >/dev/null 2>"$ERR" &
asking=$!
wait_for shooting
ask cancel || fail "cancel"
wait $asking && fail "a cancelled capture counts as done"
grep -q cancelled "$ERR" || fail "capture says: $(cat "$ERR")"

# killed: nothing half is seen, the next daemon clears up and its numbers go on
kill -9 $pid
wait $pid 2>/dev/null
mkdir "$OUT/store/.tmp-00000000-000099"
settings
start
wait_for armed
[ ! -e "$OUT/store/.tmp-00000000-000099" ] || fail "what a crash left is still there"
last=$(ls "$OUT/store" | sed -n 's/.*-//p' | sort | tail -n 1)
take=$(ask capture 2>"$ERR") || fail "capture after a crash: $(cat "$ERR")"
[ "${take##*-}" \> "$last" ] || fail "number ${take##*-} after $last"
stop

# no room
settings "store.reserve_mb = 1048576"
start
wait_for armed
ask capture 2>"$ERR" && fail "a capture without room"
grep -Eq 'MB|bytes' "$ERR" || fail "no figures: $(cat "$ERR")"
stop

# a camera that comes later
settings "camera.2 = $(camera 1 ",node=$OUT/node")"
start
ask capture 2>"$ERR" && fail "a capture without cameras"
grep -q 'counts as unplugged' "$ERR" || fail "capture says: $(cat "$ERR")"
touch "$OUT/node"
wait_for armed
rm "$OUT/node"
wait_for lost
touch "$OUT/node"
wait_for armed
ask capture >/dev/null 2>"$ERR" || fail "after replugging: $(cat "$ERR")"
stop

# reconstructed in the background
settings "job.run = 1" "session.collect = 0" "size = 56" "refine.steps = 0"
start
wait_for armed
take=$(ask capture 2>"$ERR")
for _ in $(seq 300); do
    ask status --json | grep -Eq '"last": "(done|failed)"' && break
    sleep 0.1
done
ask status --json | grep -Eq '"last": "(done|failed)", "last_id": "'"${take##*/}" ||
    fail "no reconstruction was tried"
stop
rm -rf "${SOCKET%/*}"
finish
