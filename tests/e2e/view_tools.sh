#!/usr/bin/env bash
# The page of a scene in a browser: where it begins and what it hides, how far the camera goes, what
# moves by itself, and what leaves the page as a file or a link.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/view.bash

# More for the pages: colours of what is on the screen.
read -r -d '' MORE <<'END'
function colours(x, y, w, h) {
  const c = document.getElementById('view'), px = new Uint8Array(4 * w * h);
  viewer.draw();
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(x, c.height - y - h, w, h, gl.RGBA, gl.UNSIGNED_BYTE, px);
  const all = new Set();
  for (let i = 0; i < px.length; i += 4) all.add(Array.from(px.slice(i, i + 3)).join());
  return Array.from(all).sort().join(' ');
}
function at(point) {
  const c = viewer.state.cam, p = [0, 1, 2].map((k) => dot(row(c.R, k), point) + c.t[k]);
  return [c.fx * p[0] / p[2] + c.cx, c.fy * p[1] / p[2] + c.cy];
}
function where() { return [...viewer.state.cam.R, ...viewer.state.cam.t].join(); }
function near(a, b, by) { return Math.abs(a - b) < by; }
END
HATCH='20,21,23 36,38,41'

hold() { # key
    call Input.dispatchKeyEvent "{\"type\":\"keyDown\",\"key\":\"$1\"}"
}

release() { # key
    call Input.dispatchKeyEvent "{\"type\":\"keyUp\",\"key\":\"$1\"}"
}

evaluate() { # expression, whose value does not matter
    value "$1" >/dev/null
}

click_on() { # id of a button, by a hand
    local x y
    read -r x y <<<"$(value "(() => { const b = document.getElementById('$1')
        .getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2].join(' '); })()")"
    mouse mousePressed "$x" "$y" 1 ',"clickCount":1'
    mouse mouseReleased "$x" "$y" 0 ',"clickCount":1'
}

saved() { # ending: the only file of this kind, once it is whole
    for _ in $(seq 300); do
        file=$(find "$OUT/saved" -name "*.$1")
        [ -s "$file" ] && return
        sleep 0.1
    done
    fail "no .$1 was saved: $(ls "$OUT/saved")"
}

for what in "walls 3000" "half 0" "one 0" "aside 0"; do
    read -r kind number <<<"$what"
    "$BIN/make_view" "$OUT/$kind" "$kind" "$number" || exit 1
done
mkdir "$OUT/saved"
FILE=file://$(realpath "$OUT")
HELP+=$MORE
open_browser 800 600
call Page.setDownloadBehavior \
    "{\"behavior\":\"allow\",\"downloadPath\":\"$(realpath "$OUT")/saved\"}"

# ---- the first view, and what nobody saw ----

open_page "$FILE/one/view.html"
evaluate "viewer.go(0)"
evaluate "viewer.settled()"
evaluate "window.c = document.getElementById('view'),
    window.f = fit(viewer.state.cam, c.width, c.height)"
is "c.width > c.height + 200 && f.left > 100" true
evaluate "window.shone = numbers()"
for tone in 0 1 2; do
    for ev in -8 0 8; do
        evaluate "viewer.setTone($tone), viewer.setExposure($ev)"
        is "colours(0, 0, Math.floor(f.left), c.height)" "$HATCH"
        is "colours(Math.ceil(f.left), 0, 40, 40)" "$HATCH" # of the photograph, but no splat
        is "colours(c.width / 2 - 4, c.height / 2 - 4, 8, 8).includes('20,21,23')" false
    done
done
evaluate "viewer.setTone(0), viewer.setExposure(0)"
press u
is "document.getElementById('unseen').ariaPressed" true
is "colours(0, 0, 40, 40).includes('20,21,23')" false
is "numbers() === shone" true
click_on unseen
is "colours(0, 0, 40, 40)" "$HATCH"
open_page "$FILE/aside/view.html" # all but the last camera look past the splats
is "viewer.state.at" 2
is "colours(0, 0, 40, 40)" "$HATCH" # of other cameras' splats, outside the photograph
evaluate "orbit(0.3, 0)"
is "viewer.state.outside" 1
is "colours(0, 0, 40, 40) === '$HATCH'" false

# ---- how far the camera goes ----

open_page "$FILE/walls/view.html"
evaluate "viewer.go(1), window.before = where()"
evaluate "zoom(1.05)"
is "where() === before" false
is "document.getElementById('hint').textContent" ""
is "document.getElementById('hint').getAttribute('role')" status
for move in "orbit(0.2, 0)" "orbit(0, 0.1)" "pan(90, 0)" "pan(0, -90)" "zoom(1.3)" "zoom(0.8)" \
    "shift([0, 0, 0.3])"; do
    evaluate "viewer.go(1), window.most = 0"
    evaluate "Array.from({ length: 200 }).forEach(() => {
        $move; most = Math.max(most, distance()); })"
    is "most < 2" true
done
is "most > 1.9" true # the last one ran into it
is "document.getElementById('hint').textContent" "beyond the photographs"
evaluate "window.stuck = distance(), shift([0, 0, -0.3])"
is "distance() < stuck - 0.05" true # the way back is free
click_on reset
is "viewer.state.at" 1
is "document.getElementById('hint').textContent" ""
evaluate "window.here = centreOf(viewer.state.cam),
    viewer.state.cam.R = turned(viewer.state.cam.R, [0, 1, 0], 1.2)"
evaluate "place(viewer.state.cam, here), moved()"
is "near(distance(), 0, 1e-6)" true
is "document.getElementById('hint').textContent" "beyond the photographs"
press 0
is "viewer.state.at" 1

# the box: at the ends of its sliders there is none
click_on crop
is "document.getElementById('argument').textContent" "--crop -1e9,-1e9,-1e9,1e9,1e9,1e9"
evaluate "window.sides = Array.from(document.querySelectorAll('#sides input')), window.shown =
    () => listed()[0].filter((v, i) => i % 4 === 2 && v >= 0 && i < 4 * sorting.seen).length"
evaluate "viewer.settled()"
evaluate "window.all = shown(), sides[4].value = 4, sides[4].dispatchEvent(new Event('input'))"
evaluate "viewer.settled()"
is "viewer.state.box.filter((v) => Math.abs(v) < 1e9).length" 1
is "sample.some((m) => m[2] < 3.9) && shown() < all" true
crop=$(value "document.getElementById('argument').textContent")
evaluate "sides[5].value = 2, sides[5].dispatchEvent(new Event('input'))" # before the other one
is "viewer.state.box[2] < viewer.state.box[5]" true
is "sides.every((s) => s.ariaLabel)" true
press x
is "document.getElementById('box').hidden" true
evaluate "viewer.settled()"
is "shown()" "$(value all)"
# what the page shows is what the file gets
succeed convert-scene "$OUT/walls" --out "$OUT/cropped.hdrig" $crop --json "$OUT/cropped.json"
is "sample.filter((m) => m[2] >= +'${crop#* }'.split(',')[2]).length" \
    "$(sed -n 's/.*"gaussians": \([0-9]*\).*/\1/p' "$OUT/cropped.json")"
quiet "limits and box"

# guesses fade
open_page "$FILE/half/view.html"
evaluate "viewer.go(1)"
is "viewer.state.guesses" 1
evaluate "orbit(0.5, 0)"
is "viewer.state.guesses > 0.1 && viewer.state.guesses < 0.9" true
evaluate "viewer.settled()"
evaluate "viewer.draw(), window.some = numbers(), viewer.hideGuesses(true)"
evaluate "viewer.settled()"
evaluate "viewer.draw(), window.none = numbers(), viewer.hideGuesses(false)"
is "some === none" false
evaluate "orbit(0.8, 0)"
is "viewer.state.guesses" 0
evaluate "viewer.settled()"
evaluate "viewer.draw(), window.some = numbers(), viewer.hideGuesses(true)"
evaluate "viewer.settled()"
is "viewer.draw() || numbers() === some" true
quiet "guesses"

# without cameras there is nothing to keep near to
mkdir "$OUT/bare"
succeed convert-scene "$OUT/walls" --out "$OUT/bare/walls.ply"
rm "$OUT/bare/walls.json"
succeed convert-scene "$OUT/bare/walls.ply" --out "$OUT/bare/view.html"
open_page "$FILE/bare/view.html"
is "viewer.info.views.length" 0
evaluate "zoom(50), orbit(2, 0), shift([0, 0, -5])"
is "[viewer.state.outside, viewer.state.guesses, document.getElementById('hint').textContent,
    document.getElementById('play').hidden].join()" 1,1,,true
evaluate "window.hash = linkOf(), window.before = where(), viewer.go(0)"
evaluate "location.hash = hash"
wait_for "before.split(',').every((v, k) => Math.abs(v - where().split(',')[k]) < 1e-3)" true
quiet "without cameras"

# ---- what moves ----

open_page "$FILE/walls/view.html"
evaluate "viewer.go(1), window.start = centreOf(viewer.state.cam), window.axes = viewer.state.cam.R"
for key in "w 2 1" "s 2 -1" "a 0 -1" "d 0 1" "q 1 1" "e 1 -1" "W 2 1"; do
    read -r letter axis sign <<<"$key"
    evaluate "viewer.go(1)"
    hold "$letter"
    sleep 0.3
    evaluate "window.way = centreOf(viewer.state.cam).map((v, k) => v - start[k]),
        window.along = $sign * dot(way, row(axes, $axis))"
    is "along > 0.01 && near(Math.hypot(...way), along, 1e-5)" true
    release "$letter"
    evaluate "viewer.settled()"
    evaluate "window.before = where()"
    sleep 0.2
    is "where() === before" true
done

# a thrown picture goes on in its direction, and comes to rest
throw() {
    local k now
    now=$(date +%s)
    evaluate "viewer.go(1)"
    mouse mousePressed 400 200 1 ",\"clickCount\":1,\"timestamp\":$now.00"
    for k in 1 2 3 4; do
        mouse mouseMoved $((400 + 15 * k)) 200 1 ",\"timestamp\":$now.0$((2 * k))"
    done
    mouse mouseReleased 460 200 0 ",\"clickCount\":1,\"timestamp\":$now.09"
}
call Emulation.setEmulatedMedia \
    '{"features":[{"name":"prefers-reduced-motion","value":"reduce"}]}'
throw
evaluate "window.before = where(), window.still = centreOf(viewer.state.cam)"
evaluate "viewer.settled()"
is "where() === before" true
call Emulation.setEmulatedMedia '{"features":[]}'
throw
evaluate "viewer.settled()"
is "dot(centreOf(viewer.state.cam).map((v, k) => v - still[k]), row(axes, 0)) < -0.01" true

click_twice() { # x y
    local k now
    now=$(date +%s)
    for k in 1 3; do
        mouse mousePressed "$1" "$2" 1 ",\"clickCount\":1,\"timestamp\":$now.${k}0"
        mouse mouseReleased "$1" "$2" 0 ",\"clickCount\":1,\"timestamp\":$now.${k}5"
    done
}

# a double click turns to what is there
open_page "$FILE/one/view.html"
evaluate "viewer.go(0)"
evaluate "viewer.settled()"
evaluate "window.c = document.getElementById('view').getBoundingClientRect(),
    window.f = fit(viewer.state.cam, c.width, c.height), window.mid = at(sample[0]),
    window.z = dot(row(viewer.state.cam.R, 2), sample[0]) + viewer.state.cam.t[2],
    window.p = [f.left + f.s * mid[0] + c.x, f.top + f.s * mid[1] + c.y].map(Math.round)"
is "near(viewer.depthAt(p[0] - c.x, p[1] - c.y), z, 1e-4 * z)" true
is "viewer.depthAt(3, 3)" 0
click_twice $(value "p.join(' ')")
evaluate "viewer.settled()"
is "near(at(sample[0])[0], viewer.state.cam.cx, 0.5) &&
    near(at(sample[0])[1], viewer.state.cam.cy, 0.5)" true
is "near(viewer.state.focus,
    Math.hypot(...sample[0].map((v, k) => v - centreOf(viewer.state.cam)[k])), 0.02)" true
evaluate "zoom(0.7), viewer.state.focus *= 3"
press Enter
evaluate "viewer.settled()"
is "near(viewer.state.focus,
    Math.hypot(...sample[0].map((v, k) => v - centreOf(viewer.state.cam)[k])), 0.02)" true
click_twice 20 300
is "document.getElementById('hint').textContent" "nothing is there"
quiet "focus"

# through the cameras, until somebody wants something else
open_page "$FILE/walls/view.html"
evaluate "viewer.go(0), window.visited = [],
    window.go = ((own) => (i) => visited.push(i) && own(i))(go)"
press " "
is "document.getElementById('play').ariaPressed" true
wait_for "visited.slice(0, 3).join()" 1,2,0
wait_for "viewer.state.at" -1
press ArrowLeft
is "document.getElementById('play').ariaPressed" false
evaluate "window.before = where()"
sleep 0.5
is "where() === before" true
click_on play
is "document.getElementById('play').ariaPressed" true
click_on play
is "document.getElementById('play').ariaPressed" false
press 0

# ---- what leaves the page ----

press f
wait_for "document.fullscreenElement === document.documentElement" true
wait_for "document.getElementById('full').ariaPressed" true
click_on full
wait_for "document.fullscreenElement" null

evaluate "viewer.go(1), orbit(0.2, 0.1), viewer.setExposure(-1.5), viewer.setTone(1)"
press p
saved png
evaluate "viewer.settled()"
value "viewer.draw() || document.getElementById('view').toDataURL().split(',')[1]" |
    base64 -d >"$OUT/page.png"
[ "$("$BIN/compare" display "$OUT/page.png" "$file" | cut -d ' ' -f 2)" = 0 ] ||
    fail "$file is not the picture"

press v
wait_for "document.getElementById('hint').textContent !== ''" true
is "/^copied|^the address is/.test(document.getElementById('hint').textContent)" true
hash=$(value "location.hash")
was=$(value "where()")
focus=$(value "viewer.state.focus")
call Page.navigate '{"url":"about:blank"}'
open_page "$FILE/walls/view.html$hash"
is "'$was'.split(',').every((v, k) => near(v, where().split(',')[k], 1e-5))" true
is "near(viewer.state.focus, $focus, 1e-5)" true
is "[viewer.state.ev, viewer.state.tone, viewer.state.at].join()" -1.5,1,-1
evaluate "location.hash = 'view=2&ev=1&tone=0'"
wait_for "[viewer.state.ev, viewer.state.tone, viewer.state.at].join()" 1,0,2
for bad in 'view=3&ev=0&tone=0' 'view=-1&ev=0&tone=0' 'view=&ev=0&tone=0' 'view=1&ev=x&tone=0' \
    'view=1&ev=99&tone=0' 'view=1&ev=0&tone=9' 'view=1&ev=0' 'view=1&ev=0&tone=0&pose=' \
    'view=1&ev=0&tone=0&pose=0,0,0,0,0,0,0,0,0,1' 'view=1&ev=0&tone=0&pose=1,2,3' \
    'view=1&ev=0&tone=0&pose=0,0,0,0,0,1,0,0,1,1' '%' '<img>' 'view[]=1' \
    'view=1&ev=0&tone=0&pose=0,0,1e99,0,0,1,1,0,0,1'; do
    evaluate "location.hash = '$bad'"
    evaluate "new Promise((done) => setTimeout(done, 20))"
    is "[viewer.state.ev, viewer.state.tone, viewer.state.at].join()" 1,0,2
done
call Page.navigate '{"url":"about:blank"}'
open_page "$FILE/walls/view.html#view=1&ev=&tone=0"
is "[viewer.state.ev, viewer.state.at === viewer.info.first].join()" 0,true
quiet "links"

evaluate "viewer.go(0)"
click_on record
is "document.getElementById('record').ariaPressed" true
wait_for "document.getElementById('record').ariaPressed" false
saved webm
[ "$(head -c 4 "$file" | od -An -tx1 | tr -d ' ')" = 1a45dfa3 ] || fail "$file is no film"
frames=$(ffprobe -v error -count_frames -show_entries stream=nb_read_frames -of csv=p=0 "$file")
at_least "pictures of the film" "$frames" 10
quiet "film"

# Its pictures, 30 a second, until the next key: a whole round of three views has 196.
evaluate "viewer.go(0)"
hold o
release o
wait_for "document.getElementById('pictures').ariaPressed" true
is "['play', 'record'].map((id) => document.getElementById(id).ariaPressed).join()" false,false
sleep 3
hold o
release o
wait_for "document.getElementById('pictures').ariaPressed" false
saved zip
n=$("$BIN/list_zip" "$file" "$OUT/last.png") || fail "$file is damaged"
at_least "pictures in the archive" "$n" 2
at_least "pictures that are not there" $((195 - n)) 0
size=$(ffprobe -v error -show_entries stream=width,height -of csv=p=0 "$OUT/last.png")
is "[canvas.width, canvas.height].join()" "$size"
is "[tour.on, !!tour.recorder, !!tour.pictures, motion.ticking].join()" false,false,false,false
quiet "pictures of the film"

# ---- who has no mouse ----

is "Array.from(document.querySelectorAll('#tools button')).every((b) =>
    b.ariaLabel && b.tabIndex === 0 && !b.disabled)" true
evaluate "window.told = Array.from(document.querySelectorAll('#guide td:last-child'))
    .map((cell) => cell.textContent.toLowerCase()).join(' ').split(/[ :]+/)"
is "Object.keys(keys).map((k) => k.replace(/^ $/, 'space').replace(/^Arrow.*/, 'arrows')
    .replace('=', '+').toLowerCase()).filter((k) => !told.includes(k)).join()" "?"
for size in "360 740" "740 360"; do
    read -r width height <<<"$size"
    call Emulation.setDeviceMetricsOverride \
        "{\"width\":$width,\"height\":$height,\"deviceScaleFactor\":2,\"mobile\":true}"
    evaluate "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    evaluate "window.boxes = Array.from(document.querySelectorAll('#tools button')).filter((b) =>
        !b.hidden).map((b) => b.getBoundingClientRect()), window.box = document
        .getElementById('stage').getBoundingClientRect()"
    is "boxes.every((b) => b.height >= 36 && b.width >= 36 && b.left >= box.left &&
        b.right <= box.right && b.top >= box.top && b.bottom <= box.bottom)" true
    is "boxes.every((b, i) => boxes.every((c, k) => i === k || b.right <= c.left ||
        c.right <= b.left || b.bottom <= c.top || c.bottom <= b.top))" true
    screenshot "$OUT/$width.png"
done

# by a finger: the film as pictures begins, and ends
tap() { # id
    local x y
    read -r x y <<<"$(value "middleOf('$1')")"
    touch touchStart "{\"x\":$x,\"y\":$y}"
    touch touchEnd ''
}
rm "$OUT"/saved/*.zip
call Emulation.setTouchEmulationEnabled '{"enabled":true}'
tap pictures
wait_for "document.getElementById('pictures').ariaPressed" true
wait_for "motion.ticking" true
tap pictures
wait_for "document.getElementById('pictures').ariaPressed" false
saved zip
"$BIN/list_zip" "$file" "$OUT/last.png" >/dev/null || fail "$file is damaged"
quiet "pictures by a finger"
browser_close
finish
