"use strict";
// Asks /live once a second and draws what it says. It sends nothing.
const byId = (id) => document.getElementById(id);
const escaped = (text) => String(text ?? "").replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const clock = (s) => { const w = Math.floor(s); return `${Math.floor(w / 60)}:${String(w % 60).padStart(2, "0")}`; };
const mountRow = (m) => `<tr><td>${m.name}</td><td class="n">${m.value}</td><td class="n">${m.spread}</td></tr>`;

const turnRow = (m) => `<tr><td class="turn">${m.turn}</td><td class="n">${m.left}</td><td class="${m.reached ? "good" : ""}">${m.target}</td></tr>`;

const gateRow = (g, stale) => `<tr><td>${escaped(g.gate)}</td><td class="bar"><div><i class="${stale ? "stale" : g.share < 1 ? "" : "good"}" style="width:${100 * g.share}%"></i></div></td>` +
  `<td class="n">${g.percent}</td><td>${g.left}</td></tr>`;

function inputRow(r) {
  const rate = r.rate === null ? "-" : `${Number(r.rate.toPrecision(4))}/s`;
  return `<tr><td>${escaped(r.name)}</td><td class="n">${rate}</td><td class="n">${r.samples}</td>` +
    `<td class="${r.good ? "good" : r.bad ? "bad" : ""}">${escaped(r.health)}</td></tr>`;
}

const STEPS_S = [5, 10, 15, 30, 60, 120, 300, 600, 900];
const FORCES_S = 300;  // the forces of the last five minutes: a braking is wide enough to be seen
let rows = [], columns = [];

function niceStep(span, ticks) {
  const raw = span / ticks, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((f) => f * power >= raw);
}

const column = (name, from) => from.map((r) => r[columns.indexOf(name)] ?? null);
const timeOfDay = (t) => new Date(1000 * t).toTimeString().slice(0, 8);

// Panels one below the other with one time axis. A panel: name, unit, lines [[class, values]], half (of a band).
function chart(svg, from, panels) {
  const width = svg.clientWidth || 800, row = 118, left = 56, right = 12, top = 8, height = panels.length * row + 26;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.style.height = `${height}px`;
  if (from.length < 2) { svg.innerHTML = `<text x="${left}" y="40">waiting for the first seconds</text>`; return; }
  const t = from.map((r) => r[0]), t0 = t[0], t1 = Math.max(t[t.length - 1], t0 + 10);
  const x = (s) => (left + ((s - t0) / (t1 - t0)) * (width - left - right)).toFixed(1);
  const step = STEPS_S.find((s) => (t1 - t0) / s <= width / 110) || 1800, bottom = panels.length * row;
  let out = "";
  for (let s = Math.ceil(t0 / step) * step; s <= t1; s += step)
    out += `<line class="grid" x1="${x(s)}" x2="${x(s)}" y1="${top}" y2="${bottom}"/>` + (x(s) > width - 34 ? "" : `<text x="${x(s)}" y="${bottom + 16}" text-anchor="middle">${timeOfDay(s)}</text>`);
  from.forEach((r, i) => { if (i && r[1] !== from[i - 1][1]) out += `<line class="mark" x1="${x(r[0])}" x2="${x(r[0])}" y1="${top}" y2="${bottom}"><title>${timeOfDay(r[0])} ${r[1]}</title></line>`; });
  panels.forEach((panel, p) => {
    const base = top + p * row + 14, inner = row - 32, half = panel.half || t.map(() => 0), edges = [];
    for (const [, values] of panel.lines)
      values.forEach((v, i) => { if (v !== null && (!panel.half || i >= values.length / 3 || values.length < 9)) edges.push(v - half[i], v + half[i]); });
    const name = `<text class="name" x="${left + 6}" y="${base - 4}">${panel.name} [${panel.unit}]</text>`;
    if (!edges.length) { out += `${name}<text x="${left + 6}" y="${base + 26}">not known yet</text>`; return; }
    const least = Math.max(panel.least - (Math.max(...edges) - Math.min(...edges)), 0) / 2;
    const low = Math.min(...edges) - least, high = Math.max(...edges) + least;
    const y = (v) => (base + inner - ((v - low) / (high - low)) * inner).toFixed(1);
    const every = niceStep(high - low, 4);
    for (let v = Math.ceil(low / every) * every; v <= high; v += every)
      out += `<line class="grid" x1="${left}" x2="${width - right}" y1="${y(v)}" y2="${y(v)}"/><text x="${left - 6}" y="${Number(y(v)) + 4}" text-anchor="end">${Number(v.toFixed(2))}</text>`;
    out += `<svg x="${left}" y="${base}" width="${width - left - right}" height="${inner}" viewBox="${left} ${base} ${width - left - right} ${inner}">`;  // cut off at the panel's edge
    for (const [kind, values] of panel.lines)
      for (const part of pieces(values)) {
        if (panel.half) out += `<polygon class="band" points="${part.map((i) => `${x(t[i])},${y(values[i] + half[i])}`).concat(part.map((i) => `${x(t[i])},${y(values[i] - half[i])}`).reverse()).join(" ")}"/>`;
        out += `<polyline class="line ${kind}" points="${part.map((i) => `${x(t[i])},${y(values[i])}`).join(" ")}"/>`;
      }
    out += `</svg>${name}`;
  });
  svg.innerHTML = out;
}

// Where values are known without a hole: lists of places.
function pieces(values) {
  const found = [];
  values.forEach((v, i) => { if (v === null) return; if (i && values[i - 1] !== null && found.length) found[found.length - 1].push(i); else found.push([i]); });
  return found;
}

// An angle goes on over half a turn, as it is near its last value.
function unwrapped(values) {
  const last = values.filter((v) => v !== null).pop();
  return values.map((v) => (v === null ? null : v - 360 * Math.round((v - last) / 360)));
}

function showHistory(found) {
  columns = found.columns.length ? found.columns : columns;
  rows = rows.concat(found.rows).slice(-900);
  chart(byId("chart"), rows, ["roll", "pitch", "yaw"].map((name) => ({
    name, unit: "deg", least: 0.4, half: column(`${name}_half_deg`, rows), lines: [["", unwrapped(column(`${name}_deg`, rows))]],
  })));
  const lately = rows.filter((r) => r[0] >= rows[rows.length - 1][0] - FORCES_S);
  const force = (name, axis, motion) => ({ name, unit: "m/s²", least: 1, lines: [["raw", column(`raw_${axis}_mps2`, lately)], ["motion", motion], ["", column(`corrected_${axis}_mps2`, lately)]] });
  chart(byId("forces"), lately, [force("forward: x", "x", column("dvdt_mps2", lately)), force("left: y", "y", column("turn_mps2", lately)), force("up: z", "z", [])]);
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
  byId("now").textContent = live.now && `Now: ${live.now}`;
  byId("reached").textContent = [`${live.version}, ${live.vehicle}, up ${clock(live.uptime_s)}`, ...live.reached].join(", ");
  byId("sent").textContent = live.sent && `Errors left in corrected frames: ${live.sent}`;
  byId("angles").innerHTML = live.angles.split(", ").map((angle) => `<span class="whole">${escaped(angle)}</span>`).join(", ");
  byId("sits").textContent = live.sits || "How the sensor sits is not known yet.";
  byId("steep").textContent = [live.steep, live.mirrored].filter(Boolean).join(" ");
  const views = live.views.join("");
  if (byId("views").dataset.now !== views) { byId("views").dataset.now = views; byId("views").innerHTML = views; }
  if (byId("drawingstyle").textContent !== live.drawing_style) byId("drawingstyle").textContent = live.drawing_style;
  byId("mount").innerHTML = live.mount.map(mountRow).join("");
  byId("turns").innerHTML = live.mount.map(turnRow).join("");
  byId("reasons").innerHTML = live.reasons.map((r) => `<li class="waits">waiting for ${escaped(r.who)}: ${escaped(r.text)}</li>`).join("");
  byId("convention").textContent = `${live.convention}.`;
  byId("progress").hidden = !live.progress;
  if (live.progress) { byId("goal").textContent = `To ${live.progress.goal}`; byId("gates").innerHTML = live.progress.gates.map((g) => gateRow(g, live.stale)).join(""); }
  byId("inputs").innerHTML = live.inputs.map(inputRow).join("") || `<tr><td colspan="4">nothing yet</td></tr>`;
  const f = live.frames, rejected = Object.entries(live.rejected).map(([k, n]) => `${k.replace(/_/g, " ")} ${n}`).join(", ") || "none";
  byId("frames").className = f.conflicts ? "bad" : "soft";
  byId("frames").textContent = `${f.used} frames used, ${f.given_out} sent, ${f.lost} lost, ${f.late} late, ${f.not_sent} not sent, ${f.conflicts} in conflict; rejected: ${rejected}${live.left_out ? `; not used for the mount: ${live.left_out}` : ""}`;
  byId("eventrows").innerHTML = [...live.events].reverse().map((e) => `<tr><td class="n">${e.at}</td><td>${e.kind}</td><td>${escaped(e.text)}</td></tr>`).join("");
  byId("note").textContent = live.note;
  showHistory(live.history);
}

async function ask() {
  try {
    show(await (await fetch(`/live?since=${rows.length ? rows[rows.length - 1][0] : ""}`)).json());
  } catch (error) {
    showDead("the program that serves this page has ended");
  }
}
ask();
setInterval(ask, 1000);
addEventListener("resize", () => rows.length && showHistory({ columns: [], rows: [] }));
