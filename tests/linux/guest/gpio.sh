# A button that bounces and a lamp, on the kernel's simulated GPIO chip.
. "${0%/*}/common.bash"

load gpio-sim
config=/sys/kernel/config/gpio-sim/rig

plug() {
    echo 1 >$config/live
    lines=/sys/devices/platform/$(cat $config/dev_name)/$(cat $config/bank0/chip_name)
    chip=/dev/$(cat $config/bank0/chip_name)
}

mkdir -p $config/bank0/line3 $config/bank0/line5
echo 8 >$config/bank0/num_lines
echo rigchip >$config/bank0/label
echo shutter >$config/bank0/line3/name
echo lamp >$config/bank0/line5/name
plug

pull() { # down|up, that many ms
    echo "pull-$1" >"$lines/sim_gpio3/pull"
    printf -v seconds '0.%03d' "$2"
    nap $seconds
}

press() { # bounces going down and up
    local ms
    for ms in 1 2 1 3; do
        pull down $ms
        pull up $ms
    done
    pull down 60
    for ms in 2 1 4; do
        pull up $ms
        pull down $ms
    done
    pull up 60
}

# probe SCHEME URI [DEAF_MS]: from now on its output goes to the file `seen`.
probe() {
    rm -f seen
    "$BIN/trigger_probe" "$@" >seen &
    pid=$!
    await "answer of the probe" test -s seen
}

# What it said, when it has ended with that status, goes to the file `events`.
ended() { # status
    local rc=0
    wait $pid || rc=$?
    [ $rc = "$1" ] || fail "the probe ended with $rc, not $1: $(cat seen)"
    sed 1d seen >events
    head -n 20 events
}

echo "== one event per press, by names of chip and line"
for scheme in gpio gpiod; do
    probe "$scheme" "$scheme:rigchip/shutter"
    for _ in 1 2 3 4 5 6 7 8 9 10; do press; done
    ended 0
    expect "$scheme: events of 10 presses" "$(wc -l <events)" 10
    expect "$scheme: last one" "$(tail -n 1 events | cut -d ' ' -f 1-4)" "event 10 lost 0"
done

echo "== a glitch of 3 ms is none, one of 3 ms is one without debouncing"
probe gpio "gpio:$chip/3"
pull down 3
pull up 500
ended 0
expect "events" "$(wc -l <events)" 0
probe gpio "gpio:$chip/3,debounce_ms=0"
pull down 3
pull up 500
ended 0
expect "events" "$(wc -l <events)" 1

echo "== the other edge"
pull down 10
probe gpio "gpio:$chip/shutter,edge=rising,bias=down"
pull up 50
pull down 50
pull up 50
ended 0
expect "events" "$(wc -l <events)" 2

echo "== held while it is opened: counts when it is pressed again"
pull down 10
probe gpio "gpio:$chip/3,bias=none"
nap 0.2
pull up 100
pull down 100
pull up 100
ended 0
expect "events" "$(wc -l <events)" 1

echo "== 100 presses a second"
probe gpio "gpio:$chip/3,debounce_ms=0" # which a tick of 4 ms would make 8
for ((i = 0; i < 200; i++)); do
    pull down 5
    pull up 5
done
ended 0
expect "last event" "$(tail -n 1 events | cut -d " " -f 1-4)" "event 200 lost 0"

echo "== nobody reads for 4 s: what the kernel drops is counted"
probe gpio "gpio:$chip/3,debounce_ms=0" 4000
for ((i = 0; i < 700; i++)); do
    pull down 1
    pull up 1
done
ended 0
lost=$(awk '{ n += $4 } END { print n }' events)
between "edges lost" "$lost" 1 1399
expect "edges" $((lost + 2 * $(wc -l <events))) 1400

echo "== nothing there"
for uri in gpio:/dev/gpiochip9/3 gpio:nochip/3 gpio:rigchip/noline gpio:rigchip/8; do
    "$BIN/trigger_probe" gpio $uri && fail "$uri opens"
done

echo "== taken by somebody else"
probe gpio "gpio:$chip/3"
"$BIN/trigger_probe" gpio "gpio:$chip/3" && fail "a line opens twice"
"$BIN/lamp_probe" "gpio:$chip/3" "$lines/sim_gpio3/value" off 1 && fail "a button is a lamp"
wait $pid || fail "the first one did not live on"

echo "== the chip goes away and comes back"
probe gpio "gpio:$chip/3"
echo 0 >$config/live
ended 1
mkdir $config/bank0/line3/hog
echo bootloader >$config/bank0/line3/hog/name
echo input >$config/bank0/line3/hog/direction
plug
"$BIN/trigger_probe" gpio "gpio:$chip/3" && fail "a hogged line opens"
echo 0 >$config/live
rmdir $config/bank0/line3/hog
plug
probe gpio "gpio:rigchip/3"
press
ended 0
expect "events" "$(wc -l <events)" 1

echo "== the lamp"
value=$lines/sim_gpio5/value
"$BIN/lamp_probe" gpio:rigchip/lamp "$value" off 10 armed 50 busy 200 fault 200 armed 10 >seen
cat seen
for pattern in 'off 10-' 'armed 50[+]' 'busy( 1[23][+] 1[23]-){8}' \
    'fault( 10[+] 10- 10[+] 70-){2}' 'armed 10[+]' 'closed 0'; do
    grep -Eqx "$pattern" seen || fail "the lamp did not show $pattern"
done
"$BIN/lamp_probe" "gpio:$chip/5,active=low" "$value" off 5 armed 5 >seen
expect "the other way round" "$(head -n 2 seen | tr '\n' ' ')" "off 5+ armed 5- "
"$BIN/lamp_probe" gpio:rigchip/lamp "$value" busy 300 >seen &
pid=$!
nap 1
echo 0 >$config/live
wait $pid && fail "a lamp without a chip shines"
cat seen
expect "without a chip" "$(grep -c 'error -7' seen)" 1

echo "== a timer"
timeout 2.1 "$BIN/trigger_probe" timer timer:0.25 >seen || true
cat seen
expect "events in 2.1 s" "$(grep -c event seen)" 8
