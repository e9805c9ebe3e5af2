# Brackets through session, bracket machine, camera_v4l2 and the kernel's uvcvideo, on USB cameras
# that misbehave. Every kept frame has the truth in its pixels: none may be mislabelled.
. "${0%/*}/common.bash"

load vhci-hcd
load uvcvideo
sim=sim:kind=room,seed=5,size=112,samples=1,shadow=1,length=limit,quantum=100,longest=30000
sim+=,metadata=absent

# shoot LEAST TAKES MIDDLE STOPS KEY=VALUE,...: so many takes, at least LEAST of them complete.
shoot() {
    local least=$1 rc=0 cam
    echo "== $5"
    "$BIN/usbcam" "$sim,$5" &
    cam=$!
    await camera test -e /dev/video0
    "$BIN/bracket_probe" "${@:2:3}" v4l2:/dev/video0 >seen || rc=$?
    cat seen
    [ $rc = 0 ] || fail "a frame is mislabelled, or the probe failed"
    between "complete takes" "$(sed -n 's/^\([0-9]*\) takes complete.*/\1/p' seen)" "$least" "$2"
    kill $cam
    wait $cam || fail "usbcam ended with an error"
    await "end of the camera" test ! -e /dev/video0
}

shoot 10 10 0.003 -2,0,2 delay=2
shoot 10 10 0.003 3,-3,0 delay=5
shoot 5 5 0.003 -3,-2,-1,0,1,2,3 delay=1
shoot 5 5 0 - delay=3
shoot 10 10 0.003 -2,0,2 format=rggb
shoot 10 10 0.003 -2,0,2 readback=lagged
shoot 9 10 0.003 -2,0,2 readback=cached

echo "== frames get lost"
shoot 18 20 0.003 -2,0,2 "faults=at frame 0 lose 0.05"

# every STEP FAULT...: again and again, from frame 20 on; %d becomes 1 to 3.
every() {
    local i
    for ((i = 20; i < 1500; i += $1)); do
        printf "at frame $i $2\n" $((i % 3 + 1))
    done >faults
}

every 13 "drop %d nogap"
shoot 9 10 0.003 -2,0,2 faults=faults
every 11 error
shoot 9 10 0.003 -2,0,2 faults=faults
every 11 repeat
shoot 9 10 0.003 -2,0,2 faults=faults

echo "== exposures that do not come"
every 37 "ignore %d"
shoot 9 10 0.003 -2,0,2 faults=faults
every 29 "refuse busy 1"
shoot 9 10 0.003 -2,0,2 faults=faults
shoot 0 5 0.003 -2,0,2 "faults=at frame 40 ignore 0"
shoot 0 5 0.003 -2,0,2 "faults=at frame 40 rollover 40"
shoot 0 5 0.003 -2,0,2 "faults=at frame 40 quantum 0.002"

echo "== pulled out again and again"
shoot 6 10 0.003 -2,0,2 "faults=at frame 70 unplug"

echo "== two cameras"
"$BIN/usbcam" "$sim,delay=2" &
one=$!
await camera test -e /dev/video0
"$BIN/usbcam" -p 1 "$sim,delay=4,skew=9000" &
two=$!
await "second camera" test -e /dev/video2
"$BIN/bracket_probe" 10 0.003 -2,0,2 v4l2:/dev/video0 v4l2:/dev/video2 || fail "two cameras"
kill $one $two
