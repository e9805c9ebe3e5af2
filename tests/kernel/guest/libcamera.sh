# Cameras of the kernel through libcamera: vimc, whose sensor has no exposure, and a USB camera.
. "${0%/*}/common.bash"

export LIBCAMERA_LOG_NO_COLOR=1 LIBCAMERA_LOG_LEVELS='*:ERROR'
module=$(realpath "$BIN/../../hdrig-libcamera.so")

# libcamera takes only devices that udevd has seen; this is what it leaves in its database.
mark_devices() {
    local d
    mkdir -p /run/udev/data
    for d in /sys/bus/media/devices/*/dev /sys/class/video4linux/*/dev; do
        echo I:1 >"/run/udev/data/c$(cat "$d")"
    done
    : >/run/udev/control
}

# It names a USB camera by the firmware's node of its controller; vhci_hcd has none. A folder in
# memory over the controller's, with everything bound back and such a node added.
name_controller() {
    local d=/sys/devices/platform/vhci_hcd.0 e to
    mkdir -p /run/controller
    mount --bind $d /run/controller
    mount -t tmpfs controller $d
    for e in /run/controller/*; do
        to=$d/${e##*/}
        if [ -L "$e" ]; then
            ln -s "$(readlink "$e")" "$to"
        else
            if [ -d "$e" ]; then mkdir "$to"; else : >"$to"; fi
            mount --bind "$e" "$to"
        fi
    done
    mkdir $d/firmware_node
    echo '\_SB_.SIM0' >$d/firmware_node/path
}

echo "== vimc"
load vimc
await "its nodes" test -e /dev/video2
mark_devices
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
await camera test -e /dev/video0
mark_devices
probe_camera 0 "libcamera:,module=$module" frames 12 ask 5000 until 5000 frames 4 \
    ask 20000 until 20000 frames 4 ask 1000 until 1000 frames 4
expect "obeyed" "$(count 'there after')" 3
expect "frames of the last setting" "$(tail -n 4 seen | grep -c ' truth .* 1000 us')" 4

echo "== pulled out, and back"
kill -USR1 $cam
await "end of the camera" test ! -e /dev/video0
probe_camera 2 "libcamera:,module=$module" frames 1
expect "lost" "$(cut -d : -f 1 seen)" "error -7"
await camera test -e /dev/video0
mark_devices
probe_camera 0 "libcamera:,module=$module" frames 4
kill $cam
