# The kernel's virtual camera, with many formats and errors on demand, through camera_v4l2.
. "${0%/*}/common.bash"

load vivid n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0x0,0x0 multiplanar=1,2
await camera test -e /dev/video1
pattern=0x00f0f000 text=0x00f0f001 brightness=0x00980900 dropped=0x00f0f040

# shade LINE...: means of that frame of `seen`, as l(ow), m(iddle), h(igh).
shade() {
    awk -v at="$1" '/ bits, / { for (i = 1; i < NF; i++) if ($(i + 1) == "bits,") top = 2 ^ $i - 1 }
        / mean / { n++; if (n == at) {
            for (i = 1; $i != "mean"; i++);
            for (i++; i <= NF; i++) s = s ($i < 0.25 * top ? "l" : $i < 0.75 * top ? "m" : "h")
            print s } }' seen
}

# The colours of a format: white, black, red, blue.
colours() { # format node
    case $1 in
    grey*) echo "h l l l" ;;
    rggb*) echo "hhhh llll hlll lllh" ;;
    bggr*) echo "hhhh llll lllh hlll" ;;
    grbg*) echo "hhhh llll lhll llhl" ;;
    gbrg*) echo "hhhh llll llhl lhll" ;;
    *) echo "hhh lll hll llh" ;;
    esac
}

echo "== formats: white, black, red and blue are what they should be"
for node in /dev/video0 /dev/video1; do
    for format in yuyv nv12 rgb8 bgr8 grey grey16 rggb16 bggr16 grbg16 gbrg16; do
        probe_camera 0 v4l2:$node 640x360 $format control $text=2 control $pattern=6 frames 6 \
            control $pattern=5 frames 6 control $pattern=7 frames 6 control $pattern=9 frames 6 \
            control $pattern=6
        expect "$node has $format" "$(head -n 1 seen | cut -d ' ' -f 2-4,7)" "640 x 360 $format"
        expect "colours of $format" "$(shade 6) $(shade 12) $(shade 18) $(shade 24)" \
            "$(colours $format)"
    done
done

echo "== sizes"
for size in 320x180 1280x720 1920x1080 3840x2160; do
    probe_camera 0 v4l2:/dev/video0 $size yuyv frames 3
    expect "size" "$(head -n 1 seen | cut -d ' ' -f 2-4 | tr -d ' ')" $size
done
probe_camera 2 v4l2:/dev/video0 641x361 yuyv
probe_camera 2 v4l2:/dev/video0 mjpg

echo "== an exposure cannot be asked for, since it has none"
probe_camera 0 v4l2:/dev/video0 frames 1 ask 10000 frames 2
expect "refused" "$(count 'error -8')" 1

echo "== opened 20 times"
probe_camera 0 v4l2:/dev/video0 reopen 20
expect "opened" "$(count 'opened 20 of 20 times')" 1
probe_camera 0 v4l2:/dev/video1 reopen 20
expect "opened" "$(count 'opened 20 of 20 times')" 1

echo "== lost buffers leave gaps" # which ones is up to the kernel's random numbers
probe_camera 0 v4l2:/dev/video0 320x180 control $dropped=40 frames 50 >/dev/null
between "gaps" "$(($(count 'frame +') - $(count 'frame +1 ')))" 5 40
"$BIN/camera_probe" v4l2:/dev/video0 control $dropped=0 >/dev/null

inject() { # control operation...
    probe_camera "$1" v4l2:/dev/video0 320x180 frames 3 control "$2=1" "${@:3}"
}

echo "== a bad buffer"
inject 0 0x00f0f042 frames 4
expect "flagged" "$(count 'flags 1')" 1
echo "== VIDIOC_REQBUFS fails"
inject 0 0x00f0f043 reopen 3
expect "errors" "$(count error)" 1
expect "opened" "$(count 'opened 2 of 3 times')" 1
echo "== VIDIOC_QBUF fails"
probe_camera 0 v4l2:/dev/video0 320x180 $(for _ in 1 2 3 4 5 6; do
    echo control 0x00f0f044=1 frames 3
done) frames 4
expect "frames" "$(($(count ' flags 0 ')))" 22
echo "== VIDIOC_STREAMON fails"
inject 0 0x00f0f045 reopen 3
expect "errors" "$(count error)" 1
expect "opened" "$(count 'opened 2 of 3 times')" 1
echo "== the stream breaks off, and goes on"
inject 0 0x00f0f046 frames 8
expect "frames after it" "$(sed '1,/restarted/d' seen | grep -c 'flags 0')" 6
echo "== disconnected, three times"
for _ in 1 2 3; do
    inject 1 0x00f0f041 frames 8
    expect "lost" "$(tail -n 1 seen | cut -d : -f 1)" "error -7"
    await "camera again" test -e /dev/video0
    probe_camera 0 v4l2:/dev/video0 320x180 frames 2
done
unload vivid
