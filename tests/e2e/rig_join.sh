#!/usr/bin/env bash
# A rig of three boards from nothing: broker with TLS, lines to join by, a capture of all boards;
# who may say and hear what; lines and files that are wrong; no secret where others could read it.
. tests/e2e/common.bash
DAEMON=$(realpath "${HDRIG%/*}")/hdrigd
HDRIG=$(realpath "$HDRIG")
PUBLISH=$(realpath "$BIN/publish")
OUT=$(realpath "$OUT")
ERR=$OUT/stderr.txt
MOSQUITTO=$OUT/mosquitto SOCKETS=$(mktemp -d)
PORT=$((10000 + $$ % 5000 * 4)) # below those that the kernel gives away
PATH=$PATH:/usr/sbin
pids=()
umask 022

stop_all() {
    for pid in "${pids[@]}"; do
        kill "$pid" 2>/dev/null
    done
    wait
    rm -rf "$SOCKETS"
}
trap stop_all EXIT

mode() { # file wanted
    [ "$(stat -c %a "$1")" = "$2" ] || fail "$1 has mode $(stat -c %a "$1"), not $2"
}

on() { # board command...
    local board=$1
    shift
    "$HDRIG" rig "$@" --config "$OUT/$board/hdrig.conf"
}

says() { # code regex board command...: on stdout or stderr
    local code=$1 regex=$2 got
    shift 2
    on "$@" >"$OUT/stdout.txt" 2>"$ERR"
    got=$?
    [ $got -eq "$code" ] ||
        fail "rig $*: exit $got, expected $code: $(cat "$OUT/stdout.txt" "$ERR")"
    cat "$OUT/stdout.txt" "$ERR" | grep -Eq -e "$regex" ||
        fail "rig $*: \"$(cat "$OUT/stdout.txt" "$ERR")\" does not match $regex"
}

board() { # name view: its settings but for those of the rig, with a line that must stay
    mkdir "$OUT/$1"
    printf '%s\n' "# mine" "store.path = $OUT/$1/store" "results.path = $OUT/$1/results" \
        "calibration.path = $OUT/$1/calibration" "control.socket = $SOCKETS/$1" \
        "http.port = $((PORT + 1 + $2))" "job.run = 0" "store.reserve_mb = 0" "rig.role = alone" \
        "camera.1 = sim:kind=room,seed=5,size=56,samples=1,fps=100,views=4,view=$2" \
        >"$OUT/$1/hdrig.conf"
}

start() { # board
    "$DAEMON" --config "$OUT/$1/hdrig.conf" 2>"$OUT/$1/log" &
    pids+=($!)
}

wait_ready() { # board
    for _ in $(seq 200); do
        on "$1" status >"$OUT/stdout.txt" 2>&1 && return
        sleep 0.1
    done
    fail "never ready: $(cat "$OUT/stdout.txt")"
}

client() { # board action topic [text]
    "$PUBLISH" 127.0.0.1 "$PORT" "$OUT/$1/rig-ca.pem" "$1" "$OUT/$1/rig-password" "${@:2}"
}

# what runs and which arguments it has, until the end
watch_arguments() {
    while [ -d "$SOCKETS" ]; do
        cat /proc/[0-9]*/cmdline 2>/dev/null | tr '\0' ' '
    done >"$OUT/arguments.txt"
}
watch_arguments &
watcher=$!

# the broker: refusals leave nothing
mkdir "$MOSQUITTO"
expect 2 '--host is needed' rig broker --dir "$MOSQUITTO"
expect 1 'neither a name of a host nor an address' rig broker --host 'a;b' --dir "$MOSQUITTO"
expect 1 'small letters' rig broker --host a --conductor Lead --dir "$MOSQUITTO"
expect 1 'small letters' rig broker --host a --name 'r/+' --dir "$MOSQUITTO"
expect 1 'port' rig broker --host a --port 0 --conductor lead --dir "$MOSQUITTO"
expect 1 'is mosquitto installed' rig broker --host a --conductor lead --dir "$OUT/none"
expect 1 'must begin with /' rig broker --host a --conductor lead --dir build
expect 1 'hdrig rig broker makes it' rig add m1 --dir "$MOSQUITTO"
[ -z "$(ls -A "$MOSQUITTO")" ] || fail "refusals leave $(ls -A "$MOSQUITTO")"
for place in conf.d/hdrig.conf hdrig/acl hdrig/users hdrig/ca.key hdrig/server.pem; do
    mkdir -p "$MOSQUITTO/${place%/*}"
    echo "somebody's" >"$MOSQUITTO/$place"
    expect 1 "$place is not a file that hdrig wrote" \
        rig broker --host a --conductor lead --dir "$MOSQUITTO"
    [ "$(cat "$MOSQUITTO/$place")" = "somebody's" ] || fail "$place was replaced"
    [ "$(find "$MOSQUITTO" -type f | wc -l)" = 1 ] || fail "files beside a refusal"
    rm -r "$MOSQUITTO"/*
done

# and how it goes
broker() { # options...
    "$HDRIG" rig broker --port "$PORT" --conductor lead --dir "$MOSQUITTO" "$@" 2>"$ERR" ||
        fail "rig broker: $(cat "$ERR")"
}
broker --host wrong.example >"$OUT/lead.line"
cp "$MOSQUITTO/hdrig/ca.pem" "$OUT/first.pem"
[ -z "$(broker --host 127.0.0.1)" ] || fail "the conductor gets a second line unasked"
cmp -s "$OUT/first.pem" "$MOSQUITTO/hdrig/ca.pem" || fail "a second call replaces the authority"
openssl x509 -in "$MOSQUITTO/hdrig/server.pem" -noout -ext subjectAltName |
    grep -q 'IP Address:127.0.0.1$' || fail "the certificate has another address"
openssl verify -CAfile "$OUT/first.pem" -purpose sslserver "$MOSQUITTO/hdrig/server.pem" \
    >"$OUT/stdout.txt" 2>&1 || fail "$(cat "$OUT/stdout.txt")"
add() { # board options...
    "$HDRIG" rig add "$@" --dir "$MOSQUITTO" 2>"$ERR" || fail "rig add: $(cat "$ERR")"
}
for name in lead m1 m2 spare; do
    add $name >"$OUT/$name.line"
done
[ "$(grep -c '^[a-z0-9]*:\$7\$' "$MOSQUITTO/hdrig/users")" = 4 ] || fail "not four users"
mode "$MOSQUITTO/hdrig/ca.key" 600
for file in server.key users acl; do
    [ $(($(stat -c '0%a' "$MOSQUITTO/hdrig/$file") & 7)) = 0 ] || fail "all can read $file"
done
[ -z "$(find "$MOSQUITTO" -name '.*')" ] || fail "left: $(find "$MOSQUITTO" -name '.*')"
expect 2 'name of the board' rig add --dir "$MOSQUITTO"
expect 1 'small letters' rig add 'a:b' --dir "$MOSQUITTO"
expect 1 'small letters' rig add '+' --dir "$MOSQUITTO"
add spare --qr >"$OUT/spare.line"
grep -q "$(printf '\342\226\204')" "$ERR" || fail "no QR code"
[ "$(wc -l <"$OUT/spare.line")" = 1 ] || fail "the code is where the line should be"
env PATH="$OUT/none" "$HDRIG" rig add spare --dir "$MOSQUITTO" 2>"$ERR" >"$OUT/stdout.txt" &&
    fail "without any tools"
grep -q 'is not there: install it' "$ERR" || fail "without tools: $(cat "$ERR")"
[ ! -s "$OUT/stdout.txt" ] || fail "a line without a user"

# lines that are wrong change nothing
board lead 0
board m1 1
board m2 2
cp -r "$OUT/m1" "$OUT/before"
line=$(cat "$OUT/m1.line")
refused() { # regex line
    printf '%s\n' "$2" | "$HDRIG" rig join --dir "$OUT/m1" >"$OUT/stdout.txt" 2>"$ERR" &&
        fail "a wrong line is taken: $1"
    grep -Eq -e "$1" "$ERR" || fail "\"$(cat "$ERR")\" does not match $1"
    diff -r "$OUT/before" "$OUT/m1" >"$OUT/stdout.txt" || fail "$1: $(cat "$OUT/stdout.txt")"
}
sum() { # a line without its end
    printf '%s:%.8s' "$1" "$(printf %s "$1" | sha256sum)"
}
IFS=: read -r _ host port rig name password ca _ <<<"$line"
refused 'would begin with hdrig1' ''
refused 'would begin with hdrig1' "${line/hdrig1/hdrig2}"
refused 'end is missing' "${line%?????}"
refused 'end is missing' "${line/:m1:/:m2:}"
refused 'end is missing' "${line/A/B}"
refused 'is no host' "$(sum "hdrig1:a b:$port:$rig:$name:$password:$ca")"
refused 'lacks a part' "$(sum "hdrig1:$host:x:$rig:$name:$password:$ca")"
refused 'port 70000' "$(sum "hdrig1:$host:70000:$rig:$name:$password:$ca")"
refused 'no name of a rig' "$(sum "hdrig1:$host:$port:#:$name:$password:$ca")"
refused 'no name of a board' "$(sum "hdrig1:$host:$port:$rig:../m:$password:$ca")"
refused 'the password is too short' "$(sum "hdrig1:$host:$port:$rig:$name:abc:$ca")"
refused 'certificate is none' "$(sum "hdrig1:$host:$port:$rig:$name:$password:${ca:0:400}")"
refused 'lacks a part' "$(sum "hdrig1:$host:$port:$rig:$name:$password:$ca+")"
refused 'lacks a part' "$(sum "hdrig1:$host:$port:$rig:$name:$password:$ca:more")"
refused 'lacks a part' "$(sum "hdrig1:$host:$port:$rig")"
refused 'bytes, at most|end is missing' "hdrig1:$(head -c 5000 /dev/zero | tr '\0' A)"
"$HDRIG" rig join --dir "$OUT/m1" </dev/null 2>"$ERR" && fail "no line is taken"
grep -q 'no line on stdin' "$ERR" || fail "no line: $(cat "$ERR")"
expect 2 'give it on stdin' rig join hdrig1:example --dir "$OUT/m1"
"$HDRIG" rig join --dir "$OUT/none" <"$OUT/m1.line" 2>"$ERR" && fail "a folder that is not there"
printf 'rig.name = x\n  y\n' >>"$OUT/m1/hdrig.conf" # the second goes on with the first: y
cp "$OUT/m1/hdrig.conf" "$OUT/before"
refused 'must be changed by hand' "$line"
echo 'rig.color = red' >>"$OUT/m1/hdrig.conf"
cp "$OUT/m1/hdrig.conf" "$OUT/before"
refused 'hdrig.conf:13: unknown key' "$line"
sed -i '11,$d' "$OUT/m1/hdrig.conf"

# boards join: before the broker runs, and while it does
join() { # board options...
    "$HDRIG" rig join --dir "$OUT/$1" "${@:2}" <"$OUT/$1.line" >"$OUT/$1/told" 2>"$ERR" ||
        fail "rig join: $(cat "$ERR")"
}
join m1
grep -q 'does not let it in yet' "$ERR" || fail "no broker: $(cat "$ERR")"
printf 'user root\ninclude_dir %s/conf.d\n' "$MOSQUITTO" >"$OUT/mosquitto.conf"
mosquitto -c "$OUT/mosquitto.conf" 2>"$OUT/mosquitto.txt" &
pids+=($!)
for _ in $(seq 50); do
    grep -q ' running$' "$OUT/mosquitto.txt" && break
    sleep 0.1
done
join m1
grep -q 'the broker lets it in' "$ERR" || fail "join m1: $(cat "$ERR")"
[ ! -s "$OUT/m1/told" ] || fail "a second time changes $(cat "$OUT/m1/told")"
sed -i 's/^http.port/rig.broker = mqtt:\/\/old\n&/' "$OUT/m2/hdrig.conf"
chmod 600 "$OUT/m2/hdrig.conf"
join m2
join lead --conductor
grep -q 'the broker lets it in' "$ERR" || fail "join lead: $(cat "$ERR")"
grep -q "^rig.broker = mqtts://127.0.0.1:$PORT$" "$OUT/m2/told" ||
    fail "told: $(cat "$OUT/m2/told")"
[ "$(grep -c '^rig.broker' "$OUT/m2/hdrig.conf")" = 1 ] || fail "a setting twice"
mode "$OUT/m2/hdrig.conf" 600
mode "$OUT/lead/hdrig.conf" 644
grep -q '^# mine$' "$OUT/m2/hdrig.conf" || fail "a line is lost"
for name in lead m1 m2; do
    for file in rig-password http-token; do
        [ $(($(stat -c '0%a' "$OUT/$name/$file") & 7)) = 0 ] || fail "all can read $name/$file"
    done
done
grep -qF -f "$OUT/m2/http-token" "$OUT/m2/told" || fail "nobody tells the page's password"

# status and captures
says 1 'no daemon answers' lead status
printf 'rig.member.%d = %s\n' 1 lead 2 m1 3 m2 >>"$OUT/lead/hdrig.conf"
start lead
start m2
for _ in $(seq 100); do
    on lead status >"$OUT/stdout.txt" 2>/dev/null
    grep -q '^lead, .*, leads: .*m1' "$OUT/stdout.txt" &&
        grep -q '^m2 .* ready' "$OUT/stdout.txt" && break
    sleep 0.1
done
says 3 '^lead, conductor of rig rig, leads: .*m1' lead status
says 3 '^m1 .*is not there' lead status
says 1 'm1' lead capture
start m1
wait_ready lead
says 0 '^lead, conductor of rig rig, leads: ready to capture$' lead status
for name in lead m1 m2; do
    says 0 "^$name  +1  +[0-9.]+ ms +[0-9.]+ GB +0  ready to capture$" lead status
done
says 0 '^m1, member of rig rig, led: ready' m1 status
on lead status --json | grep -q '^{"role":.*"members":' || fail "no JSON"
says 0 '^3 cameras of 3 boards began within [0-9.]+ ms of each other$' lead capture
take=$(head -n 1 "$OUT/stdout.txt")
[ "$(grep -o '"name": "m[12]"\|"name": "lead"' "$take/manifest.json" | sort -u | wc -l)" = 3 ] ||
    fail "no joint take at $take"
says 1 'alone tells' m1 capture
says 2 'is needed' lead forget
says 2 'neither the name' lead forget 'a b'
says 1 'm9|nothing' lead forget m9

# who may say what: a member under its own name; and hear what is for it
hears() { # board filter: for 2 s, to heard.txt
    client "$1" hear "$2" >"$OUT/heard.txt" 2>"$OUT/listener.txt" &
    listener=$!
    for _ in $(seq 50); do
        grep -q listens "$OUT/listener.txt" && return
        sleep 0.05
    done
    fail "cannot listen: $(cat "$OUT/listener.txt")"
}
hears lead hdrig/1/rig/#
client m1 say hdrig/1/rig/ask/m1 own
for topic in ask/m2 member/m2 press/m2 report/m2 report/lead order conductor time/m1 other; do
    client m1 say hdrig/1/rig/$topic forged 2>"$ERR" || fail "say $topic"
done
wait $listener
grep -q '^hdrig/1/rig/ask/m1 own$' "$OUT/heard.txt" || fail "its own words are not heard"
grep forged "$OUT/heard.txt" && fail "m1 speaks as another"
for filter in hdrig/1/rig/member/m2 'hdrig/1/rig/report/#' '$SYS/broker/version'; do
    client m1 hear "$filter" >"$OUT/heard.txt" 2>/dev/null &&
        fail "m1 hears $(cat "$OUT/heard.txt")"
done

# wrong password, wrong authority, no TLS
cp -r "$OUT/spare.line" "$OUT/old.line"
add spare >"$OUT/spare.line" # not told to the broker
mkdir "$OUT/spare"
join spare
grep -q 'does not let it in yet: .*[Nn]ot authori' "$ERR" || fail "wrong password: $(cat "$ERR")"
mkdir "$OUT/foreign"
"$HDRIG" rig broker --host 127.0.0.1 --port "$PORT" --conductor lead --dir "$OUT/foreign" \
    >"$OUT/spare.line" 2>"$ERR"
join spare
grep -q 'does not let it in yet: .*certificate' "$ERR" || fail "wrong authority: $(cat "$ERR")"

# a board that is removed is out at once, the others notice nothing; added again it is in again
reload() {
    kill -HUP "${pids[0]}"
}
cp "$MOSQUITTO/hdrig/users" "$OUT/users.txt"
expect 2 'name of the board' rig remove --dir "$MOSQUITTO"
expect 1 '"m9" is no board of this rig' rig remove m9 --dir "$MOSQUITTO"
expect 1 '"m" is no board of this rig' rig remove m --dir "$MOSQUITTO"
expect 1 'lead leads the rig' rig remove lead --dir "$MOSQUITTO"
expect 1 'hdrig rig broker makes it' rig remove m2 --dir "$OUT/none"
cmp -s "$OUT/users.txt" "$MOSQUITTO/hdrig/users" || fail "refusals change the users"
says 0 'ready to capture$' lead status
grep -v '^m2:' "$OUT/users.txt" >"$OUT/others.txt"
seen=$(wc -l <"$OUT/mosquitto.txt")
"$HDRIG" rig remove m2 --dir "$MOSQUITTO" 2>"$ERR" || fail "rig remove: $(cat "$ERR")"
grep -q 'hdrig rig forget m2' "$ERR" || fail "nobody says what is left to do: $(cat "$ERR")"
cmp -s "$OUT/others.txt" "$MOSQUITTO/hdrig/users" || fail "not only m2 is removed"
mode "$MOSQUITTO/hdrig/users" "$(stat -c %a "$MOSQUITTO/hdrig/acl")"
reload
for _ in $(seq 400); do # its silence tells, mosquitto does not
    on lead status >"$OUT/stdout.txt" 2>/dev/null
    grep -q '^m2 .*is not there' "$OUT/stdout.txt" && break
    sleep 0.1
done
says 3 '^m2 .*is not there' lead status
says 3 '[Nn]ot authori' m2 status
client m2 hear hdrig/1/rig/order >"$OUT/heard.txt" 2>"$ERR" && fail "m2 gets in"
grep -q '[Nn]ot authori' "$ERR" || fail "m2 is kept out by $(cat "$ERR")"
says 3 '^m1 .* ready to capture$' lead status
tail -n +$((seen + 1)) "$OUT/mosquitto.txt" | grep -E 'm1|lead' >"$OUT/stdout.txt" &&
    fail "others are disturbed: $(cat "$OUT/stdout.txt")"
add m2 >"$OUT/m2.line"
reload
join m2
grep -q 'the broker lets it in' "$ERR" || fail "join m2 again: $(cat "$ERR")"

# no secret in arguments, logs and files that all can read
rm -r "$SOCKETS"
wait $watcher
for file in "$OUT"/*/rig-password "$OUT"/*/http-token; do
    secret=$(cat "$file")
    [ ${#secret} -ge 16 ] || fail "$file is too short"
    grep -F -e "$secret" "$OUT/arguments.txt" >/dev/null && fail "$file is in arguments"
    grep -F -e "$secret" "$OUT"/*/log "$OUT/mosquitto.txt" && fail "$file is in a log"
    open=$(find "$OUT" -type f -perm /007 ! -name '*.line' ! -name told ! -name '*.txt' \
        -exec grep -lF -e "$secret" {} +)
    [ -z "$open" ] || fail "$file: all can read $open"
done
grep -q 'rig join --dir' "$OUT/arguments.txt" || fail "nobody looked at arguments"
finish
