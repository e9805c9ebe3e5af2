/* What status.json says of a rig of n boards, put into the daemon's answers by page_rig.sh. */
function boardOf(i) {
  const away = i % 9 === 4, waits = i % 7 === 3;
  return { name: `board-${String(i + 1).padStart(2, "0")}`, listed: true, online: !away,
    ready: !away && !waits, sentence: waits ? "the disk has 120 MB left, store.reserve_mb is 512"
      : "ready to capture", version: "0.5.0", cameras: 1, free_mb: 12000 + 37 * i,
    clock: i % 5 ? "exchange" : "kernel", within_ms: 0.1 + 0.013 * i, holds: i % 3 ? 0 : 2,
    since_s: 754.5 };
}

function rigOf(n) {
  const members = Array.from({ length: n }, (_, i) => boardOf(i));
  const partStates = ["waits", "stored", "fetching", "fetched", "failed"];
  const parts = members.map((m, i) => ({ name: m.name, state: partStates[i % 5],
    why: i % 5 === 4 ? "the camera was lost" : "" }));
  const starts = [0, 1, 2].map((k) => members.map((m, i) => ({ name: m.name, camera: 0,
    ms: Math.sin(7 * i + k) * 0.7 })));
  const views = members.map((m, i) => {
    const a = 2 * Math.PI * i / n;
    return { name: m.name, camera: 0, x: 2 * Math.sin(a), z: -2 * Math.cos(a), dx: -Math.sin(a),
      dz: Math.cos(a) };
  });
  return { role: "conductor", name: "rig", board: "board-01", state: "leads", members, views,
    sentence: "board-05 is not there since 754 s", ready: false,
    takes: [{ id: "0123abcd-000017", phase: "gathering", reason: "", parts,
      choice: "board-05: the camera was lost; 2 of 8 parts are there: hdrig rig accept " +
        "0123abcd-000017 joins these, hdrig rig forget 0123abcd-000017 gives them up" }],
    last: { id: "0123abcd-000016", ok: true, sentence: "", skew_ms: [1.4, 1.38, 1.39],
      within_ms: 0.3, starts } };
}

/* From now on the page reads `rig` as the daemon's; NULL: what the daemon says. */
function pretend(rig, more) {
  pretend.fetch = pretend.fetch || window.fetch.bind(window);
  window.fetch = async (path, options) => {
    const r = await pretend.fetch(path, options);
    if (path !== "/status.json" || !rig) return r;
    return new Response(JSON.stringify({ ...await r.json(), ...more, rig }));
  };
}
