# A USB camera is pulled out and comes back, again and again, while the daemon streams and takes
# brackets: neither descriptors nor memory leak, in the daemon and in the kernel.
. "${0%/*}/common.bash"
warm=20
cycles=300
if [ "$BENCH" = qemu ]; then
    cycles=30
    echo "skipped: 270 of 300 cycles, since they take ten times as long"
fi

load vhci-hcd
load uvcvideo
sim=sim:kind=room,seed=5,size=56,samples=1,shadow=1,length=limit,quantum=100,longest=30000
"$BIN/usbcam" "$sim,metadata=absent,delay=2" &
cam=$!
await camera test -e /dev/video0

write_settings <<END
camera.1 = v4l2:/dev/video0
trigger.1 = timer:0.7
store.keep = 3
END
mkdir store
"$BIN/../../hdrigd" --config hdrig.conf >log 2>&1 &
daemon=$!
nap 3

figure() { # kB of a file in /proc
    sed -n "s/^$1:[[:space:]]*\([0-9]*\) kB/\1/p" "$2"
}

figures() {
    local status=/proc/$daemon/status
    now=("$(descriptors $daemon)" "$(figure VmRSS $status)" "$(figure VmData $status)"
        "$(figure MemAvailable /proc/meminfo)")
    echo "$1 cycles: ${now[0]} descriptors, ${now[1]} kB resident, ${now[2]} kB of data;" \
        "${now[3]} kB free in the machine"
}

for ((i = 1; i <= warm + cycles; i++)); do
    kill -USR1 $cam
    printf -v pause 3.%02d $((i * 37 % 100)) # every moment of a press, whatever the machine takes
    nap $pause
    [ $((i % 20)) != 0 ] || figures $i
    [ $i != $warm ] || before=("${now[@]}")
done
kill $daemon
wait $daemon || fail "hdrigd ended with $?"
kill $cam
wait $cam || fail "usbcam ended with $?"

tail -n 12 log
lines() {
    grep -c -- "$1" log || true
}
expect "pulled out" "$(lines ': unplugged')" $((warm + cycles))
expect "taken up again" "$(lines 'available again')" $((warm + cycles))
between "brackets that were cut" "$(lines '^aborted-')" $((cycles / 5)) $((warm + cycles))
between "complete takes" "$(lines '^[0-9a-f]*-[0-9]*: 3 frames')" $((cycles / 5)) 10000
expect "descriptors" "${now[0]}" "${before[0]}"
between "kB more resident" $((now[1] - before[1])) -10000 $cycles
between "kB more of data" $((now[2] - before[2])) -10000 $cycles
between "kB less in the machine" $((before[3] - now[3])) -100000 $((4 * cycles))
