"use strict";
/* The rig of several boards on the status page: status.json tells of it in `rig`. */

function svg(name, attributes, ...children) {
  const e = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
  e.append(...children);
  return e;
}

/* Contents are replaced only when they change: readers of the screen speak what is replaced. */
function redraw(id, data, draw) {
  const key = JSON.stringify(data);
  if (redraw.keys[id] === key) return;
  redraw.keys[id] = key;
  const drawn = draw(data);
  byId(id).replaceChildren(...drawn);
  byId(id).hidden = drawn.length === 0;
}
redraw.keys = {};

const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
const milliseconds = (ms) => `${Number(ms.toPrecision(2))} ms`;

function duration(s) {
  const units = [[86400, "day"], [3600, "hour"], [60, "minute"]];
  const [size, word] = units.find(([size]) => s >= size) || [];
  return size ? plural(Math.floor(s / size), word) : "less than a minute";
}

/* ---- boards ---- */

/* Words of the states, which are classes too. */
const stateWords = { ready: "ready", waits: "not ready", away: "not there", other: "not listed" };

function boardState(m, someListed) {
  if (someListed && !m.listed) return "other";
  if (!m.online) return "away";
  return m.ready ? "ready" : "waits";
}

function boardSentence(b) {
  if (b.state === "other") return "it is not in the conductor's rig.member.N and takes no part";
  if (b.online) return b.sentence;
  return b.since_s > 0 ? `for ${duration(b.since_s)}` : "not seen yet";
}

/* Members with their states, as they are shown. */
function boardsOf(rig) {
  const members = rig.members || [], someListed = members.some((m) => m.listed);
  return members.map((m) => {
    const b = { ...m, state: boardState(m, someListed) };
    b.why = boardSentence(b);
    delete b.since_s;
    return b;
  });
}

function clockText(b) {
  if (!b.online) return "";
  return b.clock ? `\u00b1${milliseconds(b.within_ms)}, ${b.clock}` : "not known yet";
}

function boardRow(b) {
  const row = element("tr");
  row.setAttribute("role", "row");
  const add = (name, role, label, ...contents) => {
    const cell = element(name);
    cell.setAttribute("role", role);
    if (label) cell.dataset.label = label;
    cell.append(...contents);
    row.append(cell);
    return cell;
  };
  add("th", "rowheader", "", b.name).scope = "row";
  const why = b.state !== "ready" && b.why ? `: ${b.why}` : "";
  add("td", "cell", "", element("span", stateWords[b.state], `mark ${b.state}`), why);
  add("td", "cell", "cameras", b.online ? b.cameras : "");
  add("td", "cell", "free", b.online && b.free_mb >= 0 ? `${(b.free_mb / 1e3).toFixed(1)} GB` : "");
  add("td", "cell", "clock", clockText(b));
  add("td", "cell", "parts held", b.holds);
  return row;
}

function missingLines(boards) {
  const missing = boards.filter((b) => b.state === "waits" || b.state === "away");
  const lines = missing.slice(0, 5).map((b) => `${b.name} is ${stateWords[b.state]}: ${b.why}`);
  if (missing.length > 5) lines.push(`and ${plural(missing.length - 5, "more board")}`);
  return lines;
}

/* ---- takes ---- */

const phaseWords = { metering: "measures the light", recording: "is being prepared",
  shooting: "photographs", gathering: "brings the pictures here", joining: "is put together",
  dropping: "is given up", dropped: "is given up" };
const partWords = { failed: "failed", waits: "awaited", stored: "stored on the board",
  fetching: "being sent", fetched: "here", gone: "nothing left" };

/* A line for each state; failures say why. */
function partItems(parts) {
  return Object.keys(partWords).flatMap((state) => {
    const of = parts.filter((p) => p.state === state);
    const names = of.map((p) => p.why ? `${p.name} (${p.why})` : p.name);
    return of.length ? [element("li", `${of.length} ${partWords[state]}: ${names.join(", ")}`,
      state)] : [];
  });
}

function takeCard(t) {
  const card = element("div", undefined, "card"), parts = element("ul", undefined, "parts");
  const ready = t.parts.filter((p) => t.phase === "shooting" || t.phase === "metering"
    ? p.state !== "waits" : p.state === "fetched").length;
  card.append(element("h3", t.id || "new capture"));
  card.append(element("p", `${phaseWords[t.phase] || t.phase}: ` +
    `${ready} of ${plural(t.parts.length, "board")}`, "small"));
  const bar = element("progress");
  bar.max = t.parts.length || 1;
  bar.value = ready;
  bar.setAttribute("aria-label", `boards of ${t.id || "the new capture"}`);
  card.append(bar);
  for (const text of [t.reason, t.choice])
    if (text) card.append(element("p", text, "warnings"));
  parts.append(...partItems(t.parts));
  card.append(parts);
  return card;
}

/* ---- the last take: when each camera began each exposure ---- */

const STRIP = { left: 24, width: 320, row: 20 };

function stripRow(i, starts, scale) {
  const y = STRIP.row * (i + 0.5), x = (ms) => (STRIP.left + STRIP.width) / 2 + ms * scale;
  const row = svg("g", {}, svg("text", { x: 0, y: y + 4, class: "label" }, String(i + 1)));
  for (const s of starts)
    row.append(svg("line", { x1: x(s.ms), x2: x(s.ms), y1: y - 7, y2: y + 7, class: "start" },
      svg("title", {}, `${s.name} camera ${s.camera}: ${s.ms.toFixed(3)} ms`)));
  return row;
}

function startsStrip(last) {
  const starts = last.starts, within = last.within_ms || 0, middle = (STRIP.left + STRIP.width) / 2;
  const most = Math.max(within, 0.01, ...starts.flat().map((s) => Math.abs(s.ms)));
  const scale = (STRIP.width - STRIP.left - 8) / 2 / most, height = STRIP.row * starts.length;
  const picture = svg("svg", { viewBox: `0 0 ${STRIP.width} ${height + 16}`, role: "img",
    class: "strip", "aria-label": `starts of ${plural(starts.length, "exposure")}, at most ` +
      `${milliseconds(most)} from their mean` });
  picture.append(svg("rect", { x: middle - within * scale, width: 2 * within * scale, y: 0, height,
    class: "within" }));
  picture.append(...starts.map((s, i) => stripRow(i, s, scale)));
  for (const [ms, anchor] of [[-most, "start"], [0, "middle"], [most, "end"]])
    picture.append(svg("text", { x: middle + ms * scale, y: height + 12, "text-anchor": anchor,
      class: "label" }, ms ? `${ms > 0 ? "+" : ""}${milliseconds(ms)}` : "mean"));
  return picture;
}

function lastTake(last) {
  const drawn = [element("h3", "Last capture of the rig")];
  const id = last.id ? `${last.id}: ` : "";
  drawn.push(element("p", id + (last.sentence || (last.ok ? "complete" : "failed")),
    last.ok ? "small" : "warnings"));
  if (last.skew_ms && last.skew_ms.length)
    drawn.push(element("p", "First to last camera: " + last.skew_ms.map((ms, i) =>
      `${milliseconds(ms)} at exposure ${i + 1}`).join(", ") +
      (last.within_ms ? `; clocks known within ${milliseconds(last.within_ms)} (shaded)` : ""),
    "small"));
  if (last.starts && last.starts.some((s) => s.length)) drawn.push(startsStrip(last));
  return drawn;
}

/* ---- cameras from above ---- */

const MAP = { size: 320, margin: 130 }; // room for labels, at most

/* x to the right, z up; the text runs outwards, away from where the camera looks. */
function mapCamera(v, at, font) {
  const [x, y] = at(v), n = Math.hypot(v.dx, v.dz) || 1, dx = v.dx / n, dy = -v.dz / n;
  const left = dx > 0, turn = Math.atan2(left ? dy : -dy, left ? dx : -dx) * 180 / Math.PI;
  const out = left ? -8 : 8;
  return svg("g", { class: `view ${v.state}` }, svg("title", {}, v.label),
    svg("line", { x1: x, y1: y, x2: x + 1.4 * font * dx, y2: y + 1.4 * font * dy }),
    svg("circle", { cx: x, cy: y, r: 0.35 * font }),
    svg("text", { x: out, y: font * 0.35, "font-size": font, "text-anchor": left ? "end" : "start",
      transform: `translate(${x} ${y}) rotate(${turn})` }, v.label));
}

function mapOf(views) {
  if (!views.length) return [];
  const font = views.length > 24 ? 6.5 : 10;
  const longest = Math.max(...views.map((v) => v.label.length));
  const room = MAP.size - 2 * Math.min(MAP.margin, 12 + 0.55 * font * longest);
  const of = (k) => [Math.min(...views.map((v) => v[k])), Math.max(...views.map((v) => v[k]))];
  const [x0, x1] = of("x"), [z0, z1] = of("z");
  const scale = room / Math.max(x1 - x0, z1 - z0, 1e-6);
  const at = (v) => [MAP.size / 2 + (v.x - (x0 + x1) / 2) * scale,
    MAP.size / 2 - (v.z - (z0 + z1) / 2) * scale];
  const count = (state) => views.filter((v) => v.state === state).length;
  const words = Object.keys(stateWords).filter(count).map((s) => `${count(s)} ${stateWords[s]}`);
  const picture = svg("svg", { viewBox: `0 0 ${MAP.size} ${MAP.size}`, role: "img", class: "map",
    "aria-label": `${plural(views.length, "camera")} from above: ${words.join(", ")}` });
  picture.append(...views.map((v) => mapCamera(v, at, font)));
  return [element("h3", "Cameras from above"), element("p", words.join(", "), "small"), picture];
}

function viewsOf(rig, boards) {
  const states = new Map(boards.map((b) => [b.name, b.state]));
  const cameras = (name) => rig.views.filter((v) => v.name === name).length;
  return (rig.views || []).map((v) => {
    const state = states.get(v.name) || "away";
    const name = cameras(v.name) > 1 ? `${v.name} ${v.camera}` : v.name;
    return { ...v, state, label: state === "ready" ? name : `${name}, ${stateWords[state]}` };
  });
}

/* ---- all of it ---- */

const rigWords = { leads: "leads the rig", listens: "looks for another conductor",
  off: "does not reach the broker", refused: "does not lead: another conductor does",
  led: "is led", alone: "waits for a conductor" };

/* rig: NULL on a board that is alone. */
function showRig(rig) {
  byId("rig").hidden = byId("rig-sentence").hidden = !rig;
  if (!rig) return;
  const boards = boardsOf(rig);
  setText(byId("rig-name"), rig.name === "rig" ? "Rig" : `Rig ${rig.name}`);
  setText(byId("rig-state"), `${rig.board} ${rigWords[rig.state] || rig.state}` +
    (boards.length ? `, ${boards.filter((b) => b.state === "ready").length} of ` +
      `${plural(boards.filter((b) => b.state !== "other").length, "board")} ready` : ""));
  setText(byId("rig-sentence"), rig.sentence);
  byId("boards").hidden = boards.length === 0;
  redraw("boards-rows", boards, (all) => all.map(boardRow));
  redraw("rig-missing", missingLines(boards), (lines) => lines.map((t) => element("li", t)));
  redraw("rig-takes", rig.takes || [], (takes) => takes.map(takeCard));
  redraw("rig-last", rig.last || null, (last) => last ? lastTake(last) : []);
  redraw("rig-map", viewsOf(rig, boards), mapOf);
}
