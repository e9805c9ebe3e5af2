#!/usr/bin/env bash
# What the page of a scene measures: histogram, readouts, regions, differences, false colours, EXR;
# for eyes, screen readers and thumbs.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/view.bash
. tests/e2e/axe.bash

begin_page() { # address: at the first camera, with what is outside the photographs
    open_page "$1"
    value "viewer.showUnseen(true), viewer.go(0), viewer.settled()" >/dev/null
}
"$BIN/make_view" "$OUT/walls" walls 3000 || exit 1
"$BIN/make_view" "$OUT/thin" thin 1 || exit 1
"$BIN/make_view" "$OUT/pair" pair 0 || exit 1
FILE=file://$(realpath "$OUT")

read -r -d '' MORE <<'END'
const notes = () => document.getElementById('notes').value.trim().split('\n');
const near = (a, b, most) => Math.abs(a - b) <= most;
/* A picture as large as a photograph. */
async function small() {
  const { style } = document.getElementById('view');
  style.width = style.height = viewer.info.size + 'px';
  while (gpu.pw !== viewer.info.size) {
    invalidate(false);
    await new Promise((done) => setTimeout(done, 50));
  }
  await viewer.settled();
}
/* Luminance of a rectangle of the picture, in order. */
function lights(x, y, w, h) {
  const px = viewer.radiance(x, y, w, h), out = [];
  for (let i = 0; i < px.length; i += 4)
    out.push(0.2126 * px[i] + 0.7152 * px[i + 1] + 0.0722 * px[i + 2]);
  return out.sort((a, b) => a - b);
}
/* Of false colours that reach from middle - reach to middle + reach: the largest difference. */
function falseColours(middle, reach) {
  const got = shown(), px = viewer.radiance(0, 0, gpu.pw, gpu.ph);
  let most = 0;
  for (let i = 0; i < px.length; i += 4) {
    const L = 0.2126 * px[i] + 0.7152 * px[i + 1] + 0.0722 * px[i + 2];
    const x = (Math.log2(L) + info.middle + state.ev - middle + reach) / 2 / reach;
    for (let k = 0; k < 3; k++) {
      const v = TURBO.reduceRight((sum, p) => sum * x + p[k], 0);
      const want = !(x >= 0) ? 0 : x > 1 ? 1 : Math.max(0, Math.min(1, v));
      most = Math.max(most, Math.abs(255 * want - got[i + k]));
    }
  }
  return most;
}
/* Pixels that are marked without or not marked with a reason; kinds of marks. */
async function marks(ev) {
  viewer.setExposure(ev);
  await viewer.settled();
  showClipping(false);
  const plain = shown();
  showClipping(true);
  const marked = shown(), kinds = new Set(), counts = [0, 0];
  let wrong = 0;
  for (let i = 0; i < plain.length; i += 4) {
    const rgb = [...marked.subarray(i, i + 3)].join(), was = [...plain.subarray(i, i + 3)].join();
    const top = Math.max(...plain.subarray(i, i + 3));
    counts[0] += top > 252;
    counts[1] += top < 3;
    if (top >= 254 || top <= 1) wrong += rgb === was && rgb !== '0,0,0';
    else if (top > 5 && top < 250) wrong += rgb !== was;
    if (rgb !== was) kinds.add((top > 128 ? 'clipped ' : 'dark ') + rgb);
  }
  showClipping(false);
  return [wrong, ...[...kinds].sort()].join('; ');
}
/* The largest difference from four times that of photograph and picture, inside the photograph; the
 * exposure need not be that of the photograph. */
async function differences(view, which, off) {
  const { stops, src } = info.views[view].photos[which];
  viewer.setTone(0);
  viewer.go(view);
  viewer.setExposure(stops);
  await viewer.settled();
  const scene = shown(), img = new Image(), copy = document.createElement('canvas');
  img.src = src;
  await img.decode();
  viewer.setTone(3);
  viewer.setExposure(stops + off);
  viewer.draw();
  while (!gpu.photo) await new Promise((done) => setTimeout(done, 10));
  const got = shown(), v = fit(state.cam, gpu.pw, gpu.ph);
  [copy.width, copy.height] = [gpu.pw, gpu.ph];
  const g = copy.getContext('2d');
  g.drawImage(img, 0, 0);
  const photo = g.getImageData(0, 0, gpu.pw, gpu.ph).data;
  let most = 0;
  for (let i = 0; i < got.length; i++)
    if (i % 4 < 3) most = Math.max(most,
      Math.abs(Math.min(255, 4 * Math.abs(photo[i] - scene[i])) - got[i]));
  return most;
}
END
HELP+=$MORE
open_browser 800 600
begin_page "$FILE/walls/view.html"

# ---- the panel ----

is "document.getElementById('panel').hidden" true
press l
is "document.getElementById('light').getAttribute('aria-expanded')" true
spread="document.getElementById('spread').textContent"
wait_for "/median .* stops; at 0.0 EV clipped .* %, dark .* %/.test($spread)" true
value "viewer.settled()" >/dev/null
value "window.all = lights(0, 0, gpu.pw, gpu.ph), window.said = $spread.replaceAll('\\\\u2212', '-')
    .match(/[-+]?[0-9.]+/g).map(Number)" >/dev/null
is "near(said[2], stopsOf(all[all.length >> 1]), 0.2)" true
is "near(said[0], stopsOf(all[0]), 1) && near(said[1], stopsOf(all[all.length - 1]), 1)" true
is "(() => { const px = shown(); let n = 0;
    for (let i = 0; i < px.length; i += 4) n += Math.max(px[i], px[i + 1], px[i + 2]) > 252;
    return near(400 * n / px.length, said[4], 0.5); })()" true
is "[...document.querySelectorAll('#histogram text')].map((e) => e.textContent)
    .filter((t) => /dark|clipped|0 stops/.test(t)).sort().join()" "0 stops,clipped,dark"
# the exposure moves the marks, and nothing is read back for it
value "window.clipsAt = () => document.querySelectorAll('.limit')[1].getAttribute('d')
    .match(/M([0-9.]+)/)[1], window.clip0 = +clipsAt(), window.reads = 0,
    window.own = gl.readPixels.bind(gl), gl.readPixels = (...a) => { reads++; own(...a); }" \
    >/dev/null
press ]
wait_for "clipsAt() < clip0" true
is "reads" 0
# nor while the picture moves
value "(async () => { for (let i = 0; i < 8; i++) {
    orbit(0.01, 0);
    await new Promise((done) => setTimeout(done, 60));
    if (state.moving && reads) return 'read'; } })()" >/dev/null
is "reads" 0
wait_for "reads > 0" true

# ---- readouts ----

value "viewer.go(1), viewer.settled()" >/dev/null
mouse mouseMoved 300 200 0 "" none
wait_for "/stops|light/.test(document.getElementById('probe').textContent)" true
press n
wait_for "notes().length === 1 && notes()[0].startsWith('1  ' +
    document.getElementById('probe').textContent)" true
is "document.querySelectorAll('.pin:not([hidden])').length" 1
value "document.getElementById('pin').click()" >/dev/null
click 200 250
wait_for "notes().length" 2
is "viewer.state.at" 1
value "viewer.go(2), viewer.settled()" >/dev/null
wait_for "document.querySelectorAll('.pin:not([hidden])').length" 0
value "viewer.go(1), viewer.settled()" >/dev/null
wait_for "document.querySelectorAll('.pin:not([hidden])').length" 2
value "document.getElementById('copy').click()" >/dev/null
is "document.getElementById('notes').selectionEnd ===
    document.getElementById('notes').value.length" true
value "document.getElementById('clear').click()" >/dev/null
is "document.querySelectorAll('.pin').length + document.getElementById('notes').value" 0

# ---- regions ----

region() { # what x y x y [more]
    value "document.getElementById('clear').click()" >/dev/null
    drag "${@:2:4}" left 1 "${6:-}"
    wait_for "notes().length" 2
    is "viewer.state.at" 1
    value "window.rect = [[$2, $3], [$4, $5]].map(pixelAt), window.part = lights(...rect[0],
        rect[1][0] - rect[0][0] + 1, rect[1][1] - rect[0][1] + 1)" >/dev/null
    is "notes()[1].trim().replace(/ = .*? stops/g, '')" "$(value "'median ' +
        digits(part[(part.length - 1) >> 1]) + '  min ' + digits(part[0]) + '  max ' +
        digits(part[part.length - 1])")"
}
value "document.getElementById('region').click()" >/dev/null
is "document.getElementById('pin').getAttribute('aria-pressed')" false
region "button" 300 150 360 191
value "document.getElementById('region').click()" >/dev/null
region "Alt" 250 180 270 200 ',"modifiers":1'
is "document.getElementById('marquee').hidden" true
value "document.getElementById('clear').click()" >/dev/null
quiet "readouts"

# ---- lengths ----

succeed convert-scene "$OUT/pair" --out "$OUT/pair.ply"
succeed convert-scene "$OUT/pair.ply" --out "$OUT/pair.html"
begin_page "$FILE/pair.html" # metres come along
value "window.where = (m) => { const c = state.cam, box = canvas.getBoundingClientRect(),
    v = fit(c, box.width, box.height),
    [x, y, z] = [0, 1, 2].map((k) => dot(row(c.R, k), m) + c.t[k]);
    return [box.x + v.fx * x / z + v.cx, box.y + v.fy * y / z + v.cy].map(Math.round); },
    window.ends = () => document.querySelector('#ruler path').getAttribute('d').match(/[0-9.]+/g)
    .map(Number).map((v, k) => v + canvas.getBoundingClientRect()[k % 2 ? 'y' : 'x'])" >/dev/null
value "document.getElementById('light').click(), document.getElementById('measure').click()" \
    >/dev/null
read -r x y x2 y2 <<<"$(value "[...where(sample[0]), ...where(sample[1])].join(' ')")"
click "$x" "$y"
wait_for "ruler.length" 1
is "document.getElementById('length').textContent" ""
click "$x2" "$y2"
wait_for "notes()[0].slice(0, 7)" "length "
is "/ m$/.test(notes()[0]) && near(notes()[0].split(' ')[1], 1.2, 0.015)" true # pixels are 9 mm
is "'length ' + document.getElementById('length').textContent === notes()[0]" true
is "ends().every((v, k) => near(v, [$x, $y, $x2, $y2][k], 2))" true
value "viewer.go(1), viewer.settled()" >/dev/null # it stays where it is in the scene
wait_for "ends().every((v, k) => near(v, [...where(sample[0]), ...where(sample[1])][k], 2))" true
is "near(ends()[0], $x, 10)" false
is "viewer.setCamera({ ...state.cam, R: turned(state.cam.R, [0, 1, 0], 3) }) ||
    viewer.settled().then(() => document.getElementById('ruler').hasAttribute('hidden'))" true
value "viewer.go(1), viewer.settled()" >/dev/null
mouse mouseMoved "$(value "where(sample[0])[0]")" "$(value "where(sample[0])[1]")" 0 "" none
press m # another one begins
wait_for "ruler.length" 1
mouse mouseMoved 30 200 0 "" none
press m
wait_for "document.getElementById('hint').textContent" "nothing is there"
is "ruler.length" 1
value "document.getElementById('clear').click()" >/dev/null
is "ruler.length + String(document.getElementById('ruler').hasAttribute('hidden'))" 0true
quiet "lengths"
begin_page "$FILE/walls/view.html"
value "window.at2 = [[250, 180], [330, 200]], measureTo(at2[0])" >/dev/null
value "measureTo(at2[1])" >/dev/null
is "notes()[0].replace(/[0-9.]+/, 'x')" "length x scene units"
value "document.getElementById('clear').click()" >/dev/null

# ---- colours ----

value "small()" >/dev/null
value "viewer.setTone(2)" >/dev/null
for range in "0 8" "1 3" "-2 14"; do
    read -r middle reach <<<"$range"
    value "setRange($middle, 2 * $reach), viewer.settled()" >/dev/null
    most=$(value "falseColours($middle, $reach)")
    at_least "false colours around $middle: minus largest difference" "-$most" -3
done
is "document.getElementById('labels').firstChild.textContent.replaceAll('\\\\u2212', '-')
    .split('\\\\n')[0]" -16
is "document.getElementById('range').hidden" false
value "setRange(0, 16), viewer.setTone(0)" >/dev/null
is "document.getElementById('range').hidden" true
is "marks(6)" "0; clipped 0,0,0; clipped 255,102,51"
is "marks(-9)" "0; clipped 0,0,0; clipped 255,102,51; dark 0,0,0; dark 51,153,255"
for which in "1, 0, 0" "2, 0, 0" "2, 1, 0.7" "2, 2, -1"; do
    most=$(value "differences($which)")
    at_least "difference from the photograph $which: minus largest difference" "-$most" -6
done
is "document.getElementById('tone').value" 3
value "viewer.setTone(0), document.getElementById('view').style = ''" >/dev/null
quiet "colours"

# ---- EXR ----

begin_page "$FILE/thin/view.html"
mkdir "$OUT/saved"
call Browser.setDownloadBehavior \
    "{\"behavior\":\"allow\",\"downloadPath\":\"$(realpath "$OUT")/saved\"}"
value "small()" >/dev/null
value "document.getElementById('exr').click()" >/dev/null
for _ in $(seq 100); do
    ls "$OUT"/saved/*.exr >/dev/null 2>&1 && break
    sleep 0.1
done
value "numbers()" | base64 -d >"$OUT/page.f32"
read -r median most worst < <("$BIN/compare" radiance "$OUT"/saved/*.exr "$OUT/page.f32")
[ "$worst" = 0.000000 ] || fail "the EXR file differs from the picture by $median, $most, $worst"
quiet "EXR"

# ---- accessibility ----

begin_page "$FILE/walls/view.html"
accessible "view"
value "viewer.setTone(2), viewer.compare(true), document.getElementById('light').click()" >/dev/null
press n
wait_for "/median/.test($spread)" true
accessible "view with its tools"
value "viewer.settled()" >/dev/null
screenshot "$OUT/tools.png"
value "document.getElementById('light').click(), document.getElementById('help').click()" >/dev/null
accessible "help"
quiet "accessibility"

# ---- a telephone ----

call Emulation.setTouchEmulationEnabled '{"enabled":true,"maxTouchPoints":5}'
resize 360 640 2 true
begin_page "$FILE/walls/view.html"
fits="[...document.querySelectorAll('button, select, input, textarea, a')].filter((e) =>
    e.checkVisibility()).filter((e) => { const b = e.getBoundingClientRect();
    return b.width < 24 || b.height < 24 || b.left < 0 || b.right > 360 || b.top < 0 ||
        b.bottom > 640; }).map((e) => e.id || e.textContent).join()"
thumbs="[...document.querySelectorAll('.row button, .row select, header button')].filter((e) =>
    e.checkVisibility() && e.getBoundingClientRect().height < 44).map((e) => e.id).join()"
is "$fits" ""
is "$thumbs" ""
is "document.documentElement.scrollHeight <= innerHeight" true
is "document.getElementById('view').clientHeight > 300" true
screenshot "$OUT/telephone.png"
value "document.getElementById('light').click(), viewer.setTone(2)" >/dev/null
wait_for "/median/.test($spread)" true
is "document.documentElement.scrollWidth <= innerWidth" true
is "$thumbs" ""
value "document.getElementById('pin').click()" >/dev/null
touch touchStart '{"x":180,"y":150,"id":1}'
touch touchEnd ''
wait_for "notes()[0].startsWith('1  ')" true
value "document.getElementById('region').click()" >/dev/null
swipe 100 130 140 170
wait_for "notes().length" 3
value "document.getElementById('measure').click()" >/dev/null
for x in 140 200; do
    touch touchStart "{\"x\":$x,\"y\":150,\"id\":1}"
    sleep 1 # however long it takes
    touch touchEnd ''
    wait_for "ruler.length > 0" true
done
wait_for "notes()[3].slice(0, 7)" "length "
is "viewer.state.at" 0
screenshot "$OUT/telephone_tools.png"
value "document.getElementById('light').click(), document.getElementById('help').click()" >/dev/null
is "[...document.querySelectorAll('#guide th')].filter((e) => e.checkVisibility())
    .map((e) => e.textContent).join()" touch
is "[...document.querySelectorAll('#guide td:nth-child(3)')].filter((e) => !e.textContent)
    .length" 0
is "document.getElementById('guide').getBoundingClientRect().bottom <= 640" true
screenshot "$OUT/telephone_help.png"
quiet "telephone"
browser_close
finish
