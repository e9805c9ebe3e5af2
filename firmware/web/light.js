/* What is measured in the picture: histogram, readouts, regions, differences from photographs, the
 * scale of false colours, EXR. Nothing is read back while the picture moves. Stops are those of
 * luminance over 1 at the middle exposure. */

/* px, seen: of picture number `of`; from: where a drag for a region began. */
const light = { of: -1, timer: 0, pins: 0, from: null };

const luminance = (r, g, b) => 0.2126 * r + 0.7152 * g + 0.0722 * b;
const stopsOf = (L) => Math.log2(L) + info.middle;
const clamp = (v, lo, hi) => Math.max(lo, Math.min(hi, v));
const inShort = (s) => signed(s).replace(".0", "");
const inStops = (L) => L > 0 ? `${signed(stopsOf(L))} stops` : "no light";

function digits(v) {
  if (v === 0) return "0";
  return v < 1e-3 || v >= 1e4 ? v.toExponential(1) : v.toPrecision(v < 0.1 ? 2 : 3);
}

const inWords = (rgb) => `${rgb.map(digits).join(" ")}  ${inStops(luminance(...rgb))}`;

/* Pixel of the picture under a point of the window; null: outside. */
function pixelAt([clientX, clientY]) {
  const box = canvas.getBoundingClientRect();
  const x = Math.floor((clientX - box.left) / box.width * gpu.pw);
  const y = Math.floor((clientY - box.top) / box.height * gpu.ph);
  return x < 0 || y < 0 || x >= gpu.pw || y >= gpu.ph ? null : [x, y];
}

/* Of samples: luminance in order, mean of R, G, B. */
function statistics(px) {
  const n = px.length / 4, mean = [0, 0, 0], sorted = new Float32Array(n).map((v, i) => {
    const rgb = px.subarray(4 * i, 4 * i + 3);
    rgb.forEach((w, k) => { mean[k] += w / n; });
    return luminance(...rgb);
  }).sort();
  return { sorted, mean, at: (share) => sorted[Math.floor(share * (n - 1))] };
}

/* ---- histogram ---- */

/* Logit of the brightest display value; x: log2 of radiance and exposure of a colour. */
function topOf(x) {
  const { lo, scale, data } = gpu.curve;
  return Math.max(...[0, 1, 2].map((c) => { // as the shader's
    const f = (x(c) - lo) * scale, i = clamp(Math.floor(f), 0, CURVE_CELLS - 2), k = 4 * i + c;
    return data[k] + (data[k + 4] - data[k]) * (f - i);
  }));
}

const logit = (v) => Math.log(v / (1 - v));

/* log2 of the grey radiance that a display value stands for, at exposure 0. */
function curveReaches(v) {
  let a = -64, b = 64;
  for (let k = 0; k < 50; k++) {
    const x = (a + b) / 2;
    if (topOf(() => x) < logit(v)) a = x;
    else b = x;
  }
  return a;
}

/* Shares of clipped and of dark samples. */
function clippedShares() {
  const { px } = light, n = [0, 0];
  for (let i = 0; i < px.length; i += 4) {
    const top = topOf((c) => Math.log2(px[i + c] + 1e-6) + state.ev);
    n[0] += top > logit(CLIPPED);
    n[1] += top < logit(DARK);
  }
  return n.map((v) => `${(400 * v / px.length).toFixed(1)} %`);
}

/* Bars are quarter stops; dashed lines: where the curve clips, and is dark. */
function drawHistogram(sorted, lo, hi) {
  const bins = new Uint32Array(4 * (hi - lo)), step = hi - lo > 20 ? 8 : hi - lo > 9 ? 4 : 2;
  for (const L of sorted)
    if (L > 0) bins[clamp(Math.floor(4 * (stopsOf(L) - lo)), 0, bins.length - 1)]++;
  const most = Math.sqrt(Math.max(1, ...bins)), wide = 344 / bins.length;
  const x = (s) => 4 + 344 * clamp((s - lo) / (hi - lo), 0, 1);
  const label = (at, y, words) => `<text x="${clamp(at, 24, 328)}" y="${y}">${words}</text>`;
  let marks = "", bars = "";
  bins.forEach((n, i) => {
    bars += `M${4 + i * wide} 74v${-58 * Math.sqrt(n) / most}h${wide}V74`;
  });
  for (let s = Math.ceil(lo / step) * step; s <= hi; s += step)
    marks += label(x(s), 86, s ? inShort(s) : "0 stops");
  for (const [word, v] of [["dark", DARK], ["clipped", CLIPPED]]) {
    const at = x(curveReaches(v) - state.ev + info.middle);
    marks += label(at, 10, word) + `<path class="limit" d="M${at} 13V74"/>`;
  }
  byId("histogram").innerHTML = `<path d="${bars}"/>${marks}`;
}

/* Called after each picture; works when there was none for a while. */
function showLight() {
  const key = pinKey();
  layRuler();
  for (const mark of document.querySelectorAll(".pin")) mark.hidden = mark.dataset.key !== key;
  clearTimeout(light.timer);
  if (!byId("panel").hidden) light.timer = setTimeout(measure, 80);
}

function measure() {
  if (stale || state.moving || sorting.busy || !gpu.picture || gl.isContextLost()) return;
  if (light.of !== gpu.pictures) {
    light.px = radiance(0, 0, gpu.pw, gpu.ph, 1 << 16);
    light.seen = statistics(light.px);
    light.of = gpu.pictures;
  }
  const { sorted, at } = light.seen, [clipped, dark] = clippedShares();
  const hi = Math.floor(stopsOf(at(1) || 1)) + 1;
  const lo = Math.max(hi - 40, Math.floor(stopsOf(sorted.find((L) => L > 0) || 1)));
  drawHistogram(sorted, lo, hi);
  byId("spread").textContent = `${inStops(at(0))} to ${inStops(at(1))}, median ` +
    `${inStops(at(0.5))}; at ${signed(state.ev)} EV clipped ${clipped}, dark ${dark}`;
}

/* ---- readouts ---- */

const viewName = () => state.at < 0 ? "free view" : info.views[state.at].name;

/* Marks stay where the camera and the window do. */
const pinKey = () => [...state.cam.R, ...state.cam.t, state.cam.fx, canvas.clientWidth,
  canvas.clientHeight].join();

function addNote(line) {
  byId("notes").value += `${line}\n`;
  byId("noted").hidden = false;
  openLight(true);
  byId("notes").scrollTop = byId("notes").scrollHeight;
  byId("noted").scrollIntoView({ block: "nearest" });
}

/* By a point of the window. */
async function pin(at) {
  await settled();
  const pixel = pixelAt(at), box = byId("stage").getBoundingClientRect();
  if (!pixel) return;
  const mark = document.createElement("span");
  mark.className = "pin";
  mark.textContent = ++light.pins;
  mark.dataset.key = pinKey();
  mark.style = `left: ${at[0] - box.left}px; top: ${at[1] - box.top}px`;
  byId("stage").append(mark);
  addNote(`${light.pins}  ${inWords(exact(...pixel))}  ${viewName()} at ${pixel.join()}`);
}

function here() { // under the pointer, else in the middle
  const box = canvas.getBoundingClientRect();
  return state.probe || [box.left + box.width / 2, box.top + box.height / 2];
}

function clearNotes() {
  byId("notes").value = "";
  byId("noted").hidden = true;
  light.pins = 0;
  for (const mark of document.querySelectorAll(".pin")) mark.remove();
  ruler.length = 0;
  layRuler();
}

function copyNotes() { // without a permission, and from pages that are not https
  byId("notes").select();
  document.execCommand("copy");
}

/* ---- lengths ---- */

const ruler = []; // its ends in the scene, as far as they are chosen
const inLength = (v) => `${digits(v)} ${info.metres ? "m" : "scene units"}`;

/* By a point of the window: an end, after two the first one of another. */
async function measureTo(at) {
  await settled();
  const seen = seenAt(...at), { R } = state.cam;
  if (!seen) return;
  if (ruler.length > 1) ruler.length = 0;
  ruler.push(centreOf(state.cam).map((c, k) =>
    c + seen[0] * R[k] + seen[1] * R[3 + k] + seen[2] * R[6 + k]));
  layRuler();
  if (ruler.length > 1) addNote(`length ${byId("length").textContent}`);
}

/* A line between the ends, or a dot, and the distance. */
function layRuler() {
  const { R, t } = state.cam, v = fit(state.cam, canvas.clientWidth, canvas.clientHeight);
  const ends = ruler.map((m) => {
    const [x, y, z] = [0, 1, 2].map((k) => dot(row(R, k), m) + t[k]);
    return z > 0 ? [v.fx * x / z + v.cx, v.fy * y / z + v.cy] : [];
  });
  const [a, b = a] = ends, shown = a && a.length && b.length;
  byId("ruler").toggleAttribute("hidden", !shown);
  if (!shown) return;
  byId("ruler").firstElementChild.setAttribute("d", `M${a}L${b}`);
  byId("length").setAttribute("x", (a[0] + b[0]) / 2);
  byId("length").setAttribute("y", (a[1] + b[1]) / 2 - 8);
  byId("length").textContent = ruler[1] ?
    inLength(Math.hypot(...ruler[0].map((c, k) => c - ruler[1][k]))) : "";
}

/* ---- regions ---- */

async function measureRegion(from, to) {
  await settled();
  const box = canvas.getBoundingClientRect();
  const [a, b] = [from, to].map(([x, y]) => pixelAt([clamp(x, box.left, box.right - 1e-3),
    clamp(y, box.top, box.bottom - 1e-3)]));
  const [x, y] = a.map((v, k) => Math.min(v, b[k]));
  const [w, h] = a.map((v, k) => Math.abs(v - b[k]) + 1);
  const { mean, at } = statistics(radiance(x, y, w, h, 1 << 18));
  const one = (word, share) => `  ${word} ${digits(at(share))} = ${inStops(at(share))}`;
  addNote(`region ${w} x ${h} px at ${x},${y}, ${viewName()}: mean ${inWords(mean)}\n` +
    one("median", 0.5) + one("min", 0) + one("max", 1));
}

function layMarquee([x, y]) {
  const { left, top } = byId("stage").getBoundingClientRect(), [a, b] = light.from || [0, 0];
  byId("marquee").hidden = !light.from;
  byId("marquee").style = `left: ${Math.min(a, x) - left}px; top: ${Math.min(b, y) - top}px;
    width: ${Math.abs(a - x)}px; height: ${Math.abs(b - y)}px`;
}

/* Drags for a region do not reach the canvas, which would turn the scene. */
function openRegions() {
  const stage = byId("stage"), at = (e) => [e.clientX, e.clientY];
  let down = [0, 0];
  stage.addEventListener("pointerdown", (e) => {
    down = at(e);
    if (e.target !== canvas || pointers.size || !(armed("region") || e.altKey)) return;
    e.stopPropagation();
    canvas.setPointerCapture(e.pointerId);
    light.from = down;
  }, true);
  stage.addEventListener("pointermove", (e) => layMarquee(at(e)));
  for (const end of ["pointerup", "pointercancel"])
    stage.addEventListener(end, (e) => {
      const way = Math.hypot(e.clientX - down[0], e.clientY - down[1]);
      if (light.from && end === "pointerup") measureRegion(light.from, at(e));
      else if (end === "pointerup" && e.target === canvas && way < 6 && !pointers.size) tapped(e);
      light.from = null;
      layMarquee(down);
    });
}

/* However long it took: a click is not sent for a long press. */
function tapped(e) {
  const at = [e.clientX, e.clientY];
  if (e.button) return;
  if (armed("pin")) pin(at);
  if (armed("measure")) measureTo(at);
}

/* ---- false colours, differences ---- */

/* The scale of the false colours, in stops and in radiance at this exposure. */
function showLegend() {
  const colours = [], labels = [];
  for (let i = 0; i <= 32; i++) {
    const c = [0, 1, 2].map((k) => TURBO.reduceRight((sum, p) => sum * i / 32 + p[k], 0));
    colours.push(`rgb(${c.map((v) => Math.round(255 * clamp(v, 0, 1)))})`);
  }
  for (let i = -2; i <= 2; i++) {
    const s = state.middle + state.reach * i / 2, label = document.createElement("span");
    label.textContent = `${inShort(s)}${i ? "" : " stops"}\n` +
      digits(2 ** (s - state.ev - info.middle));
    labels.push(label);
  }
  byId("legend").hidden = byId("range").hidden = state.tone !== 2;
  byId("scale").style.background = `linear-gradient(90deg, ${colours})`;
  byId("labels").replaceChildren(...labels);
  byId("middle").value = state.middle;
  byId("width").value = 2 * state.reach;
}

function setRange(middle, width) {
  state.middle = middle;
  state.reach = width / 2;
  showLegend();
  invalidate(false);
}

function showClipping(on) {
  state.clip = on;
  byId("clip").ariaPressed = on;
  invalidate(false);
}

/* Texture of a photograph, to show the difference from; null until it is there. */
function photoTexture(photo) {
  const mine = gpu;
  if (state.tone !== 3 || !photo) return null;
  if (gpu.photoOf === photo) return gpu.photo;
  const img = new Image();
  if (gpu.photo) gl.deleteTexture(gpu.photo);
  gpu.photoOf = photo;
  gpu.photo = null;
  img.onload = () => {
    if (gpu !== mine || gpu.photoOf !== photo) return;
    gpu.photo = texture(gl.RGBA8, img.naturalWidth, img.naturalHeight);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, gl.RGBA, gl.UNSIGNED_BYTE, img);
    for (const key of ["MIN", "MAG"])
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}_FILTER`], gl.LINEAR);
    invalidate(false);
  };
  img.src = photo.src;
  return null;
}

/* ---- files ---- */

/* Scan lines of float B, G, R, not compressed; px: R, G, B, any, from the top. */
function exrFile(w, h, px) {
  const bytes = (array) => [...new Uint8Array(array.buffer)];
  const text = (s) => [...`${s}\0`].map((c) => c.charCodeAt(0));
  const ints = (...v) => bytes(new Int32Array(v)), floats = (...v) => bytes(new Float32Array(v));
  const box = ints(0, 0, w - 1, h - 1), plane = ints(2, 0, 1, 1); // float, at each pixel
  const head = [...ints(20000630, 2), ...[
    ["channels", "chlist", [..."BGR"].flatMap((c) => [...text(c), ...plane]).concat(0)],
    ["compression", "compression", [0]], ["dataWindow", "box2i", box],
    ["displayWindow", "box2i", box], ["lineOrder", "lineOrder", [0]],
    ["pixelAspectRatio", "float", floats(1)], ["screenWindowCenter", "v2f", floats(0, 0)],
    ["screenWindowWidth", "float", floats(1)],
  ].flatMap(([name, type, v]) => [...text(name), ...text(type), ...ints(v.length), ...v]), 0];
  const line = 8 + 12 * w, first = head.length + 8 * h;
  const out = new Uint8Array(first + h * line), view = new DataView(out.buffer);
  out.set(head);
  for (let y = 0, at = first; y < h; y++, at += line) {
    view.setUint32(head.length + 8 * y, at, true);
    view.setInt32(at, y, true);
    view.setInt32(at + 4, 12 * w, true);
    for (let k = 0; k < 3 * w; k++) {
      const pixel = y * w + k % w, colour = 2 - Math.floor(k / w);
      view.setFloat32(at + 8 + 4 * k, px[4 * pixel + colour], true);
    }
  }
  return out;
}

async function saveExr() {
  await settled();
  const a = document.createElement("a"), { pw, ph } = gpu;
  a.href = URL.createObjectURL(new Blob([exrFile(pw, ph, radiance(0, 0, pw, ph))]));
  a.download = `${document.title}.exr`;
  a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 60000);
}

/* ---- the panel ---- */

function openLight(on) {
  byId("panel").hidden = !on;
  byId("light").ariaExpanded = on;
  showLight();
}

const armed = (id) => byId(id).ariaPressed === "true";

function arm(which) { // what clicks and drags do: one at a time
  const on = !armed(which);
  for (const id of ["pin", "measure", "region"]) byId(id).ariaPressed = on && id === which;
}

function openLightTools() {
  const actions = { light: () => openLight(byId("panel").hidden),
    clip: () => showClipping(!state.clip), pin: () => arm("pin"),
    measure: () => arm("measure"), region: () => arm("region"),
    copy: copyNotes, clear: clearNotes, exr: saveExr };
  for (const [id, action] of Object.entries(actions)) byId(id).addEventListener("click", action);
  for (const id of ["middle", "width"])
    byId(id).addEventListener("input", () => setRange(+byId("middle").value, +byId("width").value));
  openRegions();
  byId("tone").options[3].disabled = !info.views.some((v) => v.photos);
}
