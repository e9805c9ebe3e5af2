# The whole machine: button, lamp, two USB cameras, hdrigd and hdrig; what it stores is compared
# with the truth in the frames.
. "${0%/*}/common.bash"
hdrig=$BIN/../../hdrig

load gpio-sim
load vhci-hcd
load uvcvideo
chip=/sys/kernel/config/gpio-sim/rig
mkdir -p $chip/bank0/line3 $chip/bank0/line5
echo 8 >$chip/bank0/num_lines
echo rigchip >$chip/bank0/label
echo shutter >$chip/bank0/line3/name
echo lamp >$chip/bank0/line5/name
echo 1 >$chip/live
lines=/sys/devices/platform/$(cat $chip/dev_name)/$(cat $chip/bank0/chip_name)

sim=sim:kind=room,seed=5,size=112,samples=1,shadow=1,length=limit,quantum=100,longest=30000
sim+=",metadata=absent,faults=at frame 0 lose 0.03"
"$BIN/usbcam" "$sim,delay=2,views=2,view=0" &
cam=$!
await camera test -e /dev/video0
"$BIN/usbcam" -p 1 "$sim,delay=3,views=2,view=1,skew=9000" &
await "second camera" test -e /dev/video2

write_settings <<END
camera.1 = v4l2:/dev/video0
camera.2 = v4l2:/dev/video2
trigger.1 = gpio:rigchip/shutter
trigger.lockout_ms = 50
lamp = gpio:rigchip/lamp
END

press() { # with bounce
    local ms
    for ms in 1 2 1 3; do
        echo pull-down >$lines/sim_gpio3/pull
        nap 0.00$ms
        echo pull-up >$lines/sim_gpio3/pull
        nap 0.00$ms
    done
    echo pull-down >$lines/sim_gpio3/pull
    nap 0.06
    echo pull-up >$lines/sim_gpio3/pull
}

takes() {
    local all=(store/????????-??????)
    [ -e "${all[0]}" ] || all=()
    echo ${#all[@]}
}

stored() { # number
    [ "$(takes)" = "$1" ]
}

lit() { # whether the lamp is lit steadily
    local i v
    for ((i = 0; i < 30; i++)); do
        read -r v <$lines/sim_gpio5/value
        [ "$v" = 1 ] || return
        nap 0.02
    done
}

start() {
    "$BIN/../../hdrigd" --config hdrig.conf &
    daemon=$!
    await "lamp that says ready" lit
}

echo "== one take per press, whatever the button's bounce"
mkdir store
start
"$hdrig" status --config hdrig.conf
for i in 1 2 3 4 5; do
    press
    await "take $i" stored $i
    await "lamp that says ready" lit
done

echo "== pressed while it is busy: told, and no take of its own"
press
nap 0.03
press
await "take 6" stored 6
nap 3
stored 6 || fail "$(takes) takes of 6"
"$hdrig" status --config hdrig.conf

echo "== asked for by command"
"$hdrig" capture --config hdrig.conf | sed "s/.*-//"
stored 7 || fail "$(takes) takes of 7"

echo "== a camera is pulled out and comes back"
kill -USR1 $cam
nap 0.2
lit && fail "the lamp is steady without a camera"
await "lamp that says ready" lit
press
await "take 8" stored 8

echo "== SIGTERM while a bracket is taken"
press
nap 0.2
before=$(date +%s%N)
kill $daemon
wait $daemon || fail "hdrigd ended with $?"
between "ms to the end" $((($(date +%s%N) - before) / 1000000)) 0 2100
start
kill $daemon
wait $daemon || fail "hdrigd ended with $?"

echo "== without a daemon"
"$hdrig" capture --camera v4l2:/dev/video0 --bracket auto --out alone --config hdrig.conf >/dev/null
ls alone
mkdir more
mv alone more/00000000-000001
"$BIN/truth_check" more
"$BIN/truth_check" store >result || fail "$(cat result)"
cat result
between "complete takes" "$(sed 's/ takes.*//' result)" 8 9
