#!/usr/bin/env bash
# A rig of three boards and their conductor on one machine: a press, refusals, boards that die
# before and while they photograph, a broker that is started again, a conductor that is killed, two
# conductors, settings that cannot be.
. tests/e2e/common.bash
. tests/rig/boards.bash
boards="b0 b1 b2"
FPS=60

press() { # code regex
    ask hub capture >"$OUT/stdout.txt" 2>"$ERR"
    local got=$?
    [ $got -eq "$1" ] || fail "a press ends with $got, expected $1: $(tail -n 1 "$ERR")"
    cat "$OUT/stdout.txt" "$ERR" | grep -Eq -e "$2" ||
        fail "a press says \"$(cat "$OUT/stdout.txt" "$ERR")\", expected $2"
}

quiet() { # all parts gone, nothing waits
    for _ in $(seq 150); do
        [ "$(held) $(waiting)" = "0 0" ] && return
        sleep 0.1
    done
    fail "$(held) parts are held, $(waiting) takes wait: $(ask hub status --json)"
}

make_hub
broker
address[hub]=127.0.0.1
settings hub conductor 0 "rig.member.1 = b0" "rig.member.2 = b1" "rig.member.3 = b2" \
    "bracket.mode = list" "bracket.ev = -2 0 2" "bracket.middle_us = 2000" "bracket.skew_ms = 500"
board hub
for i in 0 1 2; do
    make_space b$i $((i + 1))
    kind= # one board has another kind of camera
    [ $i != 2 ] || kind=,format=rggb
    settings b$i member $((i + 1)) "camera.1 = $(camera $i 4)$kind"
    board b$i
done
wait_ready 30 || fail "the rig is not ready: $(sentence)"
[ "$(ask hub rig hosts | sort | uniq -c | awk '{ print $1, $2 }' | tr '\n' ' ')" = \
    "3 127.0.0.1 1 localhost " ] || fail "hosts for mpirun: $(ask hub rig hosts)"

# a press, and one at a member
press 0 "^$OUT/hub/store/[0-9a-f]{8}-[0-9]{6}$"
quiet
ask b1 capture >/dev/null 2>"$ERR" && fail "a member waits for the outcome"
grep -q 'the conductor alone tells' "$ERR" || fail "a member says $(cat "$ERR")"
curl -s -X POST -H 'X-Hdrig: 1' -H 'Authorization: Bearer t' \
    "http://127.0.0.1:${port[b1]}/capture" | grep -q '"ok": true' || fail "no press at a member"
for _ in $(seq 100); do [ "$(joints | wc -l)" = 2 ] && break; sleep 0.1; done
[ "$(joints | wc -l)" = 2 ] || fail "a press at a member makes no take"
quiet

# parts are open to the conductor alone
curl -s "http://127.0.0.1:${port[b1]}/parts/x/manifest.json" -H 'Authorization: Bearer t' |
    grep -q '"ok": false' || fail "parts are open to the page's token"

# a board that is away
kill -KILL "${pid[b2]}"
for _ in $(seq 100); do rig_ready || break; sleep 0.1; done
press 1 'b2 is not there since'
board b2
wait_ready 20 || fail "the rig is not ready again: $(sentence)"

# killed while it photographs: the press fails by name, and what is left of it waits for its owner
ask hub capture >"$OUT/killed.txt" 2>&1 &
asking=$!
sleep 0.35
kill -KILL "${pid[b1]}"
board b1
wait $asking
why='b1: (was started again|did not take|the order came)|b1 is not|skew_ms'
grep -Eq "$why" "$OUT/killed.txt" ||
    grep -q "$OUT/hub/store" "$OUT/killed.txt" || fail "a kill says $(cat "$OUT/killed.txt")"
wait_ready 20 || fail "the rig is not ready after a kill: $(sentence)"
for id in $(grep -o 'rig forget [0-9a-f-]*' "$OUT/killed.txt" | cut -d' ' -f3); do
    ask hub rig forget "$id" 2>"$ERR" || fail "forget $id: $(cat "$ERR")"
done
quiet
press 0 "$OUT/hub/store"
quiet # of its parts

# a part is deleted on its board: the others' parts wait for their owner, who joins them
prlimit --pid "${pid[hub]}" --fsize=2000:2000 # as good as full: no part can be fetched
ask hub capture >"$OUT/lost.txt" 2>&1 &
asking=$!
for _ in $(seq 200); do [ "$(held)" = 3 ] && break; sleep 0.1; done
part=$(find "$OUT/b1/store" -maxdepth 2 -path '*/[0-9a-f]*/manifest.json')
[ -n "$part" ] || fail "b1 has no part: $(cat "$OUT/lost.txt")"
kill -0 "${pid[hub]}" || fail "a disk that is full ends the conductor"
kill -KILL "${pid[b1]}" "${pid[hub]}"
wait $asking
rm -rf "${part%/*}"
board hub
board b1
for _ in $(seq 300); do
    choice=$(ask hub rig status 2>/dev/null |
        grep 'b1: lost its part; 2 of 3 parts are there: hdrig rig accept')
    [ -z "$choice" ] || break
    sleep 0.1
done
[ -n "$choice" ] || { fail "nobody tells of a lost part: $(ask hub rig status)"; finish; }
id=$(sed 's/.*accept \([0-9a-f-]*\).*/\1/' <<<"$choice")
[ "$(held)" = 2 ] || fail "$(held) parts are held, not 2"
says_of() { # regex command...
    ask hub "${@:2}" >"$OUT/stdout.txt" 2>&1
    grep -Eq "$1" "$OUT/stdout.txt" || fail "${*:2} says $(cat "$OUT/stdout.txt"), expected $1"
}
says_of 'is no capture that waits' rig accept 00000000-000001
ask hub rig accept "$id" 2>"$ERR" || fail "accept $id: $(cat "$ERR")"
quiet
grep -q '"missing": \["b1"\]' "$OUT/hub/store/$id/manifest.json" ||
    fail "an accepted take does not say what it lacks"
check_joint "$OUT/hub/store/$id/manifest.json" "b0 b2" 500
mkdir "$OUT/accepted"
mv "$OUT/hub/store/$id" "$OUT/accepted/"
wait_ready 20 || fail "the rig is not ready after a lost part: $(sentence)"

# the broker dies and comes back
kill -KILL "${pid[broker]}"
sleep 1
press 1 'broker'
broker
wait_ready 30 || fail "the rig is not ready with a new broker: $(sentence)"
press 0 "$OUT/hub/store"
quiet

# the conductor dies in the middle: the take ends afterwards, whole or not at all
ask hub capture >/dev/null 2>&1 &
asking=$!
sleep 0.9
kill -KILL "${pid[hub]}"
wait $asking
board hub
wait_ready 30 || fail "the rig is not ready with a new conductor: $(sentence)"
quiet
press 0 "$OUT/hub/store"

# a second conductor refuses
address[second]=127.0.0.1
settings second conductor 9 "bracket.mode = list" "bracket.ev = 0" "bracket.middle_us = 2000"
board second
sleep 3
ask second capture >/dev/null 2>"$ERR" && fail "two conductors"
grep -q 'hub leads this rig' "$ERR" || fail "a second conductor says $(cat "$ERR")"
kill "${pid[second]}"
wait_ready 10 || fail "a second conductor disturbs: $(sentence)"

for m in $(joints); do
    check_joint "$m" "$boards" 500
done
at_least "number of joint takes" "$(joints | wc -l)" 5

# settings that cannot be
refused() { # regex lines...
    local regex=$1
    shift
    settings bad member 8 "$@"
    timeout 20 "$DAEMON" --config "$OUT/bad/hdrig.conf" >/dev/null 2>"$ERR"
    grep -Eq -e "$regex" "$ERR" || fail "\"$(tail -n 1 "$ERR")\" does not match $regex"
}
address[bad]=127.0.0.1
refused 'no camera.1 is set'
refused 'rig.broker: ' "camera.1 = $(camera 0 4)" "rig.broker = http://x"
refused 'rig.board: "A b"' "camera.1 = $(camera 0 4)" "rig.board = A b"
refused 'http.port is 0' "camera.1 = $(camera 0 4)" "http.port = 0"
refused 'rig.password_file: /nowhere' "camera.1 = $(camera 0 4)" "rig.password_file = /nowhere"
finish
