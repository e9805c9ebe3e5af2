#!/bin/sh
# Quoted includes start at the root and point the allowed way; third-party headers only in their
# wrapper.
find core drivers firmware sim tests -name '*.[ch]' 2>/dev/null | sort | xargs awk '
BEGIN {
    allowed["core"] = " core "
    allowed["drivers"] = " core drivers "
    allowed["firmware"] = " core drivers firmware "
    # what makes a world, or offers one as a camera
    simulates = "^firmware/(cmd_simulate|backends)\\.c$"
    allowed["sim"] = " core drivers sim "
    allowed["tests"] = " core drivers firmware sim tests "
    # header pattern -> files that may include it; tests may include what they like
    wrapper["^(spng|turbojpeg|jpeglib)\\.h$"] = "^drivers/img\\.c$"
    wrapper["^libexif/"] = "^drivers/img\\.c$"
    wrapper["^(OpenEXR/)?openexr"] = "^drivers/exrfile\\.c$"
    wrapper["^(cjson/)?cJSON\\.h$"] = "^drivers/json\\.c$"
    wrapper["^libcamera/"] = "^drivers/libcamera_shim\\.cpp$"
    wrapper["^gpiod\\.h$"] = "^drivers/trigger_gpiod[12]\\.c$"
    wrapper["^linux/gpio\\.h$"] = "^drivers/gpio\\.c$"
    wrapper["^linux/input\\.h$"] = "^drivers/trigger_evdev\\.c$"
    wrapper["^(zlib|zstd)\\.h$"] = "^drivers/packed\\.c$"
    wrapper["^zip\\.h$"] = "^drivers/checkpoint\\.c$"
    wrapper["^microhttpd\\.h$"] = "^firmware/http\\.c$"
    wrapper["^systemd/"] = "^firmware/daemon\\.c$"
    wrapper["^ini\\.h$"] = "^firmware/config\\.c$"
    wrapper["^linux/(videodev2|v4l2-|media)"] = "^drivers/(camera_v4l2|v4l2_[a-z]+)\\.c$"
    wrapper["^cmocka\\.h$"] = "^$"
}
FNR == 1 {
    own = layer = FILENAME
    sub(/\.c$/, ".h", own)
    sub(/\/.*/, "", layer)
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
END { exit bad }'
