#!/bin/sh
# Quoted includes start at the root and point in the allowed direction; third-party headers are only
# in their wrapper. Modules (the files NAME and NAME_inner) do not include each other in a circle.
bad=0
find core drivers firmware sim tests -name '*.[ch]' 2>/dev/null | sort | xargs awk '
BEGIN {
    allowed["core"] = " core "
    allowed["drivers"] = " core drivers "
    allowed["firmware"] = " core drivers firmware "
    # folders of core: a folder includes itself and those of a lower rank
    n = split("base=0 photo=1 kernels=2 sfm=3 stereo=3 splat=3 net=3 refine=4", pairs, " ")
    for (i = 1; i <= n; i++) {
        split(pairs[i], pair, "=")
        rank[pair[1]] = pair[2]
    }
    # what makes a world, or offers one as a camera
    simulates = "^firmware/(cmd/cmd_simulate|base/backends)\\.c$"
    allowed["sim"] = " core drivers sim "
    allowed["tests"] = " core drivers firmware sim tests "
    # header pattern -> files that may include it; tests may include what they like
    wrapper["^(spng|turbojpeg|jpeglib)\\.h$"] = "^drivers/format/img\\.c$"
    wrapper["^libraw/"] = "^drivers/format/rawphoto\\.c$"
    wrapper["^tiffio\\.h$"] = "^drivers/format/tiff\\.c$"
    wrapper["^apriltag/"] = "^drivers/format/apriltags\\.c$"
    wrapper["^libheif/"] = "^drivers/format/heic\\.c$"
    wrapper["^webp/"] = "^drivers/format/webp\\.c$"
    wrapper["^libexif/"] = "^drivers/format/img\\.c$"
    wrapper["^(OpenEXR/)?openexr"] = "^drivers/format/exrfile\\.c$"
    wrapper["^(cjson/)?cJSON\\.h$"] = "^drivers/format/json\\.c$"
    wrapper["^libcamera/"] = "^drivers/device/libcamera_shim\\.cpp$"
    wrapper["^gpiod\\.h$"] = "^drivers/device/trigger_gpiod[12]\\.c$"
    wrapper["^linux/gpio\\.h$"] = "^drivers/device/gpio\\.c$"
    wrapper["^linux/input\\.h$"] = "^drivers/device/trigger_evdev\\.c$"
    wrapper["^(zlib|zstd)\\.h$"] = "^drivers/format/compressed\\.c$"
    wrapper["^zip\\.h$"] = "^drivers/format/zipfile\\.c$"
    wrapper["^microhttpd\\.h$"] = "^firmware/daemon/http\\.c$"
    wrapper["^(mosquitto|mqtt_protocol)\\.h$"] = "^drivers/net/mqtt\\.c$"
    wrapper["^qrencode\\.h$"] = "^drivers/format/qr\\.c$"
    wrapper["^mpi\\.h$"] = "^drivers/net/mpi_shim\\.c$"
    wrapper["^curl/"] = "^drivers/net/fetch\\.c$"
    wrapper["^systemd/"] = "^firmware/daemon/daemon\\.c$"
    wrapper["^ini\\.h$"] = "^firmware/base/config\\.c$"
    wrapper["^linux/(videodev2|v4l2-|media)"] = "^drivers/device/(camera_v4l2|v4l2_[a-z]+)\\.c$"
    wrapper["^cmocka\\.h$"] = "^$"
}
FNR == 1 {
    own = layer = FILENAME
    sub(/\.c$/, ".h", own)
    sub(/\/.*/, "", layer)
    split(FILENAME, part, "/")
    room = part[2]
    if (layer == "core" && !(room in rank))
        complain("no folder of core with a rank")
    first = 1
}
!/^[ \t]*#[ \t]*include/ { next }
{
    header = $0
    sub(/^[^<"]*[<"]/, "", header)
    sub(/[>"].*/, "", header)
}
/"/ {
    to = header
    sub(/\/.*/, "", to)
    if (index(allowed[layer], " " to " ") == 0 && !(to == "sim" && FILENAME ~ simulates))
        complain(layer " may not include \"" header "\"")
    else if ((getline line < header) < 0)
        complain("no file \"" header "\" under the root")
    else
        close(header)
    split(header, part, "/")
    if (layer == "core" && part[2] != room && rank[part[2]] >= rank[room])
        complain(layer "/" room " may not include \"" header "\"")
    if (first && FILENAME ~ /\.c$/ && layer != "tests" && header != own && has(own))
        complain("its own header \"" own "\" comes first")
}
/</ && layer != "tests" {
    for (pattern in wrapper)
        if (header ~ pattern && FILENAME !~ wrapper[pattern])
            complain("<" header "> belongs to " wrapper[pattern])
}
{ first = 0 }
function has(file, line, n) { n = getline line < file; close(file); return n >= 0 }
function complain(what) { print FILENAME ":" FNR ": " what; bad = 1 }
END { exit bad }' || bad=1
circle=$(find core drivers firmware sim -name '*.[ch]' -o -name '*.cpp' | xargs awk '
/^[ \t]*#[ \t]*include[ \t]*"/ {
    split($0, part, "\"")
    from = FILENAME
    to = part[2]
    sub(/(_inner)?\.[a-z]+$/, "", from)
    sub(/(_inner)?\.[a-z]+$/, "", to)
    print from, to
}' | tsort 2>&1 >/dev/null | sed -n 's|^tsort: \([^-].*/\)|\1|p')
if [ -n "$circle" ]; then
    echo "a circle of includes:" $circle
    bad=1
fi
exit $bad
