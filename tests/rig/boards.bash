# A rig of boards as processes, with a real broker, for scripts that run from the root with HDRIG,
# BIN and OUT: each board has a folder $OUT/NAME with its settings, store and log. With SPACES=yes
# each has a network namespace of its own behind a bridge, and a monotonic clock of its own.
DAEMON=${HDRIG%/*}/hdrigd
BROKER=/usr/sbin/mosquitto
SPACES=${SPACES-}
CLOCKS=$SPACES # whether each has a monotonic clock of its own; not every kernel can
[ -e /proc/self/ns/time ] || CLOCKS=
SIZE=${SIZE:-56}
FPS=${FPS:-30}
MORE=${MORE-}       # options of the cameras
LINK=${LINK-}       # netem of each board's link; where the kernel has none, tbf with RATE alone
RATE=${RATE:-1gbit}
link=
BASE=$((10000 + $$ % 160 * 140)) # below those that the kernel gives away
tag=hd$$
: >"$OUT/offsets.txt" # of the boards' clocks
declare -A pid port address

[ -x $BROKER ] || { echo "not checked: $BROKER is not installed"; exit 1; }

inside() { # name: sets `in`, the words before a command
    in=()
    [ -z "$SPACES" ] || in=(ip netns exec "$tag-$1")
}

space() { # name command...
    local in
    inside "$1"
    shift
    "${in[@]}" "$@"
}

# The broker and the conductor live in the namespace of the bridge.
make_hub() {
    hub=127.0.0.1
    [ -n "$SPACES" ] || return 0
    hub=10.77.0.1
    ip netns add "$tag-hub" && space hub ip link set lo up &&
        space hub ip link add br0 type bridge && space hub ip addr add $hub/16 dev br0 &&
        space hub ip link set br0 up
}

make_space() { # name number
    address[$1]=127.0.0.1
    [ -n "$SPACES" ] || return 0
    address[$1]=10.77.1.$2
    ip netns add "$tag-$1" && ip link add "$tag$2" netns "$tag-hub" type veth peer name eth0 \
        netns "$tag-$1" && space hub ip link set "$tag$2" master br0 up &&
        space "$1" ip addr add "${address[$1]}/16" dev eth0 && space "$1" ip link set eth0 up &&
        space "$1" ip link set lo up || return
    limit "$1" eth0
    limit hub "$tag$2"
}

limit() { # space device
    [ -n "$LINK" ] || return 0
    local bucket="rate $RATE burst 128k latency 50ms"
    if space "$1" tc qdisc add dev "$2" root netem $LINK rate $RATE 2>/dev/null; then
        link="$LINK, $RATE"
    elif space "$1" tc qdisc add dev "$2" root tbf $bucket 2>/dev/null; then
        link="$RATE; no delays and losses, which this kernel cannot make"
    else
        link="as they are: this kernel limits none"
    fi
}

broker() {
    cat >"$OUT/broker.conf" <<X
listener $BASE $hub
allow_anonymous true
X
    local in
    inside hub
    "${in[@]}" $BROKER -c "$OUT/broker.conf" >>"$OUT/broker.txt" 2>&1 &
    pid[broker]=$!
    disown
}

# settings of a board, then lines of its own
settings() { # name role number lines...
    local name=$1 role=$2 number=$3
    shift 3
    mkdir -p "$OUT/$name"
    port[$name]=$((BASE + 1 + number))
    [ -n "$SPACES" ] && port[$name]=8080
    printf '%s\n' "rig.role = $role" "rig.broker = mqtt://$hub:$BASE" "rig.board = $name" \
        "rig.password_file =" "store.path = $OUT/$name/store" "results.path = $OUT/$name/results" \
        "calibration.path = $OUT/$name/calibration" "control.socket = $sockets/$name" \
        "http.port = ${port[$name]}" "http.address = ${address[$name]}" "http.token = t" \
        "job.run = 0" "store.reserve_mb = 0" "$@" >"$OUT/$name/hdrig.conf"
}

camera() { # view of views
    echo "sim:kind=room,seed=5,size=$SIZE,samples=1,fps=$FPS,views=$2,view=$1$MORE"
}

board() { # name: starts it
    local shift own=() in
    inside "$1"
    if [ -n "$CLOCKS" ]; then
        shift=$(grep "^$1 " "$OUT/offsets.txt" | cut -d' ' -f2)
        [ -n "$shift" ] || { shift=$((RANDOM * 30 + 1)); echo "$1 $shift" >>"$OUT/offsets.txt"; }
        own=(unshare -T --monotonic $shift --boottime $shift)
    fi
    "${in[@]}" "${own[@]}" "$DAEMON" --config "$OUT/$1/hdrig.conf" 2>>"$OUT/$1/log.txt" &
    pid[$1]=$!
    disown
}

ask() { # board command...
    local board=$1
    shift
    "$HDRIG" "$@" --config "$OUT/$board/hdrig.conf"
}

sentence() { # of the rig; "ready to capture"
    ask hub status --json 2>/dev/null | sed 's/.*"rig": //; s/.*"sentence": "\([^"]*\)".*/\1/; q' |
        head -n 1
}

rig_ready() { # whether a press would be answered
    ask hub status --json 2>/dev/null | grep -q '"state": "leads", "ready": true'
}

wait_ready() { # seconds
    for _ in $(seq $(($1 * 10))); do
        rig_ready && return
        sleep 0.1
    done
    return 1
}

# how many parts the boards hold, how many takes wait
held() {
    find "$OUT"/*/store -maxdepth 2 -path '*/[0-9a-f]*/manifest.json' ! -path '*/aborted-*' \
        -exec grep -l '"rig": {"take": "[^"]*", "member"' {} + 2>/dev/null | wc -l
}

waiting() {
    find "$OUT/hub/store" -maxdepth 1 -name '.rig-*' 2>/dev/null | wc -l
}

joints() {
    find "$OUT/hub/store" -maxdepth 2 -name manifest.json \
        -exec grep -l '"rig": {"take": "[^"]*", "members"' {} + | sort
}

# A joint take: whole, of the right boards in their order, its frames of one time.
check_joint() { # manifest boards skew-ms
    local dir=${1%/*} members cameras frames
    members=$(sed -n '/"rig": {"take"/,/"missing"/p' "$1" | grep -o '{"name": "[^"]*"' |
        sed 's/.*: "//; s/"//' | tr '\n' ' ')
    [ "$members" = "$2 " ] || fail "$dir has boards $members, not $2"
    cameras=$(grep -o '"member": "[^"]*"' "$1" | sed 's/.*: "//; s/"//' | tr '\n' ' ')
    [ "$cameras" = "$2 " ] || fail "$dir has cameras of $cameras"
    # the camera of board bK shows view K
    grep -o '"uri": "[^"]*"' "$1" | sed 's/.*view=\([0-9]*\).*/\1/' | tr '\n' ' ' >"$OUT/views.txt"
    [ "b$(sed 's/ $//; s/ / b/g' "$OUT/views.txt")" = "$2" ] ||
        fail "$dir shows views $(cat "$OUT/views.txt")"
    grep -q "\"take\": \"${dir##*/}\"" "$1" || fail "$dir is of another take"
    "$BIN/verify_take" "$dir" || fail "$dir is not whole"
    awk -v most="$3" '/"skew_s"/ { sub(/.*"skew_s": /, ""); if ($0 + 0 > most / 1000) exit 1 }' \
        "$1" || fail "$dir: skew $(grep -o '"skew_s": [0-9.e-]*' "$1")"
}

take_down() {
    for name in "${!pid[@]}"; do
        kill -KILL "${pid[$name]}" 2>/dev/null
    done
    pkill -KILL -f "$OUT/[^ ]*/hdrig.conf" 2>/dev/null
    sleep 0.2
    [ -z "$SPACES" ] || for s in $(ip netns list | sed -n "s/^\($tag-[^ ]*\).*/\1/p"); do
        ip netns del "$s"
    done
    rm -rf "$sockets"
}

sockets=$(mktemp -d)
trap take_down EXIT
