# A key of a keyboard that is a program (tests/linux/keypad.c), behind the kernel's input devices.
. "${0%/*}/common.bash"
hdrig=$BIN/../../hdrig
enter=28 space=57 a=30

load evdev
load uinput

is_there() {
    local f
    for f in /sys/class/input/event*/device/name; do
        if [ -e "$f" ] && [ "$(cat "$f")" = "hdrig keypad" ]; then
            f=${f%/device/name}
            node=/dev/input/${f##*/}
            return
        fi
    done
    return 1
}

plug() { # operation... of the keypad, once a probe has had the time to open it
    "$BIN/keypad" nap 500 "$@" &
    pad=$!
    await keypad is_there
    ln -sf $node key
}

# probe STATUS OPTIONS [DEAF_MS]: its events go to the file `seen`.
probe() {
    local rc=0
    "$BIN/trigger_probe" evdev "evdev:$PWD/key$2" "${@:3}" >seen || rc=$?
    head -n 15 seen
    [ $rc = "$1" ] || fail "the probe ended with $rc, not $1"
}

pulled() {
    wait $pad || fail "the keypad ended with an error"
    is_there && fail "the keypad is still there"
    true
}

presses() { # how many, of which key, ms, nap
    local i
    for ((i = 0; i < $1; i++)); do
        printf 'press %s %s nap %s ' "$2" "$3" "$4"
    done
}

echo "== one event per press, none for being let go"
plug $(presses 10 $enter 60 140) nap 1500
probe 0 ""
expect "events" "$(count event)" 10
expect "200 ms apart" "$(count 'lost 0 after 200 ms')" 9
pulled

echo "== held for 3 s: the kernel repeats it, we do not"
plug press $enter 3000 nap 400 press $enter 3000 nap 1500
probe 0 "" # which silence of 1 s would end
expect "events" "$(count event)" 2
expect "the second" "$(count 'event 2 lost 0 after 3400 ms')" 1
pulled

echo "== one key of several; any key"
plug press $space 50 nap 50 press $enter 50 nap 50 press $a 50 nap 1500
probe 0 ",key=$enter"
expect "events" "$(count event)" 1
pulled
plug down $space nap 50 down $enter nap 50 up $enter up $space nap 1500
probe 0 ""
expect "events" "$(count event)" 2
pulled
plug nap 100
"$BIN/trigger_probe" evdev "evdev:$PWD/key,key=48" && fail "opened for a key that it has not"
pulled

echo "== held while it is opened: counts when it is pressed again"
"$BIN/keypad" down $enter nap 700 up $enter nap 100 press $enter 50 nap 1500 &
pad=$!
await keypad is_there
ln -sf $node key
nap 0.1
probe 0 ",key=$enter"
expect "events" "$(count event)" 1
pulled

echo "== 100 presses a second"
plug $(presses 200 $enter 5 5) nap 1500
probe 0 ""
expect "last event" "$(tail -n 1 seen | cut -d ' ' -f 1-4)" "event 200 lost 0"
pulled

echo "== more at once than the kernel keeps: said, nothing is made up, and it goes on"
plug flood 2000 nap 1000 press $enter 50 nap 150 press $enter 50 nap 1500
probe 0 "" 1000
between "events" "$(count event)" 2 1999
between "losses told" "$(awk '{ n += $4 } END { print n }' seen)" 1 1000
expect "the last press" "$(tail -n 1 seen | cut -d ' ' -f 3-)" "lost 0 after 200 ms"
pulled

echo "== pulled out, and back, ten times"
for ((i = 0; i < 10; i++)); do
    plug press $enter 50 nap 100
    probe 1 ""
    expect "events" "$(count event)" 1
    expect "lost" "$(tail -n 1 seen | cut -d : -f 1)" "error -7"
    pulled
    "$BIN/trigger_probe" evdev "evdev:$PWD/key" >seen && fail "opened without a keypad"
    expect "absent" "$(cut -d : -f 1 seen)" "error -7"
done

echo "== the daemon lives on without it, and takes it up again"
write_settings <<END
camera.1 = sim:kind=room,seed=5,size=112,samples=1,shadow=1,views=1
trigger.1 = evdev:$PWD/key,key=$enter
END
mkdir store

stored() { # number
    local all=(store/????????-??????)
    [ -e "${all[0]}" ] || all=()
    [ ${#all[@]} = "$1" ]
}

answers() {
    "$hdrig" status --config hdrig.conf >status
}

"$hdrig"d --config hdrig.conf &
daemon=$!
await "answer of the daemon" answers
for i in 1 2 3; do
    plug nap 4000 press $enter 1000 nap 5000
    await "take $i" stored "$i"
    pulled
    answers || fail "the daemon has gone with the keypad"
done
stored 3 || fail "a press became more than one take"
kill $daemon
wait $daemon || fail "hdrigd ended with $?"
