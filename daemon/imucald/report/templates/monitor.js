"use strict";
// Asks /live once a second and draws what it says. It sends nothing.
const byId = (id) => document.getElementById(id);
const escaped = (text) => String(text ?? "").replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const half = (x) => (x === null || x === undefined ? "-" : `±${x.toFixed(2)}°`);
const clock = (s) => { const w = Math.floor(s); return `${Math.floor(w / 60)}:${String(w % 60).padStart(2, "0")}`; };
const WIDEST = 16, NARROWEST = 0.1;  // degrees: bars are on a log scale, as on the terminal
const part = (x) => Math.min(Math.max(Math.log(Math.max(x, NARROWEST) / NARROWEST) / Math.log(WIDEST / NARROWEST), 0.02), 1);

function target(m) {
  const usable = m.targets.usable, fine = m.targets.fine;
  if (usable === undefined) return ["", undefined];
  return m.half === null || m.half >= usable ? ["usable", usable] : ["fine", fine];
}

const mountRow = (m) => `<tr><td>${m.name}</td><td class="n">${m.value}</td><td class="n">${m.spread}</td></tr>`;

function turnRow(m) {
  const [goal, limit] = target(m);
  const reached = m.half !== null && limit !== undefined && m.half < limit;
  const width = m.half === null ? 100 : 100 * part(m.half);
  const mark = limit === undefined ? "" : `<b style="left:${(100 * part(limit)).toFixed(1)}%"></b>`;
  return `<tr><td class="turn">${m.turn}</td><td class="n">${half(m.half)}</td>` +
    `<td class="bar"><div><i class="${reached ? "good" : ""}" style="width:${width.toFixed(1)}%"></i>${mark}</div></td>` +
    `<td class="${reached ? "good" : ""}">${limit === undefined ? "" : `${goal} below ${half(limit)}`}</td></tr>`;
}

function inputRow(r) {
  const rate = r.rate === null ? "-" : `${Number(r.rate.toPrecision(4))}/s`;
  return `<tr><td>${escaped(r.name)}</td><td class="n">${rate}</td><td class="n">${r.samples}</td>` +
    `<td class="${r.good ? "good" : "bad"}">${escaped(r.health)}</td></tr>`;
}

function niceStep(span, ticks) {
  const raw = span / ticks, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((f) => f * power >= raw);
}

function chart(live) {
  const svg = byId("chart"), width = svg.clientWidth || 800, row = 118, left = 52, right = 12, top = 8;
  const history = live.history, height = 3 * row + 26, n = history.t.length;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.style.height = `${height}px`;
  if (n < 2) { svg.innerHTML = `<text x="${left}" y="40">waiting for the first seconds</text>`; return; }
  const t0 = history.t[0], t1 = Math.max(history.t[n - 1], t0 + 10);
  const x = (t) => (left + ((t - t0) / (t1 - t0)) * (width - left - right)).toFixed(1);
  let out = "";
  const tStep = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900].find((s) => (t1 - t0) / s <= width / 90) || 1800;
  for (let t = 0; t <= t1 - t0; t += tStep)
    out += `<line class="grid" x1="${x(t0 + t)}" x2="${x(t0 + t)}" y1="${top}" y2="${3 * row}"/><text x="${x(t0 + t)}" y="${3 * row + 16}" text-anchor="middle">${clock(t)}</text>`;
  for (const e of live.events)
    if (e.t > t0 && (e.kind === "state" || e.kind === "moved")) out += `<line class="mark" x1="${x(e.t)}" x2="${x(e.t)}" y1="${top}" y2="${3 * row}"/>`;
  live.mount.forEach((m, i) => {
    const series = history[m.name], base = top + i * row, inner = row - 18;
    const known = history.t.map((t, k) => ({ t, off: series.off[k], half: series.half[k] })).filter((h) => h.half !== null && h.off !== null);
    const name = `<text class="name" x="${left + 6}" y="${base + 12}">${m.turn}</text>`;
    if (!known.length) { out += `${name}<text x="${left + 6}" y="${base + 40}">not known yet</text>`; return; }
    const late = known.slice(Math.floor(known.length / 3));
    const reach = Math.min(Math.max(...late.map((h) => Math.abs(h.off) + h.half), 0.2) * 1.1, 30);
    const y = (v) => (base + inner / 2 - (Math.min(Math.max(v, -reach), reach) / reach) * (inner / 2)).toFixed(1);
    const step = niceStep(2 * reach, 4);
    for (let v = Math.ceil(-reach / step) * step; v <= reach; v += step)
      out += `<line class="grid" x1="${left}" x2="${width - right}" y1="${y(v)}" y2="${y(v)}"/><text x="${left - 6}" y="${Number(y(v)) + 4}" text-anchor="end">${Number(v.toFixed(2))}°</text>`;
    const fine = live.rotation_is_judged ? m.targets.fine : undefined;
    if (fine !== undefined && fine < reach)
      for (const v of [-fine, fine]) out += `<line class="target" x1="${left}" x2="${width - right}" y1="${y(v)}" y2="${y(v)}"/>`;
    const upper = known.map((h) => `${x(h.t)},${y(h.off + h.half)}`);
    const lower = known.map((h) => `${x(h.t)},${y(h.off - h.half)}`).reverse();
    out += `<polygon class="band" points="${upper.concat(lower).join(" ")}"/>`;
    out += `<polyline class="line" points="${known.map((h) => `${x(h.t)},${y(h.off)}`).join(" ")}"/>${name}`;
  });
  svg.innerHTML = out;
}

function showFlow(kind, text, name) {
  byId("flow").textContent = text;
  byId("flow").className = kind.replace(" ", "_");
  document.title = `${name} · imucald monitor`;
}

function showDead(text) {
  document.body.className = "dead";
  showFlow("none", `NO ANSWER: ${text}`, "no answer");
}

function show(live) {
  if (live.trouble) showDead(live.trouble);
  else document.body.className = "";
  if (live.state === undefined) return;
  if (!live.trouble) showFlow(live.flow.kind, live.flow.text, live.flow.kind === "good" ? live.state : live.flow.kind);
  byId("state").textContent = live.state;
  byId("bus").textContent = `${live.channel} (${live.link})`;
  const reached = ["usable", "fine"].filter((n) => live[`first_${n}_s`] !== null).map((n) => `${n} after ${clock(live[`first_${n}_s`])}`);
  byId("reached").textContent = [`${live.version}, ${live.vehicle}, up ${clock(live.uptime_s)}`, ...reached].join(", ");
  byId("sent").textContent = live.sent && `Sent: ${live.sent}`;
  byId("angles").textContent = live.angles;
  byId("sits").textContent = live.sits || "How the sensor sits is not known yet.";
  byId("steep").textContent = [live.steep, live.mirrored].filter(Boolean).join(" ");
  const views = live.views.join("");
  if (byId("views").dataset.now !== views) { byId("views").dataset.now = views; byId("views").innerHTML = views; }
  if (byId("drawingstyle").textContent !== live.drawing_style) byId("drawingstyle").textContent = live.drawing_style;
  byId("mount").innerHTML = live.mount.map(mountRow).join("");
  byId("turns").innerHTML = live.mount.map(turnRow).join("");
  byId("reasons").innerHTML = live.reasons.map((r) => r.trouble ? `<li class="bad">trouble: ${escaped(r.text)}</li>` : `<li class="waits">waiting for ${escaped(r.who)}: ${escaped(r.text)}</li>`).join("");
  byId("convention").textContent = `${live.convention}. A shorter bar is better, the mark is its target (log scale).`;
  byId("inputs").innerHTML = live.inputs.map(inputRow).join("");
  const f = live.frames, rejected = Object.entries(live.rejected).map(([k, n]) => `${k.replace(/_/g, " ")} ${n}`).join(", ") || "none";
  byId("frames").textContent = `${f.used} frames used, ${f.given_out} given out, ${f.lost} lost, ${f.not_sent} not sent, ${f.conflicts} in conflict; rejected: ${rejected}${live.left_out ? `; not learnt from: ${live.left_out}` : ""}`;
  byId("eventrows").innerHTML = [...live.events].reverse().map((e) => `<tr><td class="n">${e.at}</td><td>${e.kind}</td><td>${escaped(e.text)}</td></tr>`).join("");
  byId("note").textContent = live.note;
  chart(live);
}

async function ask() {
  try {
    show(await (await fetch("/live")).json());
  } catch (error) {
    showDead("the program that serves this page has ended");
  }
}
ask();
setInterval(ask, 1000);
