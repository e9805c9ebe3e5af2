#!/usr/bin/env bash
# A rig of one camera is carried from place to place: the captures of a session become one scene,
# also when the daemon stops or crashes between them.
. tests/e2e/common.bash
DAEMON=${HDRIG%/*}/hdrigd
LOG=$OUT/hdrigd.txt
SOCKET=$(mktemp -d)/control # a socket's path is short
PORT=$((20000 + $$ % 20000))
SEEN=format=rggb,at=$OUT/at # numbers of a sensor, of the place in that file
pid=

settings() { # lines...
    printf '%s\n' "store.path = $OUT/store" "results.path = $OUT/results" "size = 112" \
        "refine.steps = 0" "calibration.path = $OUT/calibration" "control.socket = $SOCKET" \
        "http.port = $PORT" "store.reserve_mb = 1" "bracket.mode = list" "bracket.ev = -2 0" \
        "bracket.middle_us = 8000" "cameras.fov_deg = 60" \
        "camera.1 = sim:kind=room,seed=5,size=112,samples=2,fps=100,views=9,spread=0.3,$SEEN" \
        "$@" >"$OUT/hdrig.conf"
}

ask() { # command...
    "$HDRIG" "$@" --config "$OUT/hdrig.conf"
}

wait_for() { # command whose output is asked for, regex
    for _ in $(seq 300); do
        eval "$1" 2>/dev/null | grep -Eq -e "$2" && return
        sleep 0.1
    done
    fail "$1 never says $2, but $(eval "$1" 2>&1 | head -c 2000)"
}

start() {
    "$DAEMON" --config "$OUT/hdrig.conf" 2>>"$LOG" &
    pid=$!
    wait_for "ask status" '^armed'
}

stop() {
    kill -TERM $pid
    wait $pid || fail "the daemon ends with $?: $(tail -n 1 "$LOG")"
}

place() { # view, what the session is then
    echo "$1" >"$OUT/at"
    sleep 0.1 # the camera is there
    take=$(ask capture 2>"$ERR") || fail "capture: $(cat "$ERR")"
    grep -q "^$2\$" "$ERR" || fail "after a capture: $(cat "$ERR"), not $2"
    [ -f "$take/manifest.json" ] || fail "no take at \"$take\""
}

post() { # path
    exec 3<>"/dev/tcp/127.0.0.1/$PORT" || return
    printf 'POST %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n' "$1" >&3
    printf 'Content-Length: 0\r\nX-Hdrig: 1\r\n\r\n' >&3
    cat <&3
    exec 3>&-
}

# three places; the daemon ends, and is killed, between them
settings
start
ask session | grep -q '^no place yet$' || fail "session: $(ask session)"
ask session end 2>"$ERR" && fail "a session ends that nobody began"
grep -q 'no session is open' "$ERR" || fail "session end: $(cat "$ERR")"
place 2 '1 place so far'
first=${take##*/}
ask session scene 2>"$ERR" && fail "a scene of one place"
grep -q '1 place so far, a scene needs at least 2' "$ERR" || fail "session scene: $(cat "$ERR")"
stop
start
place 4 '2 places so far'
kill -9 $pid
wait $pid 2>/dev/null
start
place 6 '3 places so far'
ask status >"$OUT/status.txt"
grep -q '^session  3 places so far$' "$OUT/status.txt" || fail "status: $(cat "$OUT/status.txt")"
[ "$(grep -c ", a place of session $first" "$OUT/status.txt")" -eq 3 ] ||
    fail "not three places of $first: $(cat "$OUT/status.txt")"
[ ! -e "$OUT/results/$first" ] || fail "a scene before the session's end"
ask session end | grep -q '^ended with 3 places: being reconstructed$' || fail "session end"
kill -9 $pid # what waits survives, and the session stays ended
wait $pid 2>/dev/null
start
ask session | grep -q '^no place yet$' || fail "after the end and a crash: $(ask session)"
wait_for "ask status --json" "\"last\": \"(done|failed)\", \"last_id\": \"$first\""
grep -q '"views": 3' "$OUT/results/$first/report.json" ||
    fail "no scene of 3 views: $(tail -n 5 "$LOG")"
grep -q '"response_known": true' "$OUT/results/$first/report.json" ||
    fail "the scene is not made from the raw frames"
ls "$OUT/results/$first/ldr" | grep -q "^${take##*/}_train_00_00" ||
    fail "the names of pictures do not tell their take: $(ls "$OUT/results/$first/ldr")"

# the next session, over HTTP; its scene is replaced when it has grown
place 2 '1 place so far'
second=${take##*/}
[ "$second" != "$first" ] || fail "the session goes on"
place 6 '2 places so far'
post /session/scene | grep -q '"ok": true' || fail "no scene over HTTP"
wait_for "ask status --json" "\"last\": \"(done|failed)\", \"last_id\": \"$second\""
grep -q '"views": 2' "$OUT/results/$second/report.json" || fail "no scene of 2 views"
place 4 '3 places so far'
post /session/end | grep -q '"ok": true' || fail "no end over HTTP"
wait_for "cat $OUT/results/$second/report.json" '"views": 3'
[ -z "$(find "$OUT/results" -name '*.pending')" ] || wait_for "ls $OUT/results" "$second"

# a place alone
place 8 '1 place so far'
ask session end | grep -q '^ended with 1 place: no scene, which needs at least 2$' ||
    fail "the end of one place"
ask status | grep -q '^session  ended with 1 place' || fail "status: $(ask status)"
stop
[ "$(grep -c 'session .* ended with' "$LOG")" -eq 3 ] || fail "the log does not tell three ends"

# other programs get the raw frames as well: a picture beside them does not count
export_first() {
    "$HDRIG" export "$OUT/results/$first" --images "$OUT/store/$first" \
        --images "$OUT"/store/*-000002 --images "$OUT"/store/*-000003 --colmap "$OUT/$1" \
        >/dev/null 2>"$ERR" || fail "export: $(tail -n 1 "$ERR")"
}
export_first exported
cp "$OUT/store/$first/images/train_00_01.png" "$OUT/store/$first/images/train_00_00.png"
export_first exported2
diff -r "$OUT/exported/images" "$OUT/exported2/images" || fail "a picture was used, not its frame"

# a frame that is lost: the scene is made from the pictures, and says so
rm "$OUT/store/${first}/raw/00_00.bin"
"$HDRIG" reconstruct --images "$OUT/store/$first" --images "$OUT"/store/*-000002 \
    --images "$OUT"/store/*-000003 \
    --config "$OUT/hdrig.conf" --out "$OUT/pictures" 2>"$ERR" || fail "$(tail -n 1 "$ERR")"
grep -q 'pictures of 8 bits are used.*raw/00_00.bin' "$OUT/pictures/report.json" ||
    fail "no word of the lost frame: $(cat "$ERR")"
grep -q response_known "$OUT/pictures/report.json" && fail "a response is known that is not"

# each capture a scene of its own, as asked; several folders by hand
settings "session.collect = 0" "job.run = 0"
start
take=$(ask capture 2>"$ERR") || fail "capture: $(cat "$ERR")"
grep -q 'so far' "$ERR" && fail "places are collected: $(cat "$ERR")"
grep -q '"session"' "$take/manifest.json" && fail "a take of a session"
ask status | grep -q '^session' && fail "status tells of a session"
stop
rm -rf "${SOCKET%/*}"
finish
