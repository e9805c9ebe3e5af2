# A USB camera (tests/linux/usbcam.c) behind the kernel's own uvcvideo, seen through camera_v4l2.
. "${0%/*}/common.bash"

load vhci-hcd
load uvcvideo
sim=sim:kind=room,seed=5,size=112,samples=1,shadow=1,length=limit,quantum=100,longest=30000
sim+=,metadata=absent
node=/dev/video0

# plug [OPTION...] KEY=VALUE,...: a camera with these keys beyond the usual ones.
plug() {
    "$BIN/usbcam" "${@:1:$#-1}" "$sim${!#:+,${!#}}" &
    cam=$!
    await camera test -e $node
}

pull() {
    kill $cam
    wait $cam || fail "usbcam ended with an error"
    await "end of the camera" test ! -e $node
}

probe() {
    probe_camera "$1" v4l2:$node "${@:2}"
}

echo "== exposures come when they may, and stay; automatic exposure does not"
plug delay=3
probe 0 frames 9 ask 5000 until 5000 frames 4 ask 100 until 100 ask 30000 until 30000 \
    ask 12345 until 12300 frames 3 reopen 20
expect "frames with 5 ms, once there" \
    "$(sed '1,/there after/d; /ask 100 /,$d' seen | grep -c ' truth .* 5000 us')" 4
expect "frames before, when it does not wander any more" \
    "$(sed '/ask/,$d' seen | tail -n 4 | grep -c ' truth .* 10000 us')" 4
expect "settings that took 4 frames" "$(count 'there after 4 frames')" 4
expect "frames of the last setting" "$(count ' truth .* 12300 us')" 3
expect "opened" "$(count 'opened 20 of 20 times')" 1
probe 0 mjpg ask 2000 until 2000 frames 2
expect "JPEG frames with 2 ms" "$(count ' truth .* 2000 us')" 2
pull

echo "== a mosaic of 16 bits"
plug format=rggb
probe 0 ask 1000 until 1000 frames 2 ask 4000 until 4000 frames 2
expect "format" "$(head -n 1 seen | grep -c 'rggb16 16 bits')" 1
awk '/ mean / { for (i = 1; i < NF; i++) if ($i == "mean") m[n++] = $(i + 1) }
    END { r = m[3] / m[1]; print "4 times the light: " r; exit !(r > 3.2 && r < 4.1) }' seen ||
    fail "means do not follow exposures"
pull

echo "== frames that get lost: some are told by the sequence, others by time alone"
plug "faults=at frame 60 drop 1;at frame 70 drop 2 nogap"
probe 0 frames 90
expect "gaps of the sequence" "$(count 'frame +2 +67 ms')" 1
expect "gaps of time" "$(count 'frame +1 +100 ms')" 1
expect "others" "$(count 'frame +1 +33 ms')" 87
pull

echo "== bad frames: dropped by uvcvideo"
plug "faults=at frame 60 error;at frame 70 short 5000"
probe 0 frames 80
expect "gaps of the sequence" "$(count 'frame +2 +67 ms')" 2
expect "flagged frames" "$(count 'flags [^0]')" 0
pull
unload uvcvideo
echo "== bad frames: handed over"
load uvcvideo nodrop=1
plug "faults=at frame 60 error;at frame 70 short 5000;at frame 80 drop 1"
probe 0 frames 90
expect "flagged frames" "$(count 'flags [^0]')" 3
pull
unload uvcvideo
load uvcvideo

echo "== settings that the camera refuses; in a wrong state it is asked twice"
plug "faults=at frame 50 refuse busy 1;at frame 80 refuse range 1;at frame 110 refuse access 3"
probe 0 frames 60 ask 5000 ask 5000 until 5000 frames 25 ask 6000 ask 6000 until 6000 \
    frames 30 ask 7000 ask 7000 until 7000
expect "refused" "$(count 'error')" 3
expect "obeyed" "$(count 'there after')" 3
pull

echo "== pulled out while it streams, and back"
plug "faults=at frame 60 unplug"
for _ in 1 2 3; do
    probe 1 frames 200
    expect "lost" "$(tail -n 1 seen | cut -d : -f 1)" "error -7"
    head -n 1 seen | cut -d : -f 1 >unit.new
    [ ! -e unit ] || cmp unit unit.new || fail "the camera is another one after plugging in again"
    mv unit.new unit
    await "end of the camera" test ! -e $node
    probe 2
    await camera test -e $node
done
pull

echo "== no frames any more"
plug "faults=at frame 60 stall 0"
probe 1 frames 200
expect "silence" "$(tail -n 1 seen)" "error -6: no frame in 5 s"
pull

echo "== in use"
plug ""
"$BIN/camera_probe" v4l2:$node frames 60 >other &
pid=$!
await "frames of the first one" grep -q frame other
probe 2
expect "busy" "$(cut -d : -f 1 seen)" "error -9"
wait $pid || fail "the first user lost it"
pull
