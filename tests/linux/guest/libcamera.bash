# Sourced by the tests of libcamera, which learns from udevd which devices come and go.
. "${0%/*}/common.bash"
export LIBCAMERA_LOG_NO_COLOR=1 LIBCAMERA_LOG_LEVELS='*:ERROR'
module=$(realpath "$BIN/../../hdrig-libcamera.so")

start_udev() {
    /lib/systemd/systemd-udevd >/dev/null 2>&1 &
    udev=$!
    await udevd test -e /run/udev/control
}

# A node that udevd has seen.
await_node() { # path
    await "$1" test -e "$1"
    udevadm settle
}

# libcamera names a USB camera by the firmware's node of its controller; vhci_hcd has none. A folder
# in memory over the controller's, with everything bound back and such a node added.
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
