/* How far the camera may go from the photographs, what moves it by itself, and the buttons on the
 * picture. */


/* ---- where photographs were taken ---- */

const FREE = 1, LIMIT = 2; // of their depth: from here on it resists, and stops
const WIDE = Math.PI / 4; // rad: what is so far from a photograph's axis is outside of it

/* Their places and axes; their depth, that of some. */
const photographs = (() => {
  let known = null;
  return () => {
    if (known) return known;
    const cams = info.views.map(cameraOf), step = Math.ceil(cams.length / 9);
    known = cams.map((cam) => ({ centre: centreOf(cam), axis: row(cam.R, 2) }));
    known.depth = median(cams.filter((cam, i) => i % step === 0).map(focusOf)) || state.focus;
    return known;
  };
})();

/* From the nearest photograph's place, of their depth. */
function distance() {
  const all = photographs(), at = centreOf(state.cam);
  const way = (p) => Math.hypot(...p.centre.map((v, k) => v - at[k]));
  return all.length ? Math.min(...all.map(way)) / all.depth : 0;
}

/* 0 at a photograph, 1 where none was taken from near by, or in this direction. */
function away() {
  const all = photographs(), at = centreOf(state.cam), axis = row(state.cam.R, 2);
  return all.reduce((least, p) => Math.min(least, Math.max(
    2 * Math.hypot(...p.centre.map((v, k) => v - at[k])) / all.depth,
    Math.acos(clamp(dot(p.axis, axis), -1, 1)) / WIDE)), all.length ? Infinity : 0);
}

/* step(part) moves the camera by this part of the way: all of it near the photographs. */
function within(step) {
  const { R, t } = state.cam, { focus } = state, from = distance();
  step(1);
  const more = distance() - from;
  if (more > 0 && from + more > FREE) {
    Object.assign(state.cam, { R, t });
    state.focus = focus;
    step(clamp((LIMIT - from) / (LIMIT - FREE + more), 0, 1));
  }
  moved();
}

/* On the way out what is around the photograph appears, and guesses fade. */
function showAway() {
  const far = state.at < 0 ? away() : 0;
  state.outside = info.views.length ? clamp(5 * far, 0, 1) : 1;
  state.guesses = clamp(1.5 - far, 0, 1);
  hints.away = far > 1 ? "beyond the photographs" : "";
  showHint();
}

const hints = { away: "", note: "", timer: 0 };

function showHint() {
  const text = hints.note || hints.away;
  if (byId("hint").textContent !== text) byId("hint").textContent = text; // else it is read again
}

function note(sentence) {
  hints.note = sentence;
  clearTimeout(hints.timer);
  if (sentence) hints.timer = setTimeout(note, 4000, "");
  showHint();
}

/* ---- what moves by itself ---- */

const motion = { step: null, ticking: false, at: 0 }; // step(seconds): whether it goes on

const calm = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

function move(step) {
  motion.step = step;
  if (motion.ticking) return;
  motion.ticking = true;
  motion.at = performance.now();
  requestAnimationFrame(tick);
}

function tick(now) {
  const { step } = motion, seconds = clamp((now - motion.at) / 1000, 0, 0.2);
  motion.at = now;
  if (step && !step(seconds) && motion.step === step) motion.step = null;
  motion.ticking = motion.step !== null;
  if (motion.ticking) requestAnimationFrame(tick);
}

function halt() {
  motion.step = null;
  flying.clear();
  if (tour.recorder) tour.recorder.stop();
  Object.assign(tour, { on: false, recorder: null });
  showTour();
}

/* The world's turn that makes R into R2; angle 0 where no axis stands out. */
function turnBetween(R, R2) {
  const Q = [...R].map((v, n) => [0, 3, 6].reduce((sum, k) =>
    sum + R2[k + Math.floor(n / 3)] * R[k + n % 3], 0));
  const axis = [Q[7] - Q[5], Q[2] - Q[6], Q[3] - Q[1]], length = Math.hypot(...axis);
  return { axis: axis.map((v) => v / (length || 1)),
    angle: length > 1e-6 ? Math.atan2(length, Q[0] + Q[4] + Q[8] - 1) : 0 };
}

/* To another camera. */
function glide(cam, focus, seconds, done) {
  const from = state.cam, { axis, angle } = turnBetween(from.R, cam.R), first = state.focus;
  const start = centreOf(from), end = centreOf(cam);
  let time = 0;
  move((s) => {
    time += s;
    const x = calm() ? 1 : Math.min(1, time / seconds), e = x * x * (3 - 2 * x);
    const mix = (a, b) => a + (b - a) * e;
    const next = { ...cam, R: x < 1 ? turned(from.R, axis, angle * e) : cam.R };
    for (const key of ["w", "h", "fx", "fy", "cx", "cy"]) next[key] = mix(from[key], cam[key]);
    place(next, start.map((v, k) => mix(v, end[k])));
    state.cam = next;
    state.focus = mix(first, focus);
    moved();
    if (x === 1 && done) done();
    return x < 1;
  });
}

/* ---- hands ---- */

/* Where a pointer was in the last tenth of a second. */
const trackOf = (before, e) => [...before.track.filter(({ t }) => e.timeStamp - t < 100),
  { x: e.clientX, y: e.clientY, t: e.timeStamp }];

/* The picture goes on as a pointer threw it; two taps in one place turn the camera there. */
const lastTap = { x: 0, y: 0, t: -1e9 };
function released(p, e) {
  const first = p.track[0], last = p.track[p.track.length - 1];
  if (p.way < 6 && e.type === "pointerup") {
    const near = Math.hypot(e.clientX - lastTap.x, e.clientY - lastTap.y) < 30;
    const twice = near && e.timeStamp - lastTap.t < 400;
    Object.assign(lastTap, { x: e.clientX, y: e.clientY, t: twice ? -1e9 : e.timeStamp });
    if (twice) focusAt(e.clientX, e.clientY);
  } else if (p.track.length > 1 && e.timeStamp - last.t < 100 && !calm()) {
    const ms = Math.max(16, last.t - first.t);
    throwPicture((last.x - first.x) / ms, (last.y - first.y) / ms, p.shift);
  }
}

function throwPicture(vx, vy, sideways) { // pixels in a millisecond
  const slower = Math.min(1, 3 / Math.hypot(vx, vy));
  let speed = 1000 * slower;
  move((s) => {
    if (s > 0) drag(vx * speed * s, vy * speed * s, sideways);
    speed *= Math.exp(-s / 0.2);
    return speed * Math.hypot(vx, vy) > 15;
  });
}

/* What is seen at a point of the window: to the right, down and ahead of the camera; null:
 * nothing. */
function seenAt(x, y) {
  if (stale) draw();
  const pixel = pixelAt([x, y]), v = fit(state.cam, gpu.pw, gpu.ph), z = pixel && depthAt(...pixel);
  if (!z) note("nothing is there");
  return z ? [(pixel[0] + 0.5 - v.cx) / v.fx * z, (pixel[1] + 0.5 - v.cy) / v.fy * z, z] : null;
}

/* Turn to the surface that is seen there, and around it from now on. */
function focusAt(x, y) {
  const cam = { ...state.cam }, to = seenAt(x, y), at = centreOf(cam);
  if (!to) return;
  const side = Math.hypot(to[0], to[1]);
  const axis = [0, 1, 2].map((k) => (to[0] * cam.R[3 + k] - to[1] * cam.R[k]) / (side || 1));
  cam.R = turned(cam.R, axis, Math.atan2(side, to[2]));
  place(cam, at);
  glide(cam, Math.hypot(...to), 0.5);
}

const FLY = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0],
  q: [0, 1, 0], e: [0, -1, 0] };
const flying = new Set(); // keys that are held
let fast = false;

function flyOn(s) { // half of the photographs' depth in a second
  const way = [0, 0, 0], speed = photographs().depth * (fast ? 1.5 : 0.5);
  for (const key of flying) FLY[key].forEach((v, k) => { way[k] += v * speed * s; });
  if (way.some((v) => v)) shift(way);
  return flying.size > 0;
}

function fly(key, faster) {
  fast = faster;
  if (flying.has(key)) return;
  if (!flying.size) halt();
  flying.add(key);
  flyOn(0.05);
  move(flyOn);
}

/* ---- through the cameras ---- */

const tour = { on: false, recorder: null, pictures: false };

function showTour() {
  const { on, recorder, pictures } = tour;
  for (const [id, pressed] of Object.entries({ play: on && !recorder,
    record: !!recorder && !pictures, pictures }))
    byId(id).setAttribute("aria-pressed", pressed);
}

/* From the last camera on; `legs` of them. */
function play(legs = Infinity) {
  halt();
  if (info.views.length < 2) return;
  tour.on = true;
  showTour();
  let left = legs, pause = 0;
  const leg = () => {
    const next = (state.last + 1) % info.views.length, cam = cameraOf(info.views[next]);
    if (left-- <= 0) return halt();
    glide(cam, focusOf(cam), 1.6, () => {
      go(next);
      pause = calm() ? 1.5 : 0.4;
      move(rest);
    });
  };
  const rest = (s) => {
    pause -= s;
    if (pause <= 0) leg();
    return pause > 0;
  };
  if (state.at < 0) go(state.last);
  pause = 0.4;
  move(rest);
}

/* A film of one round. */
function record() {
  const film = new MediaRecorder(canvas.captureStream(30),
    { mimeType: "video/webm", videoBitsPerSecond: 1.2e7 });
  const pieces = [];
  film.ondataavailable = (e) => pieces.push(e.data);
  film.onstop = () => save(new Blob(pieces, { type: "video/webm" }), "webm");
  play(info.views.length);
  film.start();
  tour.recorder = film;
  showTour();
}

/* ---- the same as pictures ---- */

const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n >>> 1 ^ (n & 1 && 0xedb88320);
  return n;
});

/* Parts of a zip archive: files, stored as they are, then its directory. Words are little-endian,
 * as the machines of browsers are. */
function zipped(files) {
  const words = (...w) => new Uint16Array(w), both = (v) => [v & 65535, v >>> 16];
  const parts = [], list = [];
  let at = 0;
  files.forEach(({ blob, sum }, i) => {
    const name = `${i}.png`.padStart(9, "0"), size = both(blob.size);
    const head = [20, 0, 0, 0, 33, ...both(sum), ...size, ...size, 9, 0]; // of 1980
    parts.push(words(0x4b50, 0x403, ...head), name, blob);
    list.push(words(0x4b50, 0x201, 20, ...head, 0, 0, 0, 0, 0, ...both(at)), name);
    at += 39 + blob.size;
  });
  const n = files.length;
  return [...parts, ...list, words(0x4b50, 0x605, 0, 0, n, n, ...both(55 * n), ...both(at), 0)];
}

/* 30 a second of one round, each drawn as if it stood still; those that are there when it is
 * stopped. */
async function recordPictures() {
  if (info.views.length < 2) return;
  halt();
  if (tour.pictures) return;
  tour.pictures = true;
  await settled();
  motion.ticking = true; // by the loop below instead of the clock
  play(info.views.length);
  const files = [], own = tour.recorder = { stop() {} };
  showTour();
  while (tour.recorder === own) {
    const { step } = motion;
    if (!step(1 / 30) && motion.step === step) motion.step = null;
    state.moved = -1e9; // at full resolution, at once
    await settled(true);
    draw();
    const blob = await new Promise((done) => canvas.toBlob(done));
    const sum = new Uint8Array(await blob.arrayBuffer()).reduce((c, byte) =>
      CRC[(c ^ byte) & 255] ^ c >>> 8, -1);
    files.push({ blob, sum: ~sum });
  }
  motion.ticking = tour.pictures = false;
  showTour();
  if (motion.step) move(motion.step); // what began meanwhile
  save(new Blob(zipped(files), { type: "application/zip" }), "zip");
}

/* ---- what leaves the page ---- */

function save(blob, ending) {
  const link = document.createElement("a");
  link.download = `${document.title.replace(/[^\w.-]+/g, "-") || "scene"}.${ending}`;
  link.href = URL.createObjectURL(blob);
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

async function savePicture() {
  halt();
  await settled();
  draw(); // the canvas keeps no picture between frames
  canvas.toBlob((blob) => save(blob, "png"));
}

/* view=2&ev=0.5&tone=0, and by hand pose=: place, axis, direction to the right, focus. */
function linkOf() {
  const { R } = state.cam, pose = [...centreOf(state.cam), ...row(R, 2), ...row(R, 0), state.focus];
  return `view=${state.last}&ev=${+state.ev.toFixed(2)}&tone=${state.tone}` +
    (state.at < 0 ? `&pose=${pose.map((v) => +v.toPrecision(7))}` : "");
}

function poseOf(text) { // [] where it is none
  const v = text.split(",").map((word) => word ? +word : NaN), z = v.slice(3, 6), x = v.slice(6, 9);
  const unit = (a) => a.map((c) => c / Math.hypot(...a));
  const cross = (a, b) => [0, 1, 2].map((k) =>
    a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
  if (v.length !== 10 || !v.every((c) => Math.abs(c) < 1e10) || !(v[9] > 0)) return [];
  const R = [unit(cross(cross(z, x), z)), unit(cross(z, x)), unit(z)].flat();
  return R.every(Number.isFinite) ? [R, v.slice(0, 3), v[9]] : [];
}

/* Whether the address says where to stand; then there the camera stands. */
function openLink() {
  const p = new URLSearchParams(location.hash.slice(1)), ev = p.get("ev"), tone = p.get("tone");
  const view = p.get("view"), [R, at, focus] = poseOf(p.get("pose") || "");
  if (!(/^\d+$/.test(view) && view < (info.views.length || 1)) || p.has("pose") && !R ||
      !(ev && Math.abs(ev) <= byId("ev").max) ||
      ![...byId("tone").options].some((o) => o.value === tone)) return false;
  halt();
  go(+view);
  setExposure(+ev);
  setTone(+tone);
  if (!R) return true;
  state.cam.R = R;
  place(state.cam, at);
  state.focus = focus;
  moved();
  return true;
}

function copyLink() {
  history.replaceState(null, "", `#${linkOf()}`);
  copy(location.href, "the address is now a link to this view");
}

function copy(text, instead) { // where browsers do not let it
  const done = navigator.clipboard ? navigator.clipboard.writeText(text) : Promise.reject();
  done.then(() => note("copied"), () => note(instead));
}

/* ---- the box ---- */

/* Sliders of the six sides, at the ends of which there is no bound: most splats lie between. */
function makeSides() {
  for (let k = 0; k < 3; k++) {
    const all = sample.map((m) => m[k]).sort((a, b) => a - b), last = all.length - 1;
    const lo = all[Math.round(0.01 * last)], hi = all[Math.round(0.99 * last)];
    const more = 0.1 * (hi - lo) || 1;
    byId("sides").append("xyz"[k], ...["from", "to"].map((end, e) => {
      const side = document.createElement("input");
      Object.assign(side, { type: "range", min: lo - more, max: hi + more,
        step: (hi - lo + 2 * more) / 400, ariaLabel: `${"xyz"[k]} ${end}` });
      side.value = e ? side.max : side.min;
      side.addEventListener("input", readBox);
      return side;
    }));
  }
}

/* Sides that would pass each other meet. */
function readBox(e) {
  const sides = [...byId("sides").querySelectorAll("input")], box = NO_BOX.slice();
  for (let k = 0; k < 3; k++) {
    const [from, to] = sides.slice(2 * k), step = +from.step;
    if (+to.value < +from.value + step) {
      if (e && e.target === to) from.value = +to.value - step;
      else to.value = +from.value + step;
    }
    if (+from.value > +from.min + step / 2) box[k] = +(+from.value).toPrecision(5);
    if (+to.value < +to.max - 1.5 * step) box[k + 3] = +(+to.value).toPrecision(5);
  }
  state.box = box;
  const text = box.map((v) => Math.abs(v) === 1e9 ? `${v / 1e9}e9` : v);
  byId("argument").textContent = `--crop ${text}`;
  invalidate(true);
}

function switchBox() {
  const on = byId("box").hidden;
  byId("box").hidden = !on;
  byId("crop").setAttribute("aria-pressed", on);
  if (on && !byId("sides").children.length) makeSides();
  if (on) readBox();
  else state.box = NO_BOX;
  invalidate(true);
}

/* ---- buttons ---- */

function showUnseen(on) {
  state.unseen = on;
  byId("unseen").setAttribute("aria-pressed", on);
  invalidate(false);
}

function switchFull() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen().catch((e) => note(e.message));
}

function focusMiddle() {
  const box = canvas.getBoundingClientRect();
  focusAt(box.left + box.width / 2, box.top + box.height / 2);
}

/* Hands stop what moves by itself, but for those that are its own. */
function haltBy(e) {
  const own = e.target.closest && e.target.closest("#play, #record, #pictures");
  if (own || e.key === " " || e.key === "Shift" || e.key && FLY[e.key.toLowerCase()]) return;
  halt();
}

function openTools() {
  const press = { reset: () => go(state.last), play: () => tour.on ? halt() : play(),
    record: () => tour.recorder ? halt() : record(),
    pictures: () => tour.pictures ? halt() : recordPictures(), save: savePicture, link: copyLink,
    unseen: () => showUnseen(!state.unseen), crop: switchBox, full: switchFull,
    copybox: () =>
      copy(byId("argument").textContent, "this browser does not copy: mark the text") };
  for (const [id, act] of Object.entries(press)) byId(id).addEventListener("click", act);
  byId("play").hidden = byId("pictures").hidden = info.views.length < 2;
  byId("record").hidden = info.views.length < 2 || !canvas.captureStream ||
    !window.MediaRecorder || !MediaRecorder.isTypeSupported("video/webm");
  byId("full").hidden = !document.fullscreenEnabled;
  Object.assign(keys, { " ": press.play, p: savePicture, o: press.pictures,
    v: copyLink, u: press.unseen, x: switchBox,
    f: () => document.fullscreenEnabled && switchFull(), Enter: focusMiddle });
  for (const key of Object.keys(FLY))
    keys[key] = keys[key.toUpperCase()] = (faster) => fly(key, faster);
  for (const kind of ["pointerdown", "wheel", "keydown"])
    document.addEventListener(kind, haltBy, { capture: true, passive: true });
  document.addEventListener("keyup", (e) => flying.delete(e.key.toLowerCase()));
  addEventListener("blur", () => flying.clear());
  addEventListener("hashchange", openLink);
  document.addEventListener("fullscreenchange", () =>
    byId("full").setAttribute("aria-pressed", !!document.fullscreenElement));
}
