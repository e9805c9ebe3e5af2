/* Where the camera stands, what hands do, and what is written around the picture; the picture is
 * that of splats.js. */

/* ---- moving ---- */

const sample = []; // positions of some splats

function openSample(scene, n) {
  const all = new Float32Array(scene, 0, 8 * n), step = Math.ceil(info.n / 20000) || 1;
  for (let i = 0; i < n; i += step) sample.push([...all.subarray(8 * i, 8 * i + 3)]);
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const row = (R, k) => R.slice(3 * k, 3 * k + 3);
const median = (list) => list.sort((a, b) => a - b)[list.length >> 1];

/* Median depth of the splats in the middle of the picture, or of all before the camera. */
function focusOf(cam) {
  const inner = [], all = [], rows = [0, 1, 2].map((k) => row(cam.R, k));
  for (const m of sample) {
    const [x, y, z] = rows.map((r, k) => dot(r, m) + cam.t[k]);
    if (!(z > 0)) continue;
    all.push(z);
    if (Math.abs(x / z) * cam.fx < cam.w / 5 && Math.abs(y / z) * cam.fy < cam.h / 5) inner.push(z);
  }
  return median(inner.length > 20 ? inner : all) || 1;
}

/* Where there are no views: before everything, looking along z. */
function someCamera() {
  const size = info.size || 448, at = [0, 1, 2].map((k) => median(sample.map((m) => m[k])) || 0);
  const far = median(sample.map((m) => Math.hypot(...m.map((v, k) => v - at[k])))) || 1;
  return { w: size, h: size, fx: size, fy: size, cx: size / 2, cy: size / 2,
    R: [1, 0, 0, 0, 1, 0, 0, 0, 1], t: [-at[0], -at[1], 3 * far - at[2]] };
}

function setCamera(cam, at = -1) {
  state.cam = cam;
  state.at = at;
  if (at >= 0) state.last = at;
  state.focus = focusOf(cam);
  requestSort();
  invalidate(true);
  showCamera();
}

function go(i) {
  const n = info.views.length;
  if (!n) return setCamera(someCamera());
  i = (i + n) % n;
  setCamera(cameraOf(info.views[i]), i);
  if (state.wipe) matchExposure();
}

/* After the camera has been changed by hand. */
function moved() {
  state.at = -1;
  state.moved = performance.now();
  requestSort();
  invalidate(true);
  showCamera();
}

function turned(R, axis, angle) { // R after the world has turned
  const [x, y, z] = axis.map((v) => v * Math.sin(angle / 2));
  const Q = rotation([Math.cos(angle / 2), x, y, z]);
  return R.map((v, k) => dot(row(R, Math.floor(k / 3)), row(Q, k % 3)));
}

const upward = (() => { // of the mean view
  const sum = [0, 0, 0];
  for (const v of info.views) row(rotation(v.q), 1).forEach((y, k) => { sum[k] -= y; });
  const length = Math.hypot(...sum);
  return length > 0.1 ? sum.map((v) => v / length) : null;
})();

/* Around the focus, rad: what is before it goes right and down. */
function orbit(yaw, pitch) {
  within((part) => turnCamera(part * yaw, part * pitch));
}

function turnCamera(yaw, pitch) {
  const cam = state.cam, up = upward || row(cam.R, 1).map((v) => -v);
  const pivot = centreOf(cam).map((v, k) => v + state.focus * cam.R[6 + k]);
  const now = Math.acos(Math.max(-1, Math.min(1, dot(row(cam.R, 2), up))));
  const goal = Math.max(0.1, Math.min(Math.PI - 0.1, now + pitch));
  cam.R = turned(cam.R, up, -yaw);
  cam.R = turned(cam.R, row(cam.R, 0), now - goal);
  place(cam, pivot.map((v, k) => v - state.focus * cam.R[6 + k]));
}

/* The picture follows the pointer: pixels of the screen. */
function pan(dx, dy) {
  const cam = state.cam, v = fit(cam, canvas.clientWidth, canvas.clientHeight);
  shift([-dx * state.focus / v.fx, -dy * state.focus / v.fy, 0]);
}

/* The camera goes to the right, down, ahead: scene units. */
function shift(way) {
  const { R } = state.cam;
  within((part) => place(state.cam, centreOf(state.cam).map((c, k) =>
    c + part * (way[0] * R[k] + way[1] * R[3 + k] + way[2] * R[6 + k]))));
}

function zoom(factor) {
  within((part) => {
    const cam = state.cam;
    const next = Math.max(1e-9, Math.min(1e10, state.focus * factor ** part));
    place(cam, centreOf(cam).map((c, k) => c + (state.focus - next) * cam.R[6 + k]));
    state.focus = next;
  });
}

function drag(dx, dy, sideways) { // pixels of the screen
  const width = byId("stage").clientWidth;
  if (sideways) pan(dx, dy);
  else orbit(dx * 4 / width, dy * 4 / width);
}

/* ---- pointers ---- */

const pointers = new Map();

function pointerMoved(e) {
  const before = pointers.get(e.pointerId);
  if (!before) {
    if (e.pointerType === "mouse") state.probe = [e.clientX, e.clientY], showProbe();
    return;
  }
  const now = { ...before, x: e.clientX, y: e.clientY };
  const dx = now.x - before.x, dy = now.y - before.y;
  now.way += Math.hypot(dx, dy);
  now.track = pointers.size > 1 ? [] : trackOf(before, e);
  pointers.set(e.pointerId, now);
  if (pointers.size === 1) {
    drag(dx, dy, now.shift);
  } else if (pointers.size === 2) {
    const other = [...pointers].find(([id]) => id !== e.pointerId)[1];
    const was = Math.hypot(before.x - other.x, before.y - other.y);
    const is = Math.hypot(now.x - other.x, now.y - other.y);
    pan(dx / 2, dy / 2);
    if (was > 0 && is > 0) zoom(was / is);
  }
}

function openPointers() {
  const stage = byId("stage");
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    stage.focus({ preventScroll: true });
    pointers.set(e.pointerId, { x: e.clientX, y: e.clientY, way: 0, track: [],
      shift: e.shiftKey || e.button > 0 });
  });
  canvas.addEventListener("pointermove", pointerMoved);
  const end = (e) => {
    const p = pointers.get(e.pointerId);
    pointers.delete(e.pointerId);
    if (p && p.way < 6) state.probe = [e.clientX, e.clientY];
    if (p && !pointers.size) released(p, e);
    showProbe();
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("pointerleave", () => { if (!pointers.size) state.probe = null; });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    zoom(Math.exp(e.deltaY * (e.deltaMode ? 0.04 : 0.0015)));
  }, { passive: false });
}

const keys = {
  ArrowLeft: (s) => s ? pan(20, 0) : orbit(-0.05, 0),
  ArrowRight: (s) => s ? pan(-20, 0) : orbit(0.05, 0),
  ArrowUp: (s) => s ? pan(0, 20) : orbit(0, -0.05),
  ArrowDown: (s) => s ? pan(0, -20) : orbit(0, 0.05),
  "+": () => zoom(1 / 1.1), "=": () => zoom(1 / 1.1), "-": () => zoom(1.1),
  "[": () => setExposure(state.ev - 0.5), "]": () => setExposure(state.ev + 0.5),
  ",": () => go(state.last - 1), ".": () => go(state.last + 1), 0: () => go(state.last),
  1: () => setTone(0), 2: () => setTone(1), 3: () => setTone(2), 4: () => setTone(3),
  c: () => compare(!state.wipe), g: () => hideGuesses(!state.proven),
  l: () => byId("light").click(), k: () => showClipping(!state.clip), n: () => pin(here()),
  m: () => measureTo(here()),
  r: () => byId("region").click(),
  "?": () => byId("guide").showModal(),
};

function openKeys() {
  document.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || byId("guide").open) return;
    const own = e.target.matches("input, select, textarea, #divider") && /^Arrow/.test(e.key) ||
      e.target.matches("button, a, select") && /^( |Enter)$/.test(e.key);
    if (!keys[e.key] || own || e.repeat && /^[ cfglopuvx]$/.test(e.key)) return;
    e.preventDefault();
    keys[e.key](e.shiftKey);
  });
}

/* ---- controls ---- */

const signed = (v) => (v < 0 ? "\u2212" : v > 0 ? "+" : "") + Math.abs(v).toFixed(1);

function showProbe() {
  if (!state.probe || !gpu.picture || stale || state.moving || pointers.size) return;
  const at = pixelAt(state.probe);
  if (at) byId("probe").textContent = inWords(exact(...at));
}

function showCamera() {
  byId("cameras").value = state.at;
  byId("compare").disabled = !info.views.some((v) => v.photos);
  byId("compare").setAttribute("aria-pressed", state.wipe);
  showTicks();
  showAway();
}

/* Of the camera, what was taken nearest to the exposure; of all others nothing. */
function photograph() {
  const { photos = [] } = info.views[state.at] || {};
  const away = (p) => Math.abs(p.stops - state.ev);
  return photos.reduce((a, b) => a && away(a) <= away(b) ? a : b, null);
}

function matchExposure() {
  setExposure((photograph() || { stops: state.ev }).stops);
}

function layPhoto() {
  const photo = state.wipe && photograph();
  byId("photo").hidden = byId("divider").hidden = !photo;
  if (!photo) return;
  const v = fit(state.cam, canvas.clientWidth, canvas.clientHeight);
  const { w, h } = state.cam;
  const box = { left: v.left, top: v.top, width: v.s * w, height: v.s * h };
  if (byId("photo").src !== photo.src) byId("photo").src = photo.src;
  for (const [key, px] of Object.entries(box)) byId("photo").style[key] = `${px}px`;
  byId("photo").style.clipPath = `inset(0 ${100 - state.split}% 0 0)`;
  byId("divider").style.left = `${v.left + box.width * state.split / 100}px`;
  byId("divider").style.top = `${v.top}px`;
  byId("divider").style.height = `${box.height}px`;
  byId("divider").setAttribute("aria-valuenow", Math.round(state.split));
}

/* Splats that the photographs do not prove are left out. */
function hideGuesses(on) {
  state.proven = on && info.guesses > 0;
  byId("proven").setAttribute("aria-pressed", state.proven);
  invalidate(true);
}

function setSplit(percent) {
  state.split = Math.max(0, Math.min(100, percent));
  layPhoto();
}

function compare(on) {
  state.wipe = on && info.views.some((v) => v.photos);
  if (state.wipe) go(state.last);
  showCamera();
  invalidate(false);
}

function setExposure(ev) {
  state.ev = ev;
  byId("ev").value = ev;
  byId("stops").textContent = `${signed(ev)} EV`;
  showTicks();
  showLegend();
  invalidate(false);
}

/* The mark of the exposure, or of the photograph that is compared. */
function showTicks() {
  const photo = (state.wipe || state.tone === 3) && photograph();
  for (const tick of byId("ticks").children)
    tick.setAttribute("aria-pressed",
      Math.abs(tick.dataset.stops - (photo ? photo.stops : state.ev)) < 0.05);
}

function setTone(mode) {
  state.tone = mode;
  byId("tone").value = mode;
  if (mode === 3) go(state.last), matchExposure();
  else setExposure(state.ev);
}

function openTicks() {
  const all = info.taken.sort((a, b) => a - b);
  const ticks = all.filter((v, k) => k === 0 || v - all[k - 1] > 0.05);
  const reach = Math.max(10, ...ticks.map((v) => Math.abs(v) + 4));
  byId("ev").min = -reach;
  byId("ev").max = reach;
  byId("ev").addEventListener("input", () => setExposure(+byId("ev").value));
  byId("ticks").append(...ticks.map((v) => {
    const tick = document.createElement("button");
    tick.textContent = signed(v);
    tick.dataset.stops = v;
    tick.style.left = `${50 + 50 * v / reach}%`;
    tick.title = `exposure of ${all.filter((w) => Math.abs(w - v) <= 0.05).length} photographs`;
    return tick;
  }));
  byId("ticks").addEventListener("click", (e) => { // a thumb covers several: the nearest
    const box = byId("ticks").getBoundingClientRect();
    const at = e.detail ? (2 * (e.clientX - box.left) / box.width - 1) * reach
                        : +e.target.dataset.stops; // by the keyboard
    const away = (v) => Math.abs(v - at);
    if (at === at) setExposure(ticks.reduce((a, b) => away(b) < away(a) ? b : a));
  });
}

/* Labels that would run into the one before are left out. */
function layTicks() {
  let free = -Infinity;
  for (const tick of byId("ticks").children) {
    const crowded = tick.offsetLeft < free;
    tick.classList.toggle("bare", crowded);
    if (!crowded) free = tick.offsetLeft + 36;
  }
}

function openDivider() {
  const divider = byId("divider");
  divider.addEventListener("pointerdown", (e) => divider.setPointerCapture(e.pointerId));
  divider.addEventListener("pointermove", (e) => {
    const box = byId("photo").getBoundingClientRect();
    if (divider.hasPointerCapture(e.pointerId))
      setSplit(100 * (e.clientX - box.left) / box.width);
  });
  divider.addEventListener("keydown", (e) => {
    if (e.key === "ArrowLeft") setSplit(state.split - 2);
    if (e.key === "ArrowRight") setSplit(state.split + 2);
  });
}

function showFacts() {
  byId("facts").textContent = `${info.n.toLocaleString("en")} splats, harmonics of degree ` +
    `${info.degree}; first picture after ${(firstPicture / 1000).toFixed(1)} s.`;
}

function openControls() {
  for (const [name, i] of [["free view", -1], ...info.views.map((v, k) => [v.name, k])])
    byId("cameras").append(new Option(name, i));
  byId("walk").hidden = !info.views.length;
  byId("cameras").addEventListener("change", () => {
    if (byId("cameras").value >= 0) go(+byId("cameras").value);
    else showCamera();
  });
  byId("previous").addEventListener("click", () => go(state.last - 1));
  byId("next").addEventListener("click", () => go(state.last + 1));
  byId("compare").addEventListener("click", () => compare(!state.wipe));
  byId("proven").disabled = !info.guesses;
  byId("proven").addEventListener("click", () => hideGuesses(!state.proven));
  byId("tone").addEventListener("change", () => setTone(+byId("tone").value));
  byId("help").addEventListener("click", () => byId("guide").showModal());
  byId("close").addEventListener("click", () => byId("guide").close());
  byId("report").hidden = !info.report;
  if (info.report) byId("report").href = info.report;
  openTicks();
  new ResizeObserver(() => {
    layTicks();
    invalidate(false);
  }).observe(byId("stage"));
  openDivider();
  openLightTools();
  openPointers();
  openTools();
  openKeys();
}

/* The picture is that of the last camera, at full resolution; it is the last unless it moves. */
async function settled(moves) {
  while (sorting.loaded < info.n || sorting.busy || scheduled || stale || state.moving ||
    !moves && motion.ticking)
    await new Promise((done) => setTimeout(done, 5));
}

function attempt(step) {
  try {
    step();
  } catch (e) {
    if (!gl || !gl.isContextLost()) fail(e.message);
    throw e;
  }
}

/* Splats of an element of the page, from those on that there are up to `end`. */
function load(id, end) {
  const at = sorting.loaded, n = end - at, scene = decode(id, n);
  if (sorting.sent < end) { // else the driver lost what it had
    openSample(scene, n);
    sendPlaces(scene, at, n);
  }
  fillGpu(scene, at, n);
  sorting.loaded = end;
}

/* What comes behind the most important splats, once they are seen and the page has been read. */
function loadRest() {
  if (!firstPicture || document.readyState === "loading" || sorting.loaded === info.n) return;
  attempt(() => load("rest", info.n));
  requestSort();
}

function start() {
  const again = sorting.worker;
  if (!again) openSorter();
  sorting.loaded = 0;
  load("scene", info.packed ? info.packed.first : info.n);
  sorting.row = null;
  if (again) {
    requestSort();
    return loadRest();
  }
  openControls();
  setExposure(0);
  if (!openLink()) go(info.first);
}

canvas.addEventListener("webglcontextlost", (e) => {
  e.preventDefault();
  tell("the graphics driver stopped; the picture returns when it works again");
  canvas.style.visibility = "hidden"; // white else
});
canvas.addEventListener("webglcontextrestored", () => attempt(() => {
  tell("");
  canvas.style.visibility = "";
  openGpu();
  if (sorting.worker) start();
}));
document.addEventListener("DOMContentLoaded", () => {
  if (gpu && !sorting.worker) attempt(start); // the page is cut off
  loadRest();
});
window.viewer = { info, state, go, setCamera, setExposure, setTone, compare, hideGuesses,
  showUnseen, draw, radiance, exact, depthAt, settled, firstPicture: () => firstPicture };
attempt(() => {
  openGpu();
  warmUp();
});
