#!/usr/bin/env bash
# The page of a scene in a browser that draws in software: its pictures are those of hdrig render,
# it loads nothing, its controls work.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/view.bash

# PSNR at least; largest difference, median and 0.99 quantile of relative differences at most.
# Single pixels differ by more: at the rim of a bright splat, alpha is just above 1/255 or below.
same_picture() { # scene view ev psnr codes median most
    local ref=$OUT/$1/ev$3/frame_000$2 psnr codes median most rest
    value "display($2, $3)" | base64 -d >"$OUT/page.png"
    value "numbers()" | base64 -d >"$OUT/page.f32"
    read -r psnr codes rest < <("$BIN/compare" display "$ref.png" "$OUT/page.png")
    at_least "$1, view $2, EV $3: PSNR" "$psnr" "$4"
    at_least "$1, view $2, EV $3: minus largest difference" "-$codes" "-$5"
    read -r median most rest < <("$BIN/compare" radiance "$ref.exr" "$OUT/page.f32")
    at_least "$1, view $2, EV $3: minus median of relative differences" "-$median" "-$6"
    at_least "$1, view $2, EV $3: minus 0.99 quantile" "-$most" "-$7"
    printf '%-10s view %d EV %3d: %5.1f dB, at most %2d; radiance to %.5f, 99 %% to %.5f\n' \
        "$1" "$2" "$3" "$psnr" "$codes" "$median" "$most"
}

# The smaller page against the same pictures. Radiance counts: a sun of 1e5 ends at the rim of a
# splat with a step from white to nothing, and splats move by a third of a pixel. Real scenes keep
# 46 dB and more (tests/measured.md).
small_page() { # scene view ev psnr median most
    open_page "$FILE/$1/small.html"
    same_picture "$1" "$2" "$3" "$4" 255 "$5" "$6"
    quiet "$1, small"
}

scene() { # name kind number ev...
    local name=$1 ev
    "$BIN/make_view" "$OUT/$1" "$2" "$3" || exit 1
    shift 3
    for ev; do
        succeed render --scene "$OUT/$name" --path inputs --size 112 --ev "$ev" --hdr \
            --out "$OUT/$name/ev$ev"
    done
}

FILE=file://$(realpath "$OUT")
open_browser 800 600

# every degree, the lamp, 1e-4 to 1e5: within half precision, which is 2^-11
for degree in 0 1 2 3 4; do
    scene "degree$degree" thin $degree 0
    open_page "$FILE/degree$degree/view.html"
    same_picture "degree$degree" $((degree % 3)) 0 70 8 0.00025 0.0005
    quiet "degree$degree"
    small_page "degree$degree" $((degree % 3)) 0 30 0.01 0.1
done
scene thin thin 1 -12 6
open_page "$FILE/thin/view.html"
for ev in -12 6; do
    for view in 0 1 2; do
        same_picture thin $view $ev 70 8 0.00025 0.0005
    done
done

# opaque: raster.c ends where less than 1e-4 passes, the picture does not, its numbers do
scene walls walls 3000 -6 0
open_page "$FILE/walls/view.html"
for ev in -6 0; do
    same_picture walls 1 $ev 60 16 0.00025 0.0025
done
value "exactly()" | base64 -d >"$OUT/page.f32"
cp "$OUT/page.f32" "$OUT/exact.f32"
small_page walls 1 -6 25 0.01 0.5
small_page walls 1 0 25 0.01 0.5
mv "$OUT/exact.f32" "$OUT/page.f32"
read -r median most worst < <("$BIN/compare" radiance "$OUT/walls/ev0/frame_0001.exr" \
    "$OUT/page.f32")
at_least "walls: minus 0.99 quantile of differences of single pixels" "-$most" -0.0005
at_least "walls: minus largest difference of single pixels" "-$worst" -0.01
printf 'walls, as the pointer reads them: 99 %% to %.5f, all to %.4f\n' "$most" "$worst"

# without the splats that are guesses
scene half half 0 0
open_page "$FILE/half/view.html"
is "viewer.info.guesses" 750
value "display(1, 0)" >"$OUT/all.txt"
value "viewer.hideGuesses(true)" >/dev/null
same_picture half 1 0 70 8 0.00025 0.0005
value "viewer.hideGuesses(false)" >/dev/null
value "display(1, 0)" | cmp -s "$OUT/all.txt" - || fail "guesses do not return"
quiet "guesses"
open_page "$FILE/walls/view.html"
is "document.getElementById('proven').disabled" true

# the other colours
value "viewer.setTone(1)" >/dev/null
value "display(1, -6)" | base64 -d >"$OUT/page.png"
srgb=$(value "viewer.info.srgb_ev - 6")
read -r psnr rest < <("$BIN/compare" srgb "$srgb" "$OUT/walls/ev-6/frame_0001.exr" "$OUT/page.png")
at_least "sRGB: PSNR" "$psnr" 60
value "viewer.setTone(2)" >/dev/null
value "display(1, -6)" | base64 -d >"$OUT/page.png"
log2t=$(value "viewer.info.middle - 6")
read -r psnr rest < \
    <("$BIN/compare" false "$log2t" "$OUT/walls/ev-6/frame_0001.exr" "$OUT/page.png")
at_least "false colours: PSNR" "$psnr" 50
quiet "other colours"

# the extremes
for what in "one 0" "dark 0" "near 0" "shapes 0" "scale 1e-5" "scale 1e5"; do
    read -r kind number <<<"$what"
    scene "$kind$number" "$kind" "$number" 0
    open_page "$FILE/$kind$number/view.html"
    case $kind in
    scale) same_picture "$kind$number" 2 0 60 16 0.00025 0.0025 ;;
    *) same_picture "$kind$number" 2 0 60 4 0.0005 0.0025 ;;
    esac
    quiet "$what"
    [ "$kind" = near ] || small_page "$kind$number" 2 0 25 0.01 0.5
done

# What a page says without a picture; a script that makes it so runs before it, once.
refused() { # page regex script
    local script
    call Page.addScriptToEvaluateOnNewDocument "{\"source\":\"$3\"}"
    script=$(field identifier)
    call Page.navigate "{\"url\":\"$1\"}"
    wait_for "document.getElementById('message').hidden" false
    told "$2"
    is "document.querySelector('footer').hidden" true
    call Page.removeScriptToEvaluateOnNewDocument "{\"identifier\":\"$script\"}"
}
refused "$FILE/one0/view.html" 'does not offer WebGL 2' \
    "HTMLCanvasElement.prototype.getContext = () => null;"
refused "$FILE/one0/view.html" 'driver refuses a program: .*ERROR' \
    "const own = WebGL2RenderingContext.prototype.shaderSource;
    WebGL2RenderingContext.prototype.shaderSource = function (s, text) {
      own.call(this, s, text + '!');
    };"
refused "$FILE/one0/view.html" 'the scene has 1 splats, too many for the memory' \
    "WebGL2RenderingContext.prototype.getError = () => WebGL2RenderingContext.OUT_OF_MEMORY;"
refused "$FILE/one0/view.html" 'cannot sort the splats in a worker: Uncaught .' \
    "const Own = Worker;
    window.Worker = function (url) {
      const worker = new Own(url), post = worker.postMessage;
      worker.postMessage = function (data) {
        if (data.mu) data.at = -1;
        post.call(worker, data);
      };
      return worker;
    };"
head -c -5000 "$OUT/thin/view.html" >"$OUT/cut.html"
refused "$FILE/cut.html" 'cut off: [0-9]+ of [0-9]+ characters of its scene' ""
head -c -5000 "$OUT/thin/small.html" >"$OUT/cut.html"
refused "$FILE/cut.html" 'cut off: [0-9]+ of [0-9]+ characters of its scene' ""
sed '/octet-stream/s/A/B/30' "$OUT/thin/small.html" >"$OUT/cut.html"
refused "$FILE/cut.html" 'the page is damaged: .* in its scene' ""

# half floats alone, as on many telephones, and without a decoder of base64
call Page.addScriptToEvaluateOnNewDocument '{"source":"
    const own = WebGL2RenderingContext.prototype.getExtension;
    window.hidden = window.hidden || /float_blend/;
    delete Uint8Array.prototype.setFromBase64;
    WebGL2RenderingContext.prototype.getExtension = function (name) {
      return window.hidden.test(name) ? null : own.call(this, name);
    };"}'
open_page "$FILE/thin/view.html"
same_picture thin 1 6 55 12 0.001 0.005
quiet "half floats"
call Page.addScriptToEvaluateOnNewDocument '{"source":"window.hidden = /float/;"}'
call Page.navigate "{\"url\":\"$FILE/thin/view.html\"}"
wait_for "document.getElementById('message').hidden" false
told EXT_color_buffer_float
is "document.querySelector('footer').hidden" true
browser_close

# ---- what hands do ----

open_browser 800 600
call Emulation.setEmulatedMedia \
    '{"features":[{"name":"prefers-reduced-motion","value":"reduce"}]}' # nothing moves by itself
open_page "$FILE/walls/view.html"
value "viewer.go(0)" >/dev/null

is "document.querySelector('h1').textContent.replace(/\\\\x22/g, '*')" \
    '</title><b>scene</b> & *view*'
is "document.getElementById('cameras').options[2].text.replace(/\\\\x22/g, '*')" \
    'view <script> *1*.png'
is "viewer.state.at" 0
value "window.from = centreOf(viewer.state.cam), window.axes = viewer.state.cam.R" >/dev/null
drag 400 200 460 230
is "viewer.state.at" -1
# what is before the middle follows the pointer: the camera goes the other way
value "window.way = centreOf(viewer.state.cam).map((v, k) => v - from[k])" >/dev/null
is "dot(way, row(axes, 0)) < 0 && dot(way, row(axes, 1)) < 0" true
value "window.before = viewer.state.cam.R.join(), window.t = viewer.state.cam.t.join()" >/dev/null
drag 400 200 460 230 right 2
is "viewer.state.cam.R.join() === before" true
is "viewer.state.cam.t.join() === t" false
value "window.focus0 = viewer.state.focus" >/dev/null
wheel 400 200 -240
wait_for "viewer.state.focus < 0.9 * focus0" true
value "viewer.settled()" >/dev/null
mouse mouseMoved 300 200 0 "" none
wait_for "/stops|light/.test(document.getElementById('probe').textContent)" true
press .
is "viewer.state.at" 1
press ,
press ,
is "viewer.state.at" 2
press ]
is "viewer.state.ev" 0.5
press 3
is "viewer.state.tone" 2
is "document.getElementById('legend').hidden" false
press 1
is "document.querySelectorAll('#ticks button').length" 3
value "document.querySelectorAll('#ticks button')[0].click()" >/dev/null
is "viewer.state.ev" -3
is "document.getElementById('stops').textContent.slice(1)" "3.0 EV"

# the photograph, at its exposure
is "document.getElementById('photo').hidden" true
value "document.getElementById('compare').click()" >/dev/null
wait_for "document.getElementById('photo').hidden" false
is "viewer.state.ev" -3
wait_for "document.getElementById('photo').naturalWidth" 112
value "window.box = document.getElementById('divider').getBoundingClientRect()" >/dev/null
read -r x y <<<"$(value "[box.left + box.width / 2, box.top + 20].map(Math.round).join(' ')")"
drag "$x" "$y" $((x - 60)) "$y"
is "viewer.state.split < 45" true
is "viewer.state.at" 2
# of all that were taken from there the one that is nearest to the exposure, which its mark tells
value "window.lit = () => Array.from(document.querySelectorAll('#ticks [aria-pressed=true]'))
    .map((t) => t.dataset.stops).join(), window.which = () => viewer.info.views[viewer.state.at]
    .photos.findIndex((p) => p.src === document.getElementById('photo').src)" >/dev/null
is "viewer.info.views.map((v) => v.photos.length).join()" 1,1,3
for want in "3 3 0" "1.6 3 0" "1.4 0 2" "0 0 2" "-3 -3 1" "-9 -3 1"; do
    read -r ev stops which <<<"$want"
    value "viewer.setExposure($ev)" >/dev/null
    wait_for "which()" "$which"
    is "lit()" "$stops"
    is "viewer.state.ev" "$ev"
done
value "viewer.setExposure(0.4), viewer.go(1), viewer.go(2)" >/dev/null
is "viewer.state.ev + lit() + viewer.info.views[1].photos[0].stops" 000
value "viewer.go(0)" >/dev/null # it was photographed once
is "viewer.state.ev + lit()" -3-3
value "viewer.go(2), viewer.setExposure(3)" >/dev/null
drag 400 200 430 200
wait_for "document.getElementById('photo').hidden" true
quiet "by hand"

# a graphics driver that starts again
value "display(0, 0)" >"$OUT/before.txt"
value "window.lose = gl.getExtension('WEBGL_lose_context'), lose.loseContext()" >/dev/null
wait_for "gl.isContextLost()" true
wait_for "document.getElementById('message').hidden" false
told 'the graphics driver stopped'
value "lose.restoreContext()" >/dev/null
wait_for "gl.isContextLost()" false
value "display(0, 0)" >"$OUT/after.txt"
cmp -s "$OUT/before.txt" "$OUT/after.txt" || fail "another picture after the driver's restart"
quiet "a driver that starts again"

# whoever gets a script into the page still reaches nobody
is "fetch('data:,x').then(() => 'allowed', () => 'refused')" refused

# a telephone
call Emulation.setDeviceMetricsOverride \
    '{"width":360,"height":740,"deviceScaleFactor":2,"mobile":true}'
call Emulation.setTouchEmulationEnabled '{"enabled":true,"maxTouchPoints":5}'
open_page "$FILE/walls/view.html"
is "document.documentElement.scrollWidth <= innerWidth" true
is "document.getElementById('view').clientHeight > 0.6 * innerHeight" true
is "Array.from(document.querySelectorAll('footer .row button, header button')).every((b) =>
    b.clientHeight >= 36)" true
touch touchStart '{"x":180,"y":300,"id":1}'
touch touchMove '{"x":220,"y":300,"id":1}'
touch touchEnd ''
wait_for "viewer.state.at" -1
value "window.focus0 = viewer.state.focus" >/dev/null
touch touchStart '{"x":150,"y":300,"id":1},{"x":210,"y":300,"id":2}'
touch touchMove '{"x":100,"y":300,"id":1},{"x":260,"y":300,"id":2}'
touch touchEnd ''
wait_for "viewer.state.focus < 0.6 * focus0" true
value "viewer.settled()" >/dev/null
screenshot "$OUT/telephone.png"
call Emulation.setDeviceMetricsOverride \
    '{"width":740,"height":360,"deviceScaleFactor":2,"mobile":true}'
wait_for "document.getElementById('view').clientHeight > 0.6 * innerHeight" true
is "document.documentElement.scrollWidth <= innerWidth" true
is "document.getElementById('ev').clientWidth > 200" true
screenshot "$OUT/across.png"
quiet "telephone"
browser_close

# ---- hdrig view ----

mkdir "$OUT/bin" "$OUT/empty"
printf '#!/bin/sh\necho "$1" >"%s/opened"\n' "$(realpath "$OUT")" >"$OUT/bin/xdg-open"
chmod +x "$OUT/bin/xdg-open"
unset DISPLAY WAYLAND_DISPLAY BROWSER
expect 1 "no desktop here.; open this file in one: $(realpath "$OUT")/one0/view.html" \
    view "$OUT/one0"
mkdir "$OUT/none"
ln -s "$(command -v grep)" "$(command -v tail)" "$OUT/none"
DISPLAY=:99 PATH=$OUT/none expect 1 'xdg-open is not installed: apt-get install xdg-utils' \
    view "$OUT/one0"
expect 1 'empty has no view.html: make one with hdrig convert-scene' view "$OUT/empty"
expect 1 'nowhere.ply: no such file or folder' view "$OUT/nowhere.ply"
expect 2 'folder of a result or the file of a scene is needed' view
expect 2 'serve needs the folder' view "$OUT/one0/view.html" --serve
DISPLAY=:99 PATH=$(realpath "$OUT/bin"):$PATH succeed view "$OUT/one0"
[ "$(cat "$OUT/opened")" = "$(realpath "$OUT")/one0/view.html" ] || fail "the wrong file was opened"
"$HDRIG" view "$OUT/one0" --serve >"$OUT/serve.txt" 2>"$ERR" &
server=$!
open_browser 800 600
for _ in $(seq 300); do
    [ -s "$OUT/serve.txt" ] && break
    sleep 0.1
done
open_page "$(cat "$OUT/serve.txt")"
is "errors.join()" ""
same_picture one0 2 0 60 4 0.0005 0.0025
kill -INT $server
wait $server || fail "hdrig view --serve ends with $?"

# a scene's file: its page is there as long as the command
mkdir "$OUT/tmp"
export TMPDIR=$OUT/tmp
gone() { # what was shown
    [ -z "$(ls "$OUT/tmp")" ] || fail "$1 leaves $(ls "$OUT/tmp")"
}
started() { # file that the command writes into
    for _ in $(seq 300); do
        [ -s "$1" ] && return
        sleep 0.1
    done
    fail "nothing in $1: $(cat "$ERR")"
}
for kind in ply spz glb hdrig; do
    succeed convert-scene "$OUT/walls" --out "$OUT/other.$kind"
    rm -f "$OUT/opened" "$OUT/view.txt"
    DISPLAY=:99 PATH=$(realpath "$OUT/bin"):$PATH "$HDRIG" view "$OUT/other.$kind" \
        >"$OUT/view.txt" 2>"$ERR" &
    server=$!
    started "$OUT/opened"
    started "$OUT/view.txt"
    [ "$(cat "$OUT/opened")" = "$(cat "$OUT/view.txt")" ] || fail "the wrong page of .$kind"
    grep -q "<title>other.$kind</title>" "$(cat "$OUT/opened")" || fail "no page of .$kind"
    grep -q '"n":3008,' "$(cat "$OUT/opened")" || fail "the page of .$kind has other splats"
    [ "$kind" = ply ] && kill -HUP $server || kill -INT $server
    wait $server || fail "hdrig view FILE ends with $?"
    gone "$kind"
done
rm -f "$OUT/view.txt"
"$HDRIG" view "$OUT/other.hdrig" --serve >"$OUT/view.txt" 2>"$ERR" &
server=$!
started "$OUT/view.txt"
open_page "$(cat "$OUT/view.txt")"
is "viewer.info.n + document.title" 3008other.hdrig
is "errors.join()" ""
kill -INT $server
wait $server || fail "hdrig view FILE --serve ends with $?"
gone "--serve"
expect 1 'no desktop here.: use --serve, or make a page with hdrig convert-scene' \
    view "$OUT/other.spz"
gone "no desktop"
head -c 2000 "$OUT/other.ply" >"$OUT/cut.ply"
head -c 2000 "$OUT/other.spz" >"$OUT/cut.spz"
echo nonsense >"$OUT/cut.glb"
mkfifo "$OUT/pipe.ply"
for what in cut.ply cut.spz cut.glb pipe.ply bin/xdg-open; do
    expect 1 "^hdrig view: .*$what" view "$OUT/$what"
    gone "$what"
done
(ulimit -f 100 && "$HDRIG" view "$OUT/other.ply" 2>"$ERR") && fail "a page of 150 kB in 100"
grep -q 'view.html.*File too large' "$ERR" || fail "no space: $(cat "$ERR")"
gone "space"
TMPDIR=$OUT/none/nowhere expect 1 'a folder in .*none/nowhere: No such file' view "$OUT/other.ply"
unset TMPDIR

# ---- speed ----

"$BIN/make_view" "$OUT/many" walls 200000 || exit 1
expect 3 'this job needs .* MB' view "$OUT/many/scene.hdrig" --max-memory 64
open_page "$FILE/many/small.html"
first=$(value "viewer.firstPicture()")
value "redrawn()" >/dev/null
printf '200,000 splats: first picture after %.2f s, whole frame of %s px in %.2f s\n' \
    "$(awk "BEGIN { print $first / 1000 }")" \
    "$(value "['width', 'height'].map((k) => document.getElementById('view')[k]).join(' x ')")" \
    "$(awk "BEGIN { print $(value "redrawn()") / 1000 }")"
quiet "200,000 splats"
rm -rf "$OUT/many"

# its most important splats are seen first, then all of them, which is the picture of hdrig render
scene million walls 1000000 0
call Emulation.setDeviceMetricsOverride \
    '{"width":360,"height":400,"deviceScaleFactor":1,"mobile":false}'
open_page "$FILE/million/small.html"
printf '1,000,000 splats: a page of %d MB, first picture after %.1f s\n' \
    "$(($(stat -c %s "$OUT/million/small.html") / 1000000))" \
    "$(awk "BEGIN { print $(value "viewer.firstPicture()") / 1000 }")"
is "info.packed.first < 140000 && info.packed.bytes[0] < info.packed.bytes[1] / 5" true
wait_for "sorting.seen" 1000000
same_picture million 1 0 40 255 0.01 0.5
quiet "1,000,000 splats"
head -c -5000 "$OUT/million/small.html" >"$OUT/cut.html"
refused "$FILE/cut.html" 'cut off: [0-9]+ of [0-9]+ characters of its scene' ""
is "sorting.seen > 0 && sorting.seen < 140000" true
rm -rf "$OUT/million" "$OUT/cut.html"
browser_close
finish
