# A USB camera is pulled out and closed before udevd says so, where libcamera's stop would abort.
# Real time: libcamera polls without rest meanwhile, and virtual time would not pass.
. "${0%/*}/libcamera.bash"

load vhci-hcd
load uvcvideo
name_controller
start_udev
"$BIN/usbcam" sim:kind=room,seed=5,size=56,samples=1,shadow=1,length=limit &
cam=$!
await_node /dev/video0

"$BIN/camera_probe" "libcamera:,module=$module" frames 100000 >seen &
probe=$!
await frames grep -q 'frame +' seen
kill -STOP $udev
kill $cam
await "end of patience" grep -q 'error -6' seen
nap 0.3
kill -CONT $udev
rc=0
wait $probe || rc=$?
expect "status of the probe" $rc 1
kill $udev
