"use strict";

const read = (id) => JSON.parse(document.getElementById(id).textContent);
const report = read("data"), pictures = read("pictures");
const inputs = report.inputs || [], exposures = report.exposures || [];

// ---- words and elements ----

const SVG = "http://www.w3.org/2000/svg";
const SVG_NAMES = new Set(["svg", "path", "line", "rect", "circle", "text", "title", "g"]);

// element("p", {class: "small"}, child, ...): text is never read as HTML
function element(name, attributes = {}, ...children) {
  const e = SVG_NAMES.has(name) ? document.createElementNS(SVG, name)
    : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) e.setAttribute(key, value);
  e.append(...children.filter((c) => c !== null && c !== undefined));
  return e;
}

const known = (v) => typeof v === "number";
const fixed = (v, digits) => known(v) ? v.toFixed(digits).replace("-", "\u2212") : "not known";
const db = (v) => known(v) ? fixed(v, 2) + " dB" : "not known";
const share = (v) => !known(v) ? "not known"
  : v > 0 && v < 0.0005 ? "< 0.1 %" : fixed(100 * v, 1) + " %";
const count = (v) => v.toLocaleString("en");
const seconds = (v) => v < 0.1 ? fixed(1000 * v, 0) + " ms" : fixed(v, v < 100 ? 1 : 0) + " s";
const signed = (v) => v >= 0.05 ? "+" + fixed(v, 1) : v > -0.05 ? "0.0" : fixed(v, 1);
const stops = (v) => signed(v) + " stops";
const plural = (n, word) => `${count(n)} ${word}${n === 1 ? "" : "s"}`;

// in the unit of who gave it
function exposureTime(log2) {
  const t = 2 ** log2;
  return t > 0.3 ? String(Number(t.toPrecision(3))) : `1/${Math.round(1 / t)}`;
}

// A figure of report.json under its path, so that scripts find it.
const figure = (path, text) => element("span", { "data-key": path }, text);

// On a telephone a section opens at its title.
const narrow = innerWidth < 600;

function section(id, title, ...children) {
  const part = element("details", {}, element("summary", {}, element("h2", {}, title)),
    ...children);
  part.open = !narrow || id === "verdict" || id === "warnings";
  document.getElementById("sections").append(element("section", { id }, part));
}

// On paper everything is open.
function openAll() {
  for (const e of document.querySelectorAll("details")) e.open = true;
}

function table(head, rows) {
  const cell = (name) => (v, i) => element(name, i ? { class: "n" } : {}, v);
  const reach = { class: "scroll", tabindex: 0, role: "group", "aria-label": head.join(", ") };
  return element("div", reach, element("table", {},
    element("tr", {}, ...head.map(cell("th"))),
    ...rows.map((r) => element("tr", {}, ...r.map(cell("td"))))));
}

function tile(value, what) {
  return element("div", { class: "tile" }, element("b", {}, value), element("span", {}, what));
}

function svg(width, height, ...children) {
  return element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img" }, ...children);
}

// px: words in charts stay legible
const chartWidth = Math.max(300, Math.min(640, innerWidth - 40));

const line = (x1, y1, x2, y2, name = "axis") => element("line", { x1, y1, x2, y2, class: name });
const label = (x, y, text, anchor = "middle") =>
  element("text", { x, y, "text-anchor": anchor }, text);

// Title of a vertical axis, read from below.
const upright = (x, y, text) => element("text",
  { x, y, "text-anchor": "middle", transform: `rotate(-90 ${x} ${y})` }, text);

// Least whole step whose marks have 26 px each.
const stepOf = (range, px) => [1, 2, 4, 5, 10, 20, 50].find((s) => s * px >= 26 * range) || 100;

function polyline(points, attributes) {
  const d = points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(2)} ${y.toFixed(2)}`).join("");
  return element("path", { d, ...attributes });
}

// ---- head ----

function head() {
  const quality = report.quality || {};
  document.getElementById("summary").append(
    `${plural(report.views, "view")} of ${report.size[0]} x ${report.size[1]} px`,
    exposures.length ? ` at ${plural(exposures.length, "exposure")}` : "",
    `, modelled by ${plural(report.gaussians, "splat")}. `,
    report.viewer ? element("a", { href: report.viewer }, "Look at the scene") : "");
  const range = Math.max(...exposures.map((e) => e.radiance_stops[1])) -
    Math.min(...exposures.map((e) => e.radiance_stops[0]));
  const tiles = [
    known(quality.ldr_input_psnr) &&
      tile(figure("quality.ldr_input_psnr", db(quality.ldr_input_psnr)),
        "likeness to its photographs"),
    known(quality.held_out_psnr) &&
      tile(figure("quality.held_out_psnr", db(quality.held_out_psnr)),
        "likeness where it was not trained"),
    report.ldr && tile(figure("ldr.psnr", db(report.ldr.psnr)), "likeness on views held back"),
    exposures.length && tile(fixed(range, 1), "stops of radiance well exposed"),
    tile(figure("gaussians", count(report.gaussians)), "splats"),
    tile(figure("seconds.total", seconds(report.seconds.total)), "total time"),
    tile(figure("peak_rss_mb", `${fixed(report.peak_rss_mb, 0)} MB`), "peak memory"),
  ];
  document.getElementById("figures").append(...tiles.filter(Boolean));
  if (known(quality.ldr_input_psnr) || report.ldr)
    document.getElementById("hint").append("Likeness in dB: 20 is rough, 30 good, at 40 the eye " +
      "hardly tells scene from photograph.");
}

function warnings() {
  const list = report.warnings;
  section("warnings", "Warnings", list.length
    ? element("ul", { class: "warnings" }, ...list.map((w) => element("li", {}, w)))
    : element("p", {}, "None."));
}

// ---- the scene in short ----

const GOOD_DB = 28, USABLE_DB = 22, GUESSES_MANY = 0.25, WORSE_DB = 4, ADVICE_MOST = 3;

// What speaks most for the scene: views held back, squares held back, its own photographs.
function likeness() {
  const quality = report.quality || {};
  if (report.ldr) return ["ldr.psnr", report.ldr.psnr, "to photographs that were held back"];
  return known(quality.held_out_psnr)
    ? ["quality.held_out_psnr", quality.held_out_psnr,
      "to parts of photographs that were held back"]
    : ["quality.ldr_input_psnr", quality.ldr_input_psnr,
      "to its photographs; none was held back, so other directions may be worse"];
}

function isItGood() {
  const [path, v, what] = likeness(), guesses = report.confidence && report.confidence.guesses;
  if (!known(v)) return element("p", {}, "How good it is was not measured.");
  const unsure = known(guesses) && guesses > GUESSES_MANY;
  const words = v >= GOOD_DB ? (unsure ? "Good where it is known" : "Good")
    : v >= USABLE_DB ? "Usable" : "Rough";
  const e = element("p", {}, element("strong", {}, `${words}.`), " Its likeness is ",
    figure(path, db(v)), ` ${what}.`);
  if (known(guesses))
    e.append(` Photographs prove ${share(1 - guesses)} of what is seen, the rest is a guess.`);
  return e;
}

// Views that are much worse than the others, and those that have no place.
function whereNot() {
  const measured = inputs.filter((v) => known(v.psnr)).sort((a, b) => a.psnr - b.psnr);
  const middle = measured.length ? measured[measured.length >> 1].psnr : 0;
  const worse = measured.filter((v) => v.psnr < middle - WORSE_DB).map((v) => v.name);
  const out = report.warnings.filter((w) => w.includes(" is left out"))
    .map((w) => w.split(" is left out")[0]);
  const names = (list) => list.slice(0, 3).join(", ") +
    (list.length > 3 ? ` and ${list.length - 3} more` : "");
  const words = [];
  if (worse.length) words.push(`Much worse than the others: ${names(worse)}.`);
  if (out.length) words.push(`Without a place in the scene: ${names(out)}.`);
  return element("p", {}, words.join(" ") || "No photograph stands out as worse than the others.");
}

// Warnings end with what would help, behind a semicolon; the same advice counts once.
function nextTime() {
  const capital = (t) => t[0].toUpperCase() + t.slice(1);
  const told = new Map();
  for (const w of report.warnings.filter((t) => t.includes("; "))) {
    const advice = w.slice(w.lastIndexOf("; ") + 2);
    told.set(advice, (told.get(advice) || 0) + 1);
  }
  const list = [...told].sort((a, b) => b[1] - a[1]).slice(0, ADVICE_MOST)
    .map(([advice, n]) => `${capital(advice)}${n > 1 ? ` (${n} photographs)` : ""}.`);
  const more = oneMore();
  if (more) list.push(more);
  return list.length ? element("ul", {}, ...list.map((t) => element("li", {}, t)))
    : element("p", {}, "Nothing: more photographs would hardly change it.");
}

function verdict() {
  const question = (t) => element("h3", {}, t);
  section("verdict", "In short", question("Is it good?"), isItGood(),
    question("Where is it not?"), whereNot(), question("What would help next time?"), nextTime());
}

// ---- photographs ----

function histogram(h) {
  const bins = h.red.length;
  const top = Math.sqrt(Math.max(1, ...h.red, ...h.green, ...h.blue));
  const area = (colour) => {
    const points = h[colour].flatMap((n, i) => {
      const y = 24 - 24 * Math.sqrt(n) / top;
      return [[i, y], [i + 1, y]];
    });
    return polyline([[0, 24], ...points, [bins, 24]], { class: `fill-${colour}` });
  };
  const e = svg(bins, 24, area("red"), area("green"), area("blue"));
  e.setAttribute("preserveAspectRatio", "none");
  e.setAttribute("class", "histogram");
  e.setAttribute("aria-label", "histogram of red, green and blue, dark left, bright right");
  return e;
}

function picture(i, name, what) {
  if (!pictures[i]) return null;
  return element("img", { class: name, src: pictures[i], alt: `${inputs[i].name}: ${what}` });
}

// Photographs of one place have one camera and one number.
const number = (v) => String(v.place + 1);
const title = (v) => element("h3", {}, element("small", {}, number(v)), v.name);

// Share per colour of what lies in `bins` of the histogram.
function perColour(h, bins) {
  const of = (counts) => {
    const all = counts.reduce((a, b) => a + b, 0), some = counts.slice(...bins);
    return fixed(100 * some.reduce((a, b) => a + b, 0) / all, 1);
  };
  return ["red", "green", "blue"].map((c) =>
    element("span", { class: `text-${c}`, title: c }, `${c[0].toUpperCase()} ${of(h[c])}`));
}

// The first cards, the rest behind a click.
function cards(list, first, name = "cards") {
  const some = (part) => element("div", { class: name }, ...part);
  const rest = list.slice(first);
  return rest.length < 4 ? [some(list)] : [some(list.slice(0, first)),
    element("details", {}, element("summary", {}, `${rest.length} more`), some(rest))];
}

function photographs() {
  const order = inputs.map((v, i) => [v, i]).sort(([a], [b]) => a.name < b.name ? -1 : 1);
  const card = ([v, i]) => element("article", { class: "card" },
    picture(i, "thumb", "photograph"),
    title(v),
    element("p", { class: "small" }, figure(`inputs.${i}.stops`, stops(v.stops)), ", ",
      exposureTime(v.exposure_log2)),
    histogram(v.histogram),
    element("div", { class: "shares" },
      "clipped", figure(`inputs.${i}.clipped`, share(v.clipped)),
      element("small", {}, ...perColour(v.histogram, [-1])),
      "dark", figure(`inputs.${i}.dark`, share(v.dark)),
      element("small", {}, ...perColour(v.histogram, [0, 2])),
      "only here", figure(`inputs.${i}.alone`, share(v.alone))));
  section("photographs", "Photographs",
    element("p", { class: "small soft" }, "The number before a name is that of its camera below. " +
      "Exposure: stops from the middle one, then as given. Clipped and dark: share of pixels " +
      "whose brightest colour has a display value of 252 or more, or below 8; beneath, the " +
      "shares of red, green and blue. Only here: well exposed pixels that would be clipped or " +
      "dark at every other exposure."),
    ...cards(order.map(card), 24));
}

function exposureChart() {
  const from = Math.floor(Math.min(...exposures.map((e) => e.radiance_stops[0])));
  const to = Math.ceil(Math.max(...exposures.map((e) => e.radiance_stops[1])));
  const left = 66, width = chartWidth, row = 24, bottom = exposures.length * row;
  const x = (s) => left + (s - from) / Math.max(1, to - from) * (width - left - 10);
  const step = stepOf(to - from, width - left), marks = [];
  for (let s = Math.ceil(from / step) * step; s <= to; s += step)
    marks.push(line(x(s), 0, x(s), bottom), label(x(s), bottom + 14, fixed(s, 0)));
  const bars = exposures.map((e, i) => {
    const [a, b] = e.radiance_stops;
    return element("g", {},
      element("rect",
        { class: "bar", x: x(a), y: i * row + 5, width: x(b) - x(a), height: row - 10, rx: 3 }),
      label(left - 8, i * row + 16, signed(e.stops), "end"));
  });
  const chart = svg(width, bottom + 38, ...marks, ...bars,
    label((left + width) / 2, bottom + 32, "radiance, stops from half of full scale"),
    upright(12, bottom / 2, exposures.length > 3 ? "exposure, stops" : "stops"));
  chart.setAttribute("class", "chart");
  chart.setAttribute("aria-label", "well exposed radiance of each exposure");
  return chart;
}

function overlap() {
  if (exposures.length < 2)
    return "There is one exposure: radiance outside its range is unknown.";
  const steps = exposures.slice(1).map((e, i) =>
    exposures[i].radiance_stops[0] - e.radiance_stops[1]); // above 0: a gap
  const worst = Math.max(...steps);
  return worst > 0
    ? `Between two neighbours ${fixed(worst, 1)} stops are well exposed in neither.`
    : `Neighbours have ${fixed(-worst, 1)} stops or more in common, which connects them.`;
}

function contributions() {
  const rows = exposures.map((e, i) => [
    signed(e.stops), String(e.views),
    figure(`exposures.${i}.clipped`, share(e.clipped)),
    figure(`exposures.${i}.dark`, share(e.dark)),
    figure(`exposures.${i}.alone`, share(e.alone)),
    `${fixed(e.radiance_stops[0], 1)} to ${fixed(e.radiance_stops[1], 1)}`]);
  section("exposures", "What each exposure contributed",
    element("p", {}, overlap()),
    exposureChart(),
    element("p", { class: "small soft" }, "Bars: radiance that is well exposed, in stops " +
      "from half of full scale at the middle exposure."),
    table(["stops", "photos", "clipped", "dark", "only here", "radiance"], rows));
}

// ---- cameras ----

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const times = (a, s) => a.map((v) => v * s);
const unit = (a) => times(a, 1 / (Math.sqrt(dot(a, a)) || 1));
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const sum = (list) => list.reduce((a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]], [0, 0, 0]);

// Axes of the drawing: right, up and forward of the cameras together.
function frame(cameras) {
  const up = unit(sum(cameras.map((c) => c.up)));
  let ahead = sum(cameras.map((c) => c.forward));
  ahead = minus(ahead, times(up, dot(ahead, up)));
  if (dot(ahead, ahead) < 1e-6) { // they look all around
    ahead = cameras[0].forward;
    ahead = minus(ahead, times(up, dot(ahead, up)));
  }
  ahead = unit(ahead);
  return { right: cross(ahead, up), up, ahead };
}

// extent: that is drawn as wide as possible
function plan(cameras, extent, across, upward, caption) {
  const size = 300, edge = 36;
  const place = cameras.map((c) => [dot(c.centre, across), -dot(c.centre, upward)]);
  const low = [0, 1].map((k) => Math.min(...place.map((p) => p[k])));
  const high = [0, 1].map((k) => Math.max(...place.map((p) => p[k])));
  const scale = (size - 2 * edge) / extent, height = (high[1] - low[1]) * scale + 2 * edge;
  const at = (p) => [size, height].map((side, k) =>
    side / 2 + (p[k] - (low[k] + high[k]) / 2) * scale);
  const taken = []; // a number that would lie on another is left out; its camera has a title
  const numberAt = (x, y, text) => {
    if (taken.some(([u, v]) => Math.abs(u - x) < 8 * text.length + 4 && Math.abs(v - y) < 12))
      return null;
    taken.push([x, y]);
    return label(x, y, text);
  };
  const draw = (c, i) => {
    const [x, y] = at(place[i]), reach = 30, half = Math.tan(c.fov_deg * Math.PI / 360);
    const flat = (v) => [dot(v, across), -dot(v, upward)];
    const f = flat(c.forward), s = flat(cross(c.forward, c.up)), u = flat(c.up);
    const corner = (a, b) => [x + reach * (f[0] + half * (a * s[0] + b * u[0])),
      y + reach * (f[1] + half * (a * s[1] + b * u[1]))];
    const cone = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    return element("g", {}, element("title", {}, c.name),
      polyline([...cone, cone[0]], { class: "view" }),
      ...cone.map((p) => line(x, y, p[0], p[1], "view")),
      element("circle", { class: "dot", cx: x, cy: y, r: 2.5 }),
      numberAt(x - 9 * f[0], y - 9 * f[1] + 4, c.number));
  };
  const drawing = svg(size, height, ...cameras.map(draw));
  drawing.setAttribute("aria-label", caption);
  return element("figure", { class: "card" }, drawing, element("figcaption", {}, caption));
}

function cameraWords() {
  const c = report.cameras;
  if (!c)
    return element("p", {}, report.network ? "Given with the photographs, or found by the network."
      : "test_views" in report ? "Read from the scene." : "Given with the photographs.");
  const start = c.start_was_network ? "the network's cameras"
    : "points that the photographs have in common";
  return element("p", {}, `Found from ${start}: `,
    figure("cameras.points_agree", count(c.points_agree)), " of ",
    figure("cameras.points_seen", count(c.points_seen)), " observations agree, within ",
    figure("cameras.rms_px", `${fixed(c.rms_px, 2)} px`), " (root mean square). Confidence ",
    figure("cameras.confidence", fixed(c.confidence, 2)),
    " of 1; below 0.1 they are a guess. Views that are tied to the others: ",
    figure("cameras.views_placed", String(c.views_placed)), ".");
}

function cameras() {
  const all = [...new Map(inputs.map((v) => [v.place, v])).values()]
    .map((v) => ({ ...v.camera, name: v.name, number: number(v) }));
  const { right, up, ahead } = frame(all);
  const extent = Math.max(1e-9, ...[right, up, ahead].map((axis) => {
    const along = all.map((c) => dot(c.centre, axis));
    return Math.max(...along) - Math.min(...along);
  }));
  const focal = all.map((c) => c.focal_px), angle = all.map((c) => c.fov_deg);
  const span = (list, digits) => {
    const [a, b] = [Math.min(...list), Math.max(...list)].map((v) => fixed(v, digits));
    return a === b ? a : `${a} to ${b}`;
  };
  section("cameras", "Cameras", cameraWords(),
    element("p", {}, `Focal length ${span(focal, 1)} px at ${report.size[0]} px, ` +
      `${span(angle, 1)} degrees across.`),
    ...report.warnings.filter((w) => w.includes(" is left out")).map((w) => element("p", {}, w)),
    element("div", { class: "plans" },
      plan(all, extent, right, ahead, "from above: cameras face the top of the page"),
      plan(all, extent, ahead, up, "from the side: cameras face the right")));
}

// ---- tone curve ----

// With what its number means: core/photo/response_family.h.
const familyName = ({ name, parameter }) => ({
  linear: "linear (no curve)",
  sRGB: "sRGB (standard screen)",
  gamma: `power curve, gamma ${parameter}`,
  filmic: `like film, white at ${2 ** (2 * parameter - 1)} times full scale`,
  AgX: `AgX (soft, keeps colours), ${parameter} stops`,
  log: `logarithmic, ${parameter} stops`,
}[name] || name);

function toneChart(tone) {
  const left = 52, width = chartWidth, height = 0.35 * width + 98, bottom = height - 44;
  const curves = [tone.red, tone.green, tone.blue];
  const inside = tone.stops.filter((s, i) => curves.some((c) => c[i] > 0.004 && c[i] < 0.996));
  const from = Math.floor(Math.min(-4, ...inside)), to = Math.ceil(Math.max(3, ...inside));
  const x = (s) => left + (s - from) / (to - from) * (width - left - 10);
  const y = (v) => bottom - v * (bottom - 8);
  const draw = (values, name) => polyline(
    tone.stops.map((s, i) => [s, values[i]]).filter(([s, v]) => known(v) && s >= from && s <= to)
      .map(([s, v]) => [x(s), y(v)]), { class: name });
  const marks = [];
  const step = stepOf(to - from, width - left);
  for (let s = Math.ceil(from / step) * step; s <= to; s += step)
    marks.push(line(x(s), y(0), x(s), y(1)), label(x(s), bottom + 15, fixed(s, 0)));
  for (const v of [0, 0.25, 0.5, 0.75, 1])
    marks.push(line(left, y(v), width - 10, y(v)),
      label(left - 6, y(v) + 4, String(v * 100), "end"));
  const chart = svg(width, height, ...marks,
    ...tone.families.map((f) =>
      draw(f.display, f.name === tone.nearest ? "family near" : "family")),
    draw(tone.red, "curve red"), draw(tone.green, "curve green"), draw(tone.blue, "curve blue"),
    label((left + width) / 2, height - 8, "light at the middle exposure, stops"),
    upright(12, (y(0) + y(1)) / 2, "display value, %"),
    ...curves.map((values, c) => { // each letter elsewhere: curves may be one upon another
      const i = values.findIndex((v) => v > 0.3 + 0.2 * c);
      return i < 0 ? null : label(x(tone.stops[i]) - 8, y(values[i]), "RGB"[c]);
    }));
  chart.setAttribute("class", "chart");
  chart.setAttribute("aria-label", "display value over exposure: red, green, blue, known curves");
  return chart;
}

function toneCurve() {
  const tone = report.tone, near = tone.families.find((f) => f.name === tone.nearest);
  const order = tone.families.map((f, i) => i)
    .sort((a, b) => tone.families[a].rms - tone.families[b].rms);
  const rows = order.map((i) => [familyName(tone.families[i]), figure(`tone.families.${i}.rms`,
    known(tone.families[i].rms) ? `${fixed(100 * tone.families[i].rms, 1)} %` : "not known")]);
  section("tone", "Tone curve",
    element("p", {}, near
      ? `Nearest known curve: ${familyName(near)}, ${fixed(100 * near.rms, 1)} % of full scale ` +
        "away on average."
      : "The curve is like no known one: it does not lead from black to white."),
    toneChart(tone),
    element("p", { class: "small soft" }, "Display value in percent over exposure in stops, as " +
      "the scene has it in red, green and blue. Dashed: known curves, each moved to where it " +
      "fits best; the nearest one in blue."),
    table(["known curve", "mean distance"], rows));
}

// ---- quality ----

// What one more photograph would prove.
function oneMore() {
  const a = report.suggested_photograph;
  if (!a) return "";
  const where = { left: "further to the left", right: "further to the right", above: "higher",
    below: "lower" }[a.direction];
  return `One more photograph would help most ${a.degrees} degrees ${where} than ` +
    `${a.near}, of the same things.`;
}

function advice() {
  const c = report.confidence;
  return c && element("p", {}, figure("confidence.guesses", share(c.guesses)),
    " of the pixels are guesses. ",
    oneMore() || "One more photograph near these would hardly prove more.");
}

function leftOut(i) {
  const part = (key, why) => known(inputs[i][key]) &&
    [", ", figure(`inputs.${i}.${key}`, share(inputs[i][key])), why];
  return [part("masked", " masked"), part("moved", " left out, the others do not show it")]
    .flatMap((p) => p || []);
}

function residuals() {
  const order = inputs.map((v, i) => i).filter((i) => known(inputs[i].psnr))
    .sort((a, b) => inputs[a].psnr - inputs[b].psnr);
  if (!order.length) return;
  const card = (i) => element("article", { class: "card" },
    picture(i, "strip", "photograph, scene, distance, confidence"),
    element("div", { class: "four soft" }, ...["photograph", "scene", "distance", "confidence"]
      .map((t) => element("span", {}, t))),
    title(inputs[i]),
    element("p", { class: "small" }, figure(`inputs.${i}.psnr`, db(inputs[i].psnr)), " at ",
      stops(inputs[i].stops), ...leftOut(i)));
  const quality = report.quality;
  section("residuals", "Scene against photographs, worst first",
    element("p", {}, "Mean ", db(quality.ldr_input_psnr), ". ", known(quality.held_out_psnr)
      ? "On squares held back from refinement: " + db(quality.held_out_psnr_start) +
        ` at the start, ${db(quality.held_out_psnr)} at the end.`
      : "Nothing was held out: there was no refinement."),
    element("p", { class: "small soft" }, "Each view at its own exposure. Distance: black is " +
      "no difference, white a quarter of full scale or more, striped where the photograph was " +
      "left out. Confidence: black is a guess, white is proven by photographs that see it from " +
      "different places."),
    advice(),
    ...cards(order.map(card), 12, "cards wide"));
}

function measured() {
  if (!report.ldr && !report.hdr) return;
  const row = (name, key) => report[key] &&
    [name, figure(`${key}.psnr`, db(report[key].psnr)),
      figure(`${key}.ssim`, fixed(report[key].ssim, 4)), String(report[key].images)];
  const rows = [row("photographs", "ldr"), row("radiance (mu-law, as in papers)", "hdr"),
    row("photographs at exposures of the inputs", "ldr_seen_exposures"),
    row("photographs at other exposures", "ldr_unseen_exposures"),
    row("nearest input view, for comparison", "baseline_nearest"),
    ...(report.per_exposure || []).map((e) =>
      [`photographs at exposure ${e.exposure}`, db(e.psnr), fixed(e.ssim, 4), ""])];
  const p = report.pose;
  const list = [...(report.pictures || [])].sort((a, b) => a.psnr - b.psnr);
  section("measured", "Measured on views that were held back",
    table(["against", "PSNR", "SSIM", "pictures"], rows.filter(Boolean)),
    known(report.hdr_stops) ? element("p", {}, "Radiance is ",
      figure("hdr_stops", `${fixed(report.hdr_stops, 2)} stops`),
      " off (root mean square).") : null,
    list.length > 1 ? element("details", {},
      element("summary", {}, `Every picture, worst first: ${list[0].name}`),
      table(["picture", "exposure", "PSNR", "SSIM"], list.map((v) =>
        [v.name, String(v.exposure), db(v.psnr), fixed(v.ssim, 4)]))) : null,
    p ? element("p", {}, `Cameras: median error ${fixed(p.rot_deg_median, 2)} degrees, ` +
      `${share(p.trans_rel_median)} of their spread.`) : null);
}

function modelled() {
  const words = [...(report.modelled || [])];
  if (!("refine_steps" in report))
    words.push("The scene was read from a file: its own report tells how it was made.");
  else if (report.refine_steps === 0)
    words.push(report.network ? "The network's single pass, no refinement."
      : "Gaussians from stereo, no refinement.");
  else
    words.push(`${plural(report.refine_steps, "step")} of refinement` +
      (report.refine_stopped_early ? ": it stopped early, as more did not help." : "."));
  words.push(`Colours ` +
    (report.sh_degree
      ? `change with the direction (spherical harmonics of degree ${report.sh_degree}).`
      : "are the same from every direction."));
  section("modelled", "What was modelled, and why",
    element("ul", {}, ...words.map((w) => element("li", {}, w))));
}

// ---- cost ----

const stageWords = {
  preprocess: "photographs read", response: "tone curve found", cameras: "cameras found",
  sweep: "depth by stereo", seed: "first splats", backbone: "network: what is seen",
  heads: "network: cameras and depth", appearance: "network: colours", voxel: "splats merged",
  refine: "splats refined", confidence: "what is proven", render: "views drawn",
  write: "files written", measure: "measured",
};

function cost() {
  const { total, ...stages } = report.seconds;
  const longest = Math.max(...Object.values(stages), 1e-9);
  const rows = Object.entries(stages).flatMap(([name, s]) => {
    const bar = element("i");
    bar.style.width = `${100 * s / longest}%`;
    return [element("span", {}, stageWords[name] || name), bar,
      figure(`seconds.${name}`, seconds(s))];
  });
  section("cost", "Time and memory",
    element("div", { class: "times small" }, ...rows),
    element("p", { class: "small soft" }, `${seconds(total)} in all on ` +
      `${plural(report.threads, "thread")}. Memory at most ${fixed(report.peak_rss_mb, 0)} MB; ` +
      `planned were ${fixed(report.keep_peak_mb, 0)} MB for results and ` +
      `${fixed(report.tmp_peak_mb, 0)} MB for the work.`));
}

head();
verdict();
warnings();
if (inputs.length) {
  photographs();
  contributions();
  cameras();
}
toneCurve();
residuals();
measured();
modelled();
cost();
addEventListener("beforeprint", openAll);
