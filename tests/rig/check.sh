#!/usr/bin/env bash
# check.sh - a rig of MEMBERS boards as processes with simulated cameras, each in a network
# namespace and with a monotonic clock of its own where the kernel can, a real broker, links as
# LINK and RATE say, for TAKES presses without and FAULTS with faults: boards, conductor and broker
# killed, links cut, a disk full. It prints how long presses took, how far apart exposures began,
# whether the reported times are the true ones, how fast parts came, and what the faults did.
# Run by make check-rig, and by make check-kernel TEST=rig in virtual time, in which processors cost
# nothing; from the root with HDRIG, BIN and OUT.
. tests/e2e/common.bash
MEMBERS=${MEMBERS:-16} TAKES=${TAKES:-25} FAULTS=${FAULTS:-$TAKES} SKEW=${SKEW:-200}
LINK=${LINK:-delay 0.3ms 0.1ms loss 0.05%}
SPACES=yes
ip netns add hdrig-check 2>/dev/null && ip netns del hdrig-check || SPACES=
[ -n "$SPACES" ] || echo "not checked: no network namespaces may be made here, boards share one"
. tests/rig/boards.bash
LOG=$OUT/presses.txt
boards=$(seq -s ' ' 0 $((MEMBERS - 1)) | sed 's/^/b/; s/ / b/g')
RANDOM=${SEED:-1}

start_rig() { # lines of the conductor...
    local i listed=()
    for i in $(seq 0 $((MEMBERS - 1))); do
        listed+=("rig.member.$((i + 1)) = b$i")
    done
    settings hub conductor 0 "${listed[@]}" "$@"
    board hub
    for i in $(seq 0 $((MEMBERS - 1))); do
        settings b$i member $((i + 1)) "camera.1 = $(camera $i "$MEMBERS")" "store.merge = 0"
        board b$i
    done
    wait_ready 120 || fail "the rig is not ready: $(sentence)"
}

press() { # into the log: seconds, code, what it said
    local begin=$EPOCHREALTIME text code
    text=$(timeout 90 "$HDRIG" capture --config "$OUT/hub/hdrig.conf" 2>&1)
    code=$?
    awk -v b="$begin" -v e="$EPOCHREALTIME" -v c=$code -v t="${text//$'\n'/ }" \
        'BEGIN { printf "%.3f %d %s\n", e - b, c, t }' >>"$LOG"
    [ -n "$text" ] || fail "a press ended without a word"
}

settle() { # until no part is held and no take waits
    for _ in $(seq 600); do
        [ "$(held) $(waiting)" = "0 0" ] && return
        sleep 0.1
    done
    fail "$(held) parts are held, $(waiting) takes wait: $(sentence)"
}

# Frames whose time on the common clock is wrong by more than is said. The true time of a frame is
# that of its board's monotonic clock, less the offset that the clock was given.
wrong_times() { # manifest
    awk -v offsets="$(cat "$OUT/offsets.txt" | tr '\n' ' ')" '
        BEGIN {
            n = split(offsets, o, " ")
            for (i = 1; i <= n; i += 2) shift[o[i]] = o[i + 1]
            count = 0
        }
        /^ *{"camera": / {
            match($0, /"camera": [0-9]+/); camera = substr($0, RSTART + 10, RLENGTH - 10)
            match($0, /"common_ns": "[0-9]+/); common = substr($0, RSTART + 14, RLENGTH - 14)
            match($0, /"within_ns": "[0-9]+/); within = substr($0, RSTART + 14, RLENGTH - 14)
            start = $0; sub(/.*"start": {"monotonic_ns": "/, "", start)
            # the last 15 digits: doubles hold them
            c = substr(common, length(common) - 13) + 0
            t = (start + 0) - shift["b" camera] * 1e9
            d[count] = c - t % 1e14; w[count++] = within + 0
        }
        END {
            low = -1e18; high = 1e18
            for (i = 0; i < count; i++) {
                x = d[i] % 1e14
                if (x > 5e13) x -= 1e14
                if (x < -5e13) x += 1e14
                if (x - w[i] > low) low = x - w[i]
                if (x + w[i] < high) high = x + w[i]
            }
            print count, (low <= high ? 0 : 1)
        }' "$1"
}

spread() { # title, numbers on stdin: least, median, most
    sort -n | awk -v t="$1" '{ v[NR] = $1 }
        END { printf "%-44s %8.3g %8.3g %8.3g  (%d)\n", t, v[1], v[int((NR + 1) / 2)], v[NR], NR }'
}

sizes() { # board: memory and descriptors
    echo "$(awk '/VmRSS/ { printf "%.1f MB", $2 / 1000 }' "/proc/${pid[$1]}/status")," \
        "$(ls "/proc/${pid[$1]}/fd" | wc -l) descriptors"
}

used() { # boards...: processor time so far, s
    local name
    for name in "$@"; do
        awk '{ sub(/.*\) /, ""); print ($12 + $13) / 100 }' "/proc/${pid[$name]}/stat"
    done | awk '{ t += $1 } END { printf "%.2f", t }'
}

# ---- a rig at rest ----

: >"$LOG"
make_hub
address[hub]=$hub
broker
for i in $(seq 0 $((MEMBERS - 1))); do make_space b$i $((i + 1)) || fail "no namespace"; done
[ -z "$SPACES" ] || echo "links: $link"
start_rig "bracket.mode = list" "bracket.ev = -2 0 2" "bracket.middle_us = 2000" \
    "bracket.skew_ms = $SKEW"
printf '%-44s %8s %8s %8s\n' "$MEMBERS boards" least median most
begin=$EPOCHREALTIME of_hub=$(used hub) of_broker=$(used broker) of_boards=$(used $boards)
for take in $(seq "$TAKES"); do
    press
    wait_ready 20 || fail "not ready again: $(sentence)"
    [ "$take" != 5 ] || early=$(sizes hub)/$(sizes b0)
done
settle
grep -c "$OUT/hub/store" "$LOG" | grep -qx "$TAKES" ||
    fail "at rest: $(grep -v "$OUT/hub/store" "$LOG" | head -n 3)"
cut -d' ' -f1 "$LOG" | spread "press to joint take, s"
joints | xargs grep -ho '"skew_s": [0-9.e-]*' | awk '{ print $2 * 1000 }' |
    spread "largest difference between starts, ms"
joints | xargs grep -ho '"within_ns": "[0-9]*' | awk -F'"' '{ print $4 / 1e6 }' |
    spread "bound of a frame's time, ms"
if [ -n "$SPACES" ]; then
    for m in $(joints); do wrong_times "$m"; done | awk '{ n += $1; wrong += $2 }
        END { printf "takes whose times contradict the true ones: %d (%d frames)\n", wrong, n
              exit wrong > 0 }' || fail "reported times are not the true ones"
fi
grep 'MB from' "$OUT/hub/log.txt" | awk '{ print $(NF - 1) }' | spread "seconds to fetch a part"
grep 'MB from' "$OUT/hub/log.txt" | awk '{ print 8 * $(NF - 6) / $(NF - 1) }' |
    spread "Mbit/s of a fetch, with its proof"
grep -h ': joined in' "$OUT/hub/log.txt" | awk '{ print $(NF - 1) }' | spread "seconds to join"
awk -v t="$EPOCHREALTIME $begin" -v h="$(used hub) $of_hub" -v b="$(used broker) $of_broker" \
    -v m="$(used $boards) $of_boards" -v cores="$(nproc)" -v n="$MEMBERS" '
    function since(s, v) { split(s, v, " "); return v[1] - v[2] }
    BEGIN { printf "of %d cores, %.1f s: conductor %.1f %%, broker %.1f %%, each member %.2f %%\n",
        cores, since(t), 100 * since(h) / since(t) / cores, 100 * since(b) / since(t) / cores,
        100 * since(m) / since(t) / cores / n }'
early=${early:-$(sizes hub)/$(sizes b0)}
echo "conductor after 5 takes: ${early%/*}; after $TAKES: $(sizes hub)"
echo "a member after 5 takes: ${early#*/}; after $TAKES: $(sizes b0)"
before=$(ls "/proc/${pid[hub]}/fd" | wc -l)

# ---- faults ----

revive() { # board after a while
    sleep 0.$((RANDOM % 10))
    kill -KILL "${pid[$1]}" 2>/dev/null
    sleep $((RANDOM % 2)).$((RANDOM % 10))
    board "$1"
}

# A board that was killed while it photographed has no part of that take: the user decides.
give_up() {
    local id
    id=$(tail -n 1 "$LOG" | sed -n 's/.*hdrig rig forget \([0-9a-f-]*\).*/\1/p')
    [ -z "$id" ] || ask hub rig forget "$id" >/dev/null || fail "take $id is not given up"
}

kills=0 cuts=0 brokers=0 leaders=0 full=0
for take in $(seq "$FAULTS"); do
    board=b$((RANDOM % MEMBERS))
    link=$tag$((${board#b} + 1))
    press &
    asking=$!
    sleep 0.$((RANDOM % 10))$((RANDOM % 10))
    case $((RANDOM % 8)) in
    0 | 1 | 2)
        revive $board
        kills=$((kills + 1))
        ;;
    3 | 4)
        [ -z "$SPACES" ] || {
            space hub ip link set $link down
            sleep $((RANDOM % 12))
            space hub ip link set $link up
            cuts=$((cuts + 1))
        }
        ;;
    5)
        kill -KILL "${pid[broker]}"
        sleep 0.5
        broker
        brokers=$((brokers + 1))
        ;;
    6)
        revive hub
        leaders=$((leaders + 1))
        ;;
    7) # as good as full: no file can grow
        prlimit --pid "${pid[$board]}" --fsize=2000:2000 2>/dev/null && full=$((full + 1))
        sleep 1
        revive $board
        ;;
    esac
    wait $asking
    give_up
    wait_ready 60 || fail "after take $take the rig is not ready: $(sentence)"
done
settle
if [ "$FAULTS" -gt 0 ]; then
    tail -n "$FAULTS" "$LOG" >"$OUT/faults.txt"
    told=$(grep -c "$OUT/hub/store" "$OUT/faults.txt")
    echo "$FAULTS presses with faults: $kills boards killed, $cuts links cut, $brokers brokers" \
        "and $leaders conductors killed, $full disks full; $told told of a joint take," \
        "$((FAULTS - told)) of a reason"
    grep -v "$OUT/hub/store" "$OUT/faults.txt" | cut -d' ' -f3- | sed 's/\bb[0-9][0-9]*/bN/g' |
        sed 's/[0-9.][0-9.]* \(m*s\)/N \1/' | sort | uniq -c | sort -rn | head -n 12
fi
n=0
for m in $(joints); do
    check_joint "$m" "$boards" "$SKEW"
    n=$((n + 1))
done
echo "$n joint takes: each whole, of its boards in their order, of one moment"
after=$(ls "/proc/${pid[hub]}/fd" | wc -l)
[ "$leaders" -gt 0 ] || [ $((after - before)) -le 2 ] || fail "descriptors: $before, then $after"
finish
