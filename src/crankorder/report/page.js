"use strict";
// Interactive Campbell diagram, order map and order tracks of a report page: one canvas, its cuts beside it, no library.
(() => {
  const $ = (id) => document.getElementById(id);
  if (!$("live-data")) return;
  const D = JSON.parse($("live-data").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const LUT = bytes(D.colours), STEP = 0.005, TOP = 60000; // a code is 0.005 dB; TOP is the channel's largest, 0 is nothing
  const canvas = $("live-map"), side = $("live-cuts"), pen = canvas.getContext("2d"), pen2 = side.getContext("2d");
  const state = { view: 0, channel: 0, db: true, at: null, rpm: null, order: null, box: null, drag: null, paper: false };
  const shown = { orders: true, modes: true, crossings: true };
  const views = [...D.maps, ...(D.tracks ? [D.tracks] : [])];
  if (!views.length) return;
  for (const map of D.maps) {
    map.codes = map.cells.map((text) => { const b = bytes(text); return new Uint16Array(b.buffer); });
    map.made = new Map();
  }
  if (D.tracks) for (const key of ["amplitude", "low", "high", "phase"]) D.tracks[key] = new Float32Array(bytes(D.tracks[key]).buffer);
  const view = () => views[state.view], isMap = () => view().kind !== "tracks", unit = () => D.channels[state.channel].unit;
  const decibel = (a) => 20 * Math.log10(a / D.channels[state.channel].reference);
  const amplitudeOf = (map, code) => (code ? map.largest[state.channel] * 10 ** (((code - TOP) * STEP) / 20) : 0);

  // numbers and ticks
  const sig = (v, n = 3) => {
    if (!Number.isFinite(v)) return "–";
    if (v === 0) return "0";
    const small = Math.abs(v) < 1e-3 || Math.abs(v) >= 1e6;
    if (!small) return String(Number(v.toPrecision(n))).replace("-", "−");
    const [m, e] = v.toExponential(n - 1).split("e");
    return `${m.replace("-", "−")}·10^${Number(e)}`;
  };
  const ticks = (low, high, most) => {
    const raw = (high - low) / Math.max(most, 1), size = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].find((s) => s * size >= raw) * size, out = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
    return out.map((v) => [v, String(Number(v.toFixed(Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)))))).replace("-", "−")]);
  };
  const logTicks = (low, high) => {
    const out = [];
    for (let k = Math.ceil(Math.log10(low) - 1e-9); k <= Math.log10(high); k++) out.push([10 ** k, sig(10 ** k)]);
    return out.length > 1 ? out : ticks(low, high, 4).filter(([v]) => v > 0);
  };

  // colours of the page, light on paper
  const colour = (name) => {
    const paper = { ink: "#1f2933", faint: "#52606d", rule: "#d9dee4", accent: "#00718f", warn: "#a03c78", page: "#ffffff" };
    return state.paper ? paper[name] : getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() || paper[name];
  };
  const LINES = ["#0b63a5", "#c77700", "#a03c78", "#2b8a5a", "#6a4fb3", "#c0392b", "#3d8fa3", "#8a6d3b"];

  // images of a map: one row per speed, and halves of halves of the largest value, so that no thin line is lost
  const images = (map) => {
    const key = `${state.channel} ${state.db}`;
    if (map.made.has(key)) return map.made.get(key);
    const [low, high] = map.limits[state.channel], top = decibel(map.largest[state.channel]), shade = new Uint8Array(TOP + 1);
    for (let c = 1; c <= TOP; c++) {
      const level = (c - TOP) * STEP, share = state.db ? (top + level - low) / (high - low) : 10 ** (level / 20);
      shade[c] = Math.max(0, Math.min(255, Math.round(255 * share)));
    }
    let codes = map.codes[state.channel], width = map.nx, rows = map.rows.length;
    const levels = [];
    for (;;) {
      const made = new OffscreenCanvas(width, rows), data = new ImageData(width, rows), into = data.data;
      for (let i = 0; i < codes.length; i++) {
        const at = 3 * shade[codes[i]];
        into[4 * i] = LUT[at]; into[4 * i + 1] = LUT[at + 1]; into[4 * i + 2] = LUT[at + 2]; into[4 * i + 3] = 255;
      }
      made.getContext("2d").putImageData(data, 0, 0);
      levels.push({ width, made, cells: map.nx / width });
      if (width <= 128) break;
      const half = Math.ceil(width / 2), next = new Uint16Array(half * rows);
      for (let r = 0; r < rows; r++)
        for (let j = 0; j < half; j++)
          next[r * half + j] = Math.max(codes[r * width + 2 * j], 2 * j + 1 < width ? codes[r * width + 2 * j + 1] : 0);
      levels[levels.length - 1].odd = width % 2;
      codes = next; width = half;
    }
    levels.forEach((one, n) => (one.cells = 2 ** n));
    map.made.set(key, levels);
    return levels;
  };

  // the whole of a view, and places on the canvas
  const whole = () => {
    const v = view();
    if (isMap()) return { x: [v.x0, v.x0 + (v.nx - 1) * v.dx], y: [v.rows[0][1], v.rows[v.rows.length - 1][2]] };
    const rpm = v.speed, spare = 0.02 * (rpm[rpm.length - 1] - rpm[0]) || 1;
    let top = 0, low = Infinity;
    for (let o = 0; o < v.orders.length; o++)
      for (let s = 0; s < rpm.length; s++) {
        const a = v.amplitude[track(o, s)];
        if (a > 0) { top = Math.max(top, a); low = Math.min(low, a); }
      }
    if (!top) [low, top] = [0.1, 1];
    return { x: [rpm[0] - spare, rpm[rpm.length - 1] + spare], y: state.db ? [Math.max(low / 1.5, top * 1e-5), top * 1.6] : [0, 1.08 * top] };
  };
  const track = (o, s) => (state.channel * view().orders.length + o) * view().speed.length + s;
  const room = () => { const narrow = canvas.clientWidth < 520; return { left: narrow ? 56 : 58, right: narrow ? 48 : 62, top: 26, bottom: 40 }; };
  const axes = (pen, box, x, y, log) => {
    const f = log ? Math.log : (v) => v;
    return {
      box, x, y, log,
      px: (v) => box[0] + ((v - x[0]) / (x[1] - x[0])) * box[2],
      py: (v) => box[1] + box[3] - ((f(v) - f(y[0])) / (f(y[1]) - f(y[0]))) * box[3],
      vx: (p) => x[0] + ((p - box[0]) / box[2]) * (x[1] - x[0]),
      vy: (p) => { const s = f(y[0]) + ((box[1] + box[3] - p) / box[3]) * (f(y[1]) - f(y[0])); return log ? Math.exp(s) : s; },
    };
  };
  // what a list of ticks needs beside its axis, and the ticks of an upright axis and of the colour bar
  const wide = (pen, list, font) => { pen.font = `${font || 12}px system-ui, sans-serif`; return Math.max(0, ...list.map(([, text]) => pen.measureText(text).width)); };
  const upright = (y, log, h) => (log ? logTicks(y[0], y[1]) : ticks(y[0], y[1], h / 45));
  const barTicks = () => { const v = view(), c = state.channel; return state.db ? ticks(v.limits[c][0], v.limits[c][1] || 1, 6) : ticks(0, v.largest[c] || 1, 6); };
  const main = () => {
    const r = room(), w = canvas.clientWidth, h = canvas.clientHeight - r.top - r.bottom, at = state.box || whole(), log = !isMap() && state.db;
    const left = Math.max(r.left, 26 + wide(pen, upright(at.y, log, h))), right = isMap() ? Math.max(r.right, 24 + wide(pen, barTicks(), 11)) : r.right;
    return axes(pen, [left, r.top, w - left - right, h], at.x, at.y, log);
  };
  const ready = (canvas, pen) => {
    const scale = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (canvas.width !== Math.round(w * scale) || canvas.height !== Math.round(h * scale)) { canvas.width = Math.round(w * scale); canvas.height = Math.round(h * scale); }
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.fillStyle = colour("page"); pen.fillRect(0, 0, w, h);
    pen.font = "12px system-ui, sans-serif"; pen.lineWidth = 1; pen.setLineDash([]);
  };
  const frame = (pen, a, xLabel, yLabel, title) => {
    const [l, t, w, h] = a.box;
    pen.strokeStyle = colour("faint"); pen.fillStyle = colour("ink"); pen.lineWidth = 1; pen.globalAlpha = 1;
    pen.strokeRect(l + 0.5, t + 0.5, w, h);
    pen.textAlign = "center"; pen.textBaseline = "top";
    const inside = (p, text) => { const half = pen.measureText(text).width / 2 + 1; return Math.max(half, Math.min(p, pen.canvas.clientWidth - half)); };
    for (const [v, text] of ticks(a.x[0], a.x[1], w / 70)) { const p = a.px(v); pen.fillRect(p, t + h, 1, 4); pen.fillText(text, inside(p, text), t + h + 6); }
    pen.fillText(xLabel, l + w / 2, t + h + 22);
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const [v, text] of upright(a.y, a.log, h)) { const p = a.py(v); pen.fillRect(l - 4, p, 4, 1); pen.fillText(text, l - 6, p); }
    pen.save(); pen.translate(11, t + h / 2); pen.rotate(-Math.PI / 2); pen.textAlign = "center"; pen.fillText(yLabel, 0, 0); pen.restore();
    if (title) { pen.textAlign = "left"; pen.textBaseline = "bottom"; pen.fillText(title, l, t - 5); }
  };
  const clipped = (pen, a, draw) => { pen.save(); pen.beginPath(); pen.rect(...a.box); pen.clip(); draw(); pen.restore(); };
  const polyline = (pen, a, points) => {
    pen.beginPath();
    let on = false;
    for (const [x, y] of points) {
      if (!Number.isFinite(x) || !Number.isFinite(y) || (a.log && y <= 0)) { on = false; continue; }
      on ? pen.lineTo(a.px(x), a.py(y)) : pen.moveTo(a.px(x), a.py(y)); on = true;
    }
    pen.stroke();
  };

  // what the program says
  const here = (channels) => !channels.length || channels.includes(state.channel);
  const own = (list) => list.filter((one) => one.channel === state.channel);
  const hertzOf = (mode, rpm) => mode.hz + (mode.slope ? (mode.slope * (rpm - mode.from_rpm)) / 60 : 0);
  const across = (v, hz, rpm) => (v.kind === "order" ? (60 * hz) / rpm : hz);
  const says = (rpm, hz, tolerance) => {
    const told = [], order = (60 * hz) / rpm, close = (o) => Math.abs((o * rpm) / 60 - hz) <= tolerance;
    const lines = [];
    for (const one of D.orders.filter((o) => close(o.order))) {
      const same = lines.find((l) => l.text === one.text);
      if (!same || one.channel === state.channel) { if (same) lines.splice(lines.indexOf(same), 1); lines.push(one); }
    }
    lines.sort((a, b) => Math.abs(a.order - order) - Math.abs(b.order - order));
    for (const one of lines.slice(0, 2)) {
      const mine = one.channel === state.channel, out = mine && one.seen && (rpm < one.seen[0] - 1 || rpm > one.seen[1] + 1);
      told.push(`Order ${one.text}: ${one.why}${mine ? "" : `, found in ${D.channels[one.channel].name}`}${out ? ", not seen at this speed" : ""}.`);
    }
    for (const mode of D.fixed.filter((m) => Math.abs(hertzOf(m, rpm) - hz) <= Math.max(tolerance, m.half)).slice(0, 2))
      told.push(`${mode.text}${here(mode.channels) ? "" : `, seen in ${mode.channels.map((c) => D.channels[c].name).join(", ")}`}.`);
    if (!told.length) {
      const line = own(D.lines).find((l) => (l.order ? close(l.order) : Math.abs(l.hz - hz) <= tolerance));
      if (line) told.push(line.text);
    }
    const met = D.crossings.find((c) => Math.abs(c.hz - hz) <= Math.max(tolerance, c.half) && close(c.order) && Math.abs(c.rpm - rpm) <= Math.max(c.rpm * 0.02, 1));
    if (met) told.push(met.text);
    const avoid = D.avoid.find((one) => rpm >= one.low && rpm <= one.high), free = D.free.find(([l, h]) => rpm >= l && rpm <= h);
    if (!told.length) told.push(D.unasked ? "Findings were not asked for." : "No line is named here.");
    if (avoid) told.push(avoid.text); else if (free) told.push(D.freeText);
    return told;
  };
  const reading = () => {
    const at = state.at;
    if (!at) return null;
    const v = view();
    if (!isMap()) {
      const i = track(at.order, at.speed), rpm = v.speed[at.speed], o = v.orders[at.order], a = v.amplitude[i], hz = (o.order * rpm) / 60;
      const ends = Number.isFinite(v.low[i]) && Number.isFinite(v.high[i]) ? ` (${sig(v.low[i])}…${sig(v.high[i])})` : "";
      const phase = Number.isFinite(v.phase[i]) ? ` · phase ${sig(v.phase[i], 3)}°` : "";
      return { rpm, hz, order: o.order, head: `${sig(rpm, 4)} rpm · ${sig(hz, 4)} Hz · order ${o.text} · ${sig(a)} ${unit()}${ends}${phase}`, told: says(rpm, hz, (0.01 * rpm) / 60) };
    }
    const [rpm] = v.rows[at.row], x = v.x0 + at.column * v.dx, hz = v.kind === "order" ? (x * rpm) / 60 : x, order = (60 * hz) / rpm;
    const a = amplitudeOf(v, v.codes[state.channel][at.row * v.nx + at.column]);
    const level = a > 0 ? `${sig(a)} ${unit()} · ${decibel(a).toFixed(1)} dB` : "no signal";
    const step = v.kind === "order" ? (v.dx * rpm) / 60 : v.dx;
    return { rpm, hz, order, head: `${sig(rpm, 4)} rpm · ${sig(hz, 4)} Hz · order ${sig(order, 4)} · ${level}`, told: says(rpm, hz, 1.5 * step) };
  };
  const tell = (aloud) => {
    const read = reading(), said = $("live-said");
    if (read) {
      said.replaceChildren();
      const head = document.createElement("strong");
      head.textContent = read.head;
      said.append(head, ` ${read.told.join(" ")}`);
      if (aloud) $("live-spoken").textContent = `${read.head}. ${read.told.join(" ")}`;
    } else said.textContent = state.outside || D.hint;
  };

  // drawing
  const drawMap = (a) => {
    const v = view(), levels = images(v), [l, t, w, h] = a.box, scale = window.devicePixelRatio || 1;
    pen.fillStyle = "#8a949e"; pen.fillRect(l, t, w, h);
    const seen = (a.x[1] - a.x[0]) / v.dx, one = levels.find((level) => seen / level.cells <= w * scale) || levels[levels.length - 1];
    const first = v.x0 - 0.5 * v.dx, cell = v.dx * one.cells;
    const from = Math.max(0, (a.x[0] - first) / cell), to = Math.min(v.nx / one.cells, (a.x[1] - first) / cell);
    const x0 = a.px(first + from * cell), x1 = a.px(first + to * cell);
    pen.imageSmoothingEnabled = false;
    clipped(pen, a, () => v.rows.forEach(([, low, high], r) => {
      if (high < a.y[0] || low > a.y[1]) return;
      const top = Math.round(a.py(high) * scale) / scale, bottom = Math.max(Math.round(a.py(low) * scale) / scale, top + 1 / scale);
      pen.drawImage(one.made, from, r, to - from, 1, x0, top, x1 - x0, bottom - top);
    }));
  };
  const halo = (text, x, y, fill) => { pen.lineWidth = 3; pen.strokeStyle = "rgba(0,0,0,.65)"; pen.strokeText(text, x, y); pen.fillStyle = fill; pen.fillText(text, x, y); };
  const drawLines = (a) => {
    const v = view(), [l, t, w, h] = a.box, speeds = [...Array(41).keys()].map((k) => a.y[0] + (k / 40) * (a.y[1] - a.y[0])).filter((s) => s > 0);
    const ends = [];
    clipped(pen, a, () => {
      if (shown.modes) for (const mode of D.fixed) {
        pen.strokeStyle = mode.kind === "tone" ? "#ff9ad5" : "#66e0ff"; pen.globalAlpha = here(mode.channels) ? 0.8 : 0.4; pen.lineWidth = 1;
        pen.setLineDash(mode.kind === "tone" ? [1, 3] : mode.kind === "doubt" ? [2, 6] : [6, 5]);
        polyline(pen, a, speeds.map((s) => [across(v, hertzOf(mode, s), s), s]));
      }
      pen.setLineDash([]);
      const drawn = own(D.orders);
      if (shown.orders) for (const one of drawn.length || !D.unasked ? drawn : D.guides) {
        pen.strokeStyle = "#ffffff"; pen.globalAlpha = 0.45; pen.lineWidth = 0.8;
        polyline(pen, a, speeds.map((s) => [across(v, (one.order * s) / 60, s), s]));
        ends.push(one);
      }
      pen.globalAlpha = 1;
      if (shown.crossings) for (const c of D.crossings) if (c.excited && here(c.channels)) {
        for (const [width, ink] of [[3.5, "rgba(0,0,0,.6)"], [1.6, "#ffffff"]]) { pen.lineWidth = width; pen.strokeStyle = ink; pen.beginPath(); pen.arc(a.px(across(v, c.hz, c.rpm)), a.py(c.rpm), 6, 0, 7); pen.stroke(); }
      }
      pen.strokeStyle = "#7dff9a"; pen.lineWidth = 1.2;
      if (state.order) polyline(pen, a, speeds.map((s) => [across(v, (state.order * s) / 60, s), s]));
      if (state.rpm) polyline(pen, a, [[a.x[0], state.rpm], [a.x[1], state.rpm]]);
      const read = reading();
      if (read) { pen.strokeStyle = "#ffffff"; pen.lineWidth = 1; pen.strokeRect(a.px(across(v, read.hz, read.rpm)) - 4, a.py(read.rpm) - 4, 8, 8); }
    });
    pen.textAlign = "center"; pen.textBaseline = "top";
    const taken = [];
    for (const one of [...ends].sort((p, q) => (q.size || 0) - (p.size || 0))) {
      let y = a.y[1], x = across(v, (one.order * y) / 60, y);
      if (x > a.x[1]) { x = a.x[1]; y = v.kind === "order" ? NaN : (60 * x) / one.order; }
      const px = Math.min(a.px(x), l + w - 12), py = Math.max(a.py(y) + 3, t + 3);
      if (!(x >= a.x[0]) || !(y >= a.y[0]) || taken.some(([p, q]) => Math.abs(p - px) < 22 && Math.abs(q - py) < 14)) continue;
      taken.push([px, py]); halo(one.text, px, py, "#ffffff");
    }
    if (!shown.modes || v.kind === "order") return;
    pen.textBaseline = "bottom"; let last = -Infinity;
    for (const mode of D.fixed) {
      const px = a.px(hertzOf(mode, a.y[1])), wide = pen.measureText(mode.name).width + 8;
      if (px < l || px > l + w || px - last < wide) continue;
      pen.fillStyle = mode.kind === "tone" ? colour("warn") : colour("accent"); pen.fillText(mode.name, px, t - 4); last = px;
    }
  };
  const drawBar = (a) => {
    const v = view(), x = a.box[0] + a.box[2] + 8, [, t, , h] = a.box, [low, high] = v.limits[state.channel];
    const from = state.db ? low : 0, to = state.db ? high : v.largest[state.channel];
    for (let k = 0; k < h; k++) { const at = 3 * Math.round(255 * (1 - k / h)); pen.fillStyle = `rgb(${LUT[at]},${LUT[at + 1]},${LUT[at + 2]})`; pen.fillRect(x, t + k, 9, 1.5); }
    pen.fillStyle = colour("ink"); pen.textAlign = "left"; pen.textBaseline = "middle"; pen.font = "11px system-ui, sans-serif";
    for (const [value, text] of barTicks()) pen.fillText(text, x + 12, t + h - ((value - from) / ((to || 1) - from)) * h);
    pen.textBaseline = "bottom"; pen.textAlign = "right"; pen.fillText(state.db ? "dB" : unit(), canvas.clientWidth - 2, t - 5); pen.font = "12px system-ui, sans-serif";
  };
  const lineColour = (n) => LINES[n % LINES.length];
  const drawTracks = (a) => {
    const v = view(), labels = [];
    clipped(pen, a, () => v.orders.forEach((o, n) => {
      const points = v.speed.map((s, k) => [s, v.amplitude[track(n, k)], v.low[track(n, k)], v.high[track(n, k)]]).filter((p) => p[1] !== -Infinity); // at other speeds only other orders have a row
      pen.strokeStyle = pen.fillStyle = lineColour(n); pen.globalAlpha = 0.18;
      for (let k = 1; k < points.length; k++) {
        const [p, q] = [points[k - 1], points[k]];
        if (![...p, ...q].every(Number.isFinite)) continue;
        const floor = a.log ? a.y[0] : -Infinity;
        pen.beginPath(); pen.moveTo(a.px(p[0]), a.py(Math.max(p[2], floor))); pen.lineTo(a.px(q[0]), a.py(Math.max(q[2], floor)));
        pen.lineTo(a.px(q[0]), a.py(q[3])); pen.lineTo(a.px(p[0]), a.py(p[3])); pen.fill();
      }
      pen.globalAlpha = 1; pen.lineWidth = state.at && state.at.order === n ? 3 : 1.5; polyline(pen, a, points);
      const end = points.filter((p) => p[1] > 0 && p[0] <= a.x[1]).pop();
      if (end) labels.push([a.py(end[1]), o.text, lineColour(n)]);
    }));
    clipped(pen, a, () => {
      pen.strokeStyle = "#2b8a5a"; pen.lineWidth = 1.2;
      if (state.rpm) polyline(pen, a, [[state.rpm, a.y[0]], [state.rpm, a.y[1]]]);
      if (state.at) { const i = track(state.at.order, state.at.speed); pen.beginPath(); pen.strokeStyle = colour("ink"); pen.arc(a.px(v.speed[state.at.speed]), a.py(v.amplitude[i]), 5, 0, 7); pen.stroke(); }
    });
    labels.sort((p, q) => p[0] - q[0]); pen.textAlign = "left"; pen.textBaseline = "middle";
    let last = -Infinity;
    for (const [y, text, ink] of labels) { const at = Math.max(y, last + 12); pen.fillStyle = ink; pen.fillText(text, a.box[0] + a.box[2] + 6, at); last = at; }
  };
  const rowAt = (v, rpm) => v.rows.reduce((best, row, r) => (Math.abs(row[0] - rpm) < Math.abs(v.rows[best][0] - rpm) ? r : best), 0);
  const cutAxes = (half, x, values) => {
    const w = side.clientWidth, h = side.clientHeight / 2, good = values.filter((v) => v > 0), top = Math.max(...good, 1e-300);
    const log = state.db && good.length > 0;
    const y = log ? [Math.max(Math.min(...good) / 1.3, top * 1e-5), top * 1.5] : [0, good.length ? top * 1.08 : 1];
    const left = Math.max(54, 26 + wide(pen2, upright(y, log, h - 66)));
    return axes(pen2, [left, half * h + 24, w - left - 10, h - 66], x, y, log);
  };
  const drawCuts = () => {
    ready(side, pen2);
    const v = view(), name = `Amplitude, ${unit()}`, a = main();
    if (!isMap()) {
      if (state.rpm) {
        const s = v.speed.reduce((b, rpm, k) => (Math.abs(rpm - state.rpm) < Math.abs(v.speed[b] - state.rpm) ? k : b), 0);
        const values = v.orders.map((o, n) => v.amplitude[track(n, s)]), b = cutAxes(0, [0, Math.max(...v.orders.map((o) => o.order)) * 1.08], values);
        clipped(pen2, b, () => v.orders.forEach((o, n) => { if (values[n] > 0) { pen2.fillStyle = lineColour(n); const y = b.py(values[n]); pen2.fillRect(b.px(o.order) - 3, y, 6, b.box[1] + b.box[3] - y); } }));
        frame(pen2, b, "Order", name, `Orders at ${sig(v.speed[s], 4)} rpm`);
      }
      const n = state.at ? state.at.order : v.orders.findIndex((o) => o.order === state.order);
      if (n >= 0) {
        const h = side.clientHeight / 2, b = axes(pen2, [54, h + 24, side.clientWidth - 64, h - 66], a.x, [-190, 190], false);
        pen2.fillStyle = lineColour(n);
        clipped(pen2, b, () => v.speed.forEach((s, k) => { const p = v.phase[track(n, k)]; if (Number.isFinite(p)) { pen2.beginPath(); pen2.arc(b.px(s), b.py(p), 2.5, 0, 7); pen2.fill(); } }));
        frame(pen2, b, "Speed, rpm", "Phase, °", `Phase of order ${v.orders[n].text}`);
      }
      return;
    }
    const codes = v.codes[state.channel];
    if (state.rpm) {
      const r = rowAt(v, state.rpm), points = [];
      for (let j = 0; j < v.nx; j++) { const x = v.x0 + j * v.dx; if (x >= a.x[0] && x <= a.x[1]) points.push([x, amplitudeOf(v, codes[r * v.nx + j])]); }
      const b = cutAxes(0, a.x, points.map((p) => p[1]));
      pen2.strokeStyle = colour("accent"); clipped(pen2, b, () => {
        polyline(pen2, b, points.map(([x, y]) => [x, b.log ? Math.max(y, b.y[0]) : y]));
        if (state.order) { pen2.globalAlpha = 0.7; pen2.strokeStyle = "#2b8a5a"; const x = across(v, (state.order * v.rows[r][0]) / 60, v.rows[r][0]); polyline(pen2, b, [[x, b.y[0]], [x, b.y[1]]]); pen2.globalAlpha = 1; }
      });
      frame(pen2, b, v.label, name, `Spectrum at ${sig(v.rows[r][0], 4)} rpm`);
    }
    if (state.order) {
      const points = v.rows.map(([rpm], r) => {
        const j = Math.round((across(v, (state.order * rpm) / 60, rpm) - v.x0) / v.dx);
        if (j < 0 || j >= v.nx) return [rpm, NaN];
        return [rpm, Math.max(...[j - 1, j, j + 1].filter((k) => k >= 0 && k < v.nx).map((k) => amplitudeOf(v, codes[r * v.nx + k])))];
      });
      const b = cutAxes(1, a.y, points.filter((p) => p[0] >= a.y[0] && p[0] <= a.y[1]).map((p) => p[1]));
      pen2.strokeStyle = colour("accent"); clipped(pen2, b, () => { polyline(pen2, b, points); if (state.rpm) { pen2.strokeStyle = "#2b8a5a"; polyline(pen2, b, [[state.rpm, b.y[0]], [state.rpm, b.y[1]]]); } });
      frame(pen2, b, "Speed, rpm", name, `Along order ${sig(state.order, 4)}`);
    }
  };
  const draw = () => {
    waiting = 0;
    const began = performance.now();
    ready(canvas, pen);
    const a = main();
    if (isMap()) { drawMap(a); drawLines(a); drawBar(a); frame(pen, a, view().label, "Speed, rpm", ""); }
    else { drawTracks(a); frame(pen, a, "Speed, rpm", `Amplitude (peak), ${unit()}`, ""); }
    if (state.drag && state.drag.to) { const { from, to } = state.drag; pen.strokeStyle = isMap() ? "#ffffff" : colour("accent"); pen.setLineDash([4, 3]); pen.strokeRect(from[0], from[1], to[0] - from[0], to[1] - from[1]); }
    canvas.dataset.redrawMs = (performance.now() - began).toFixed(2);
    canvas.dataset.view = [...a.x, ...a.y].map((v) => sig(v, 5)).join(" ");
    drawCuts();
  };
  let waiting = 0;
  const redraw = () => { if (!waiting) waiting = requestAnimationFrame(draw); };

  // moving about
  const within = (low, high, [first, last], log) => {
    const f = log ? Math.log : (v) => v, g = log ? Math.exp : (v) => v;
    let [a, b, c, d] = [low, high, first, last].map(f);
    const size = Math.min(b - a, d - c);
    a = Math.max(c, Math.min(a, d - size));
    return [g(a), g(a + size)];
  };
  const setBox = (x, y) => {
    const all = whole(), log = !isMap() && state.db, least = isMap() ? 4 * view().dx : 1e-3 * (all.x[1] - all.x[0]);
    if (x[1] - x[0] < least) { const m = (x[0] + x[1]) / 2; x = [m - least / 2, m + least / 2]; }
    const box = { x: within(x[0], x[1], all.x, false), y: within(y[0], y[1], all.y, log) };
    const full = box.x[1] - box.x[0] > 0.999 * (all.x[1] - all.x[0]) && box.y[0] <= all.y[0] * (1 + 1e-9) && box.y[1] >= all.y[1] * (1 - 1e-9);
    state.box = full ? null : box;
    redraw();
  };
  const zoom = (factor, p) => {
    const a = main(), [l, t, w, h] = a.box, [px, py] = p || [l + w / 2, t + h / 2];
    const edge = (low, high, at) => [at - (at - low) * factor, at + (high - at) * factor];
    const [x0, x1] = edge(l, l + w, px), [y0, y1] = edge(t, t + h, py);
    setBox([a.vx(x0), a.vx(x1)], [a.vy(y1), a.vy(y0)]);
  };
  const pan = (dx, dy) => { const a = main(), [l, t, w, h] = a.box; setBox([a.vx(l + dx), a.vx(l + w + dx)], [a.vy(t + h + dy), a.vy(t + dy)]); };
  const place = (p) => {
    const a = main(), v = view(), [l, t, w, h] = a.box;
    state.outside = "";
    if (p[0] < l || p[0] > l + w || p[1] < t || p[1] > t + h) return null;
    const x = a.vx(p[0]), y = a.vy(p[1]);
    if (isMap()) {
      const row = v.rows.findIndex(([, low, high]) => y >= low && y <= high), column = Math.max(0, Math.min(v.nx - 1, Math.round((x - v.x0) / v.dx)));
      if (row < 0) state.outside = `${sig(y, 4)} rpm: not measured.`;
      return row < 0 ? null : { row, column };
    }
    let best = null, least = Infinity;
    v.orders.forEach((o, n) => v.speed.forEach((s, k) => {
      const value = v.amplitude[track(n, k)];
      if (!(value > 0)) return;
      const far = Math.hypot(a.px(s) - p[0], a.py(value) - p[1]);
      if (far < least) { least = far; best = { order: n, speed: k }; }
    }));
    return best;
  };
  const fix = () => { const read = reading(); if (read) { state.rpm = read.rpm; state.order = read.order; const near = own(D.orders).find((o) => Math.abs(o.order - read.order) * read.rpm / 60 <= (isMap() ? 1.5 * (view().kind === "order" ? view().dx * read.rpm / 60 : view().dx) : 0.01)); if (near) state.order = near.order; } };
  const begin = () => {
    const strongest = own(D.orders).reduce((b, o) => (!b || o.size > b.size ? o : b), null);
    state.rpm = strongest && strongest.at ? strongest.at : isMap() ? view().rows[view().rows.length - 1][0] : view().speed[view().speed.length - 1];
    state.order = strongest ? strongest.order : 1;
  };
  const local = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  canvas.addEventListener("pointermove", (event) => {
    const p = local(event);
    if (state.drag) {
      if (event.shiftKey || state.drag.pan) { pan(state.drag.last[0] - p[0], state.drag.last[1] - p[1]); state.drag.last = p; state.drag.pan = true; }
      else if (Math.hypot(p[0] - state.drag.from[0], p[1] - state.drag.from[1]) > 5) state.drag.to = p;
    } else state.at = place(p);
    tell(false); redraw();
  });
  canvas.addEventListener("pointerdown", (event) => { if (event.pointerType === "touch" || event.button) return; const p = local(event); state.drag = { from: p, last: p }; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", (event) => {
    const drag = state.drag, p = local(event);
    state.drag = null;
    if (drag && drag.to) { const a = main(), x = [a.vx(drag.from[0]), a.vx(p[0])].sort((m, n) => m - n), y = [a.vy(drag.from[1]), a.vy(p[1])].sort((m, n) => m - n); setBox(x, y); }
    else if (!drag || !drag.pan) { state.at = place(p) || state.at; fix(); tell(true); }
    redraw();
  });
  canvas.addEventListener("pointercancel", () => { state.drag = null; redraw(); });
  canvas.addEventListener("pointerleave", () => { if (!state.drag && document.activeElement !== canvas) { state.at = null; state.outside = ""; tell(false); redraw(); } });
  canvas.addEventListener("dblclick", () => { state.box = null; redraw(); });
  canvas.addEventListener("wheel", (event) => {
    if (event.deltaY > 0 && !state.box) return; // nothing to zoom out of: the page scrolls on
    event.preventDefault(); zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY / 300))), local(event));
  }, { passive: false });
  const step = (dx, dy) => {
    const v = view(), a = main();
    if (!state.at) {
      if (isMap()) state.at = { row: rowAt(v, state.rpm), column: Math.max(0, Math.min(v.nx - 1, Math.round((across(v, (state.order * state.rpm) / 60, state.rpm) - v.x0) / v.dx))) };
      else state.at = { order: Math.max(0, v.orders.findIndex((o) => o.order === state.order)), speed: v.speed.reduce((b, s, k) => (Math.abs(s - state.rpm) < Math.abs(v.speed[b] - state.rpm) ? k : b), 0) };
    } else if (isMap()) {
      state.at.column = Math.max(0, Math.min(v.nx - 1, state.at.column + dx)); state.at.row = Math.max(0, Math.min(v.rows.length - 1, state.at.row + dy));
    } else {
      state.at.speed = Math.max(0, Math.min(v.speed.length - 1, state.at.speed + dx)); state.at.order = Math.max(0, Math.min(v.orders.length - 1, state.at.order + dy));
    }
    const read = reading(), x = isMap() ? across(v, read.hz, read.rpm) : read.rpm, half = (a.x[1] - a.x[0]) / 2;
    if (state.box && (x < a.x[0] || x > a.x[1] || (isMap() && (read.rpm < a.y[0] || read.rpm > a.y[1])))) {
      const tall = (a.y[1] - a.y[0]) / 2; setBox([x - half, x + half], isMap() ? [read.rpm - tall, read.rpm + tall] : a.y);
    }
    tell(true); redraw();
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }, go = arrows[event.key];
    if (go && event.shiftKey) pan(60 * go[0], -60 * go[1]);
    else if (go) step(...go);
    else if (event.key === "PageUp" || event.key === "PageDown") step(event.key === "PageUp" ? -10 : 10, 0);
    else if (event.key === "+" || event.key === "=") zoom(1 / 1.5, cursor());
    else if (event.key === "-" || event.key === "_") zoom(1.5, cursor());
    else if (event.key === "0" || event.key === "Escape") { state.box = null; redraw(); }
    else if (event.key === "Enter" || event.key === " ") { fix(); tell(true); redraw(); }
    else return;
    event.preventDefault();
  });
  const cursor = () => { const read = reading(), a = main(); return read && isMap() ? [a.px(across(view(), read.hz, read.rpm)), a.py(read.rpm)] : null; };

  // controls
  const choose = $("live-channel");
  D.channels.forEach((one, n) => { const option = document.createElement("option"); option.value = n; option.textContent = one.name; choose.append(option); });
  const fits = (v) => state.channel < v.largest.length;
  const pick = $("live-view");
  views.forEach((one, n) => { const option = document.createElement("option"); option.value = n; option.textContent = one.title; pick.append(option); });
  const changed = () => {
    state.box = null; state.at = null; state.outside = "";
    for (const id of ["orders", "modes", "crossings"]) $(`live-${id}`).disabled = !isMap();
    canvas.setAttribute("aria-label", `${view().title}, ${D.channels[state.channel].name}. Arrow keys move from cell to cell, Enter sets the cursors, plus and minus zoom, 0 shows all.`);
    tell(false); redraw();
  };
  choose.addEventListener("change", () => { state.channel = Number(choose.value); if (!fits(view())) { pick.value = state.view = Math.max(0, views.findIndex(fits)); } begin(); changed(); });
  pick.addEventListener("change", () => { state.view = Number(pick.value); if (!fits(view())) { choose.value = state.channel = 0; begin(); } changed(); });
  $("live-scale").addEventListener("change", () => { state.db = $("live-scale").value === "db"; state.box = isMap() ? state.box : null; redraw(); });
  for (const id of ["orders", "modes", "crossings"]) $(`live-${id}`).addEventListener("change", (event) => { shown[id] = event.target.checked; redraw(); });
  $("live-in").addEventListener("click", () => zoom(1 / 1.5)); $("live-out").addEventListener("click", () => zoom(1.5));
  $("live-all").addEventListener("click", () => { state.box = null; redraw(); });
  const folded = [];
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("main > details.table:not([open])").forEach((one) => { folded.push(one); one.open = true; });
    state.paper = true; draw();
  });
  window.addEventListener("afterprint", () => { folded.splice(0).forEach((one) => (one.open = false)); state.paper = false; draw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  const loudest = D.orders.filter((o) => D.channels[o.channel].unit === D.channels[0].unit).reduce((b, o) => (!b || o.size > b.size ? o : b), null);
  if (loudest) choose.value = state.channel = loudest.channel;
  if (!fits(view())) choose.value = state.channel = 0;
  begin();
  $("live").hidden = false;
  $("stills").open = false;
  changed();
  draw();
  new ResizeObserver(redraw).observe(canvas);
})();
