"use strict";

const byId = (id) => document.getElementById(id);

function element(name, text, className) {
  const e = document.createElement(name);
  if (text !== undefined) e.textContent = text;
  if (className) e.className = className;
  return e;
}

/* Readers of the screen speak what is set, even to the same. */
function setText(e, text) {
  if (e.textContent !== text) e.textContent = text;
}

function seconds(s) {
  if (s < 1e-3) return (s * 1e6).toPrecision(3) + " us";
  return s < 1 ? (s * 1e3).toPrecision(3) + " ms" : s.toPrecision(3) + " s";
}

const percent = (x) => (100 * x).toPrecision(2) + " %";

function drawHistogram(canvas, counts) {
  const g = canvas.getContext("2d");
  const top = Math.max(1, ...counts.map((n) => Math.sqrt(n)));
  canvas.width = counts.length * 4;
  canvas.height = 48;
  counts.forEach((n, i) => {
    const h = (48 * Math.sqrt(n)) / top;
    g.fillStyle = i === counts.length - 1 ? "#c2371d" : "#1668c7";
    g.fillRect(i * 4, 48 - h, 3, h);
  });
}

/* Pictures of the cameras, which outlive their cards. */
const LIVE_MS = 2000, lives = [];

function live(i, name) {
  if (!lives[i]) {
    lives[i] = element("img", undefined, "live");
    lives[i].alt = `what ${name} sees`;
    lives[i].addEventListener("error", () => { lives[i].hidden = true; });
    lives[i].addEventListener("load", () => { lives[i].hidden = false; });
  }
  const now = Date.now();
  if (!(now - lives[i].dataset.at < LIVE_MS) && lives[i].complete) {
    lives[i].dataset.at = now;
    lives[i].src = `/live/${i}.jpg?${now}`;
  }
  return lives[i];
}

/* As the user wants it; else as the board can. */
function showsLive(s) {
  const box = byId("live");
  if (!box.dataset.set) {
    const wanted = localStorage.getItem("hdrig.live");
    box.checked = wanted ? wanted === "1" : s.live;
    box.dataset.set = "1";
  }
  return box.checked && s.state === "armed" && document.visibilityState === "visible";
}

function cameraCard(c, i, lively) {
  const card = element("div", undefined, "card");
  card.append(element("h3", c.unit || c.uri));
  card.append(element("p", `${c.width} x ${c.height} ${c.format}`, "small"));
  if (lively && c.present) card.append(live(i, c.unit || c.uri));
  const canvas = element("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "histogram of the last picture");
  drawHistogram(canvas, c.histogram);
  const axis = element("p", undefined, "axis");
  axis.append(element("span", "black"), element("span", "display value"), element("span", "full"));
  card.append(canvas, axis);
  card.append(element("p", c.present
    ? `${seconds(c.exposure_s)}, clipped ${percent(c.clipped)}, dark ${percent(c.dark)}`
    : "not there", "small"));
  return card;
}

/* Of one camera, its exposures; of many, one of each. They are small ones, which lead to the whole;
 * takes of before, and those that lost theirs, show that itself. */
function pictures(c) {
  const all = (c.images || []).map((name) => {
    const a = element("a"), img = element("img");
    a.href = `/captures/${c.id}/images/${name}`;
    img.src = `/captures/${c.id}/thumbs/${name.replace(/\.\w+$/, ".jpg")}`;
    img.addEventListener("error", () => { img.src = a.href; }, { once: true });
    img.alt = name;
    img.loading = "lazy";
    a.append(img);
    return a;
  });
  if (all.length <= 3) return all;
  const sheet = element("details", undefined, "sheet");
  sheet.append(element("summary", `${all.length} pictures, one of every camera`), ...all);
  return [sheet];
}

function captureCard(c) {
  const card = element("div", undefined, c.complete ? "card" : "card aborted");
  card.append(element("h3", c.id));
  const stops = c.stops ? `, scene ${c.stops.toFixed(1)} stops` : "";
  const cameras = `${c.cameras} camera${c.cameras === 1 ? "" : "s"}`;
  card.append(element("p", `${c.frames} frames of ${cameras}${stops}`, "small"));
  if (c.clipped !== undefined)
    card.append(element("p", `clipped at all exposures ${percent(c.clipped)}, ` +
      `dark at all ${percent(c.dark)}`, "small"));
  if (c.session) card.append(element("p", `place of session ${c.session}`, "small"));
  if (c.reason) card.append(element("p", c.reason, "small"));
  const links = element("p", undefined, "small");
  const link = (text, href) => {
    const a = element("a", text);
    a.href = href;
    links.append(a, " ");
  };
  link("manifest", `/captures/${c.id}/manifest.json`);
  if (c.result) {
    link("scene", `/results/${c.session || c.id}/view.html`);
    link("report", `/results/${c.session || c.id}/report.html`);
    link("scene.ply", `/results/${c.session || c.id}/scene.ply`);
    if (c.warnings) {
      const n = element("a", `${c.warnings} warning${c.warnings === 1 ? "" : "s"}`, "warnings");
      n.href = `/results/${c.session || c.id}/report.html`;
      links.append(n);
    }
  }
  card.append(links);
  card.append(...pictures(c));
  return card;
}

function tell(text, kept = false) { // kept: no trouble
  byId("message").textContent = text;
  byId("message").classList.toggle("kept", kept);
}

/* What has become of the press, when a take is new. */
function tellOutcome(newest) {
  const id = newest ? newest.id : "";
  if (tellOutcome.seen !== undefined && id && id !== tellOutcome.seen)
    tell(newest.complete ? `${id} is kept: ${newest.frames} frames.`
      : `${id} is not complete: ${newest.reason || "it was ended"}.`, newest.complete);
  tellOutcome.seen = id;
}

function show(s) {
  const state = byId("state");
  state.textContent = s.state;
  const kinds = { armed: "armed", lost: "fault" };
  state.className = "state " + (kinds[s.state] || "busy");
  setText(byId("sentence"), s.sentence);
  const rigBusy = s.rig && (s.rig.takes || []).some((t) =>
    t.phase === "metering" || t.phase === "recording" || t.phase === "shooting");
  const own = s.state === "metering" || s.state === "shooting" || s.state === "ready";
  const busy = own || rigBusy;
  byId("capture").disabled = s.rig ? !s.rig.ready : s.state !== "armed";
  showRig(s.rig);
  byId("cancel").hidden = !busy && !s.job.running;
  byId("session").hidden = !s.session.collect && !s.session.places;
  byId("places").textContent = s.session.line;
  byId("session-scene").disabled = byId("session-end").disabled = !s.session.places;
  byId("progress").hidden = !own;
  byId("progress").value = s.progress.wanted ? s.progress.kept / s.progress.wanted : 0;
  byId("press").textContent = s.press || "";
  const lively = showsLive(s);
  byId("cameras").replaceChildren(...s.cameras.map((c, i) => cameraCard(c, i, lively)));
  const job = s.job;
  byId("job").textContent = job.running
    ? `${job.id}: ${job.line}` + (job.waiting ? `, ${job.waiting} wait` : "")
    : job.last ? `${job.last_id}: ${job.last}. ${job.last_line}` : "none yet";
  const key = JSON.stringify(s.captures);
  if (key !== show.key) { // pictures are not loaded again for nothing
    byId("captures").replaceChildren(...s.captures.map(captureCard));
    const sheet = document.querySelector("#captures .card:first-child .sheet");
    if (sheet) sheet.open = true; // of the last one
    tellOutcome(s.captures[0]);
    show.key = key;
  }
  byId("counters").replaceChildren(...Object.entries(s.counters).map(([name, n]) => {
    const row = element("tr");
    row.append(element("td", name.replaceAll("_", " ")), element("td", n));
    return row;
  }));
}

async function refresh() {
  try {
    const r = await fetch("/status.json");
    if (r.status === 401) return void location.reload();
    show(await r.json());
    if (refresh.broken) tell("");
    refresh.broken = false;
  } catch (e) {
    byId("state").textContent = "no answer";
    byId("state").className = "state fault";
    tell("the daemon does not answer");
    byId("capture").disabled = true;
    refresh.broken = true;
  }
}

async function post(path) {
  try {
    const r = await fetch(path, { method: "POST", headers: { "X-Hdrig": "1" } });
    const answer = await r.json();
    tell(answer.ok ? "" : answer.error);
  } catch (e) {
    tell("the daemon does not answer: nothing was done");
  }
  refresh();
}

byId("live").addEventListener("change", () => {
  localStorage.setItem("hdrig.live", byId("live").checked ? "1" : "0");
  refresh();
});

byId("capture").addEventListener("click", () => post("/capture"));
byId("cancel").addEventListener("click", () => post("/cancel"));
byId("session-end").addEventListener("click", () => post("/session/end"));
byId("session-scene").addEventListener("click", () => post("/session/scene"));
refresh();
setInterval(refresh, 1000);
