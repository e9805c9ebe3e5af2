# Cameras of the kernel through libcamera: vimc, whose sensor has no exposure, and a USB camera.
. "${0%/*}/libcamera.bash"
start_udev

echo "== vimc"
load vimc
await_node /dev/video2
probe_camera 0 "libcamera:,module=$module" frames 8 ask 5000 frames 2 reopen 3
expect "reopened" "$(count 'opened 3 of 3 times')" 1
expect "frames in order" "$(count 'frame +1 ')" 9
unload vimc

echo "== USB camera"
load vhci-hcd
load uvcvideo
name_controller
sim=sim:kind=room,seed=5,size=112,samples=1,shadow=1,length=limit,quantum=100,longest=30000
"$BIN/usbcam" $sim &
cam=$!
await_node /dev/video0
probe_camera 0 "libcamera:,module=$module" frames 12 ask 5000 until 5000 frames 4 \
    ask 20000 until 20000 frames 4 ask 1000 until 1000 frames 4
expect "obeyed" "$(count 'there after')" 3
expect "frames of the last setting" "$(tail -n 4 seen | grep -c ' truth .* 1000 us')" 4

echo "== pulled out while it streams, and back"
for _ in 1 2 3; do
    rm seen
    "$BIN/camera_probe" "libcamera:,module=$module" frames 1000 >seen &
    probe=$!
    await frames grep -q 'frame +' seen
    kill -USR1 $cam
    rc=0
    wait $probe || rc=$?
    expect "status of the probe" $rc 1
    expect "lost" "$(tail -n 1 seen | cut -d : -f 1)" "error -7"
    probe_camera 2 "libcamera:,module=$module" frames 1
    expect "absent" "$(cut -d : -f 1 seen)" "error -7"
    await_node /dev/video0
    probe_camera 0 "libcamera:,module=$module" frames 4
done

echo "== the daemon lives on without it, and takes it up again"
write_settings <<END
camera.1 = libcamera:,module=$module
trigger.1 = timer:0.7
store.keep = 3
END
mkdir store
"$BIN/../../hdrigd" --config hdrig.conf >log 2>&1 &
daemon=$!
nap 4
for ((i = 1; i <= 10; i++)); do
    kill -USR1 $cam
    nap 5.$i
    [ $i != 2 ] || before=$(descriptors $daemon)
done
after=$(descriptors $daemon)
kill $daemon
wait $daemon || fail "hdrigd ended with $?"
tail -n 12 log
expect "pulled out" "$(grep -c 'the camera has gone' log)" 10
expect "taken up again" "$(grep -c 'available again' log)" 10
between "complete takes" "$(grep -c '^[0-9a-f]*-[0-9]*: 3 frames' log)" 10 100
expect "descriptors" "$after" "$before"
kill $cam $udev
