"use strict";
// Report page: a filter for each long table; Campbell diagram and order map, cuts beside it.
const $ = (id) => document.getElementById(id), root = document.documentElement;

// a long table shows the rows that hold every word typed
for (const table of document.querySelectorAll(".scroll.long")) {
  table.insertAdjacentHTML("beforebegin", '<label>Filter <input type="search"> <output></output></label>');
  const [field, count] = table.previousElementSibling.children, rows = [...table.querySelectorAll("tbody tr")];
  field.oninput = () => {
    const words = field.value.toLowerCase().split(/\s+/);
    for (const row of rows) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
    count.value = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
    table.classList.toggle("filtered", Boolean(field.value));
  };
}

const D = $("live-data") && JSON.parse($("live-data").textContent);
const STEP_DB = 0.005, TOP = 60000; // code of a channel's largest cell; 0: nothing
const canvas = $("live-map"), side = $("live-cuts");
let view, channel, db, rpm, order, at = null, box = null, drag = null; // at: row and column; box: ranges, null for all
let pen, scale, axes;
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const list = (length, entry) => Array.from({ length }, (_, k) => entry(k));
const clamp = (value, low, high) => Math.max(low, Math.min(high, value));
const within = (value, range) => !range || (value >= range[0] && value <= range[1]);
const sig = (value, digits = 3) => String(Number(value.toPrecision(digits))).replace(/e\+?/, "·10^").replace(/-/g, "−");

// drawing
const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`);
const begin = (sheet) => {
  pen = sheet.getContext("2d");
  scale = root.classList.contains("paper") ? 3 : window.devicePixelRatio;
  Object.assign(sheet, { width: sheet.clientWidth * scale, height: sheet.clientHeight * scale });
  pen.scale(scale, scale);
  style({ font: "12px system-ui, sans-serif", textBaseline: "middle" });
};
const style = (given) => Object.assign(pen, given);
const write = (text, x, y, align = "center", ink = colour("ink")) =>
  style({ textAlign: align, fillStyle: ink }).fillText(text, x, y);
const ticks = ([low, high], most) => {
  const raw = (high - low) / most, size = 10 ** Math.floor(Math.log10(raw)), step = size * [1, 2, 5, 10].find((n) => n * size >= raw);
  const first = Math.ceil(low / step - 1e-9), count = Math.floor(high / step + 1e-9) - first + 1;
  return list(count, (k) => [(first + k) * step, sig((first + k) * step, 9)]);
};
const axis = (from, to, range) => ({
  from, to, range, at: (value) => from + ((value - range[0]) / (range[1] - range[0])) * (to - from),
  of: (p) => range[0] + ((p - from) / (to - from)) * (range[1] - range[0]),
});
const frame = ([x, y], xLabel, title) => {
  style({ strokeStyle: colour("faint"), lineWidth: 1 }).strokeRect(x.from, y.to, x.to - x.from, y.from - y.to);
  for (const [value, text] of ticks(x.range, (x.to - x.from) / 70)) {
    write(text, x.at(value), y.from + 12);
    pen.fillRect(x.at(value), y.from, 1, 4);
  }
  for (const [value, text] of ticks(y.range, (y.from - y.to) / 32)) {
    write(text, x.from - 6, y.at(value), "right");
    pen.fillRect(x.from - 4, y.at(value), 4, 1);
  }
  write(xLabel, (x.from + x.to) / 2, y.from + 28);
  write(title, 2, y.to - 14, "left");
};
const curve = ([x, y], points, ink, width = 1, alpha = 1, dashes = []) => {
  pen.save();
  pen.beginPath();
  pen.rect(x.from, y.to, x.to - x.from, y.from - y.to);
  pen.clip();
  style({ strokeStyle: ink, lineWidth: width, globalAlpha: alpha }).setLineDash(dashes);
  pen.beginPath();
  for (const [across, up] of points) pen.lineTo(x.at(across), y.at(up));
  pen.stroke();
  pen.restore();
};
const isShown = (values) => axes.every(({ range }, k) => within(values[k], range));

// an order is a line with that slope, a natural frequency one with slope 0
const perHertz = (speed) => (view.kind === "order" ? 60 / speed : 1);
const xOf = (line, speed) => perHertz(speed) * hertzOf(line, speed);
const hertzOf = (line, speed) => line.hz + (line.slope * (speed - line.from_rpm)) / 60;
const cursor = () => ({ hz: 0, slope: order, from_rpm: 0 });
const here = (record) => record.channels.includes(channel);
const decibel = (amplitude) => 20 * Math.log10(Math.max(amplitude, 1e-300) / D.channels[channel].reference);
const amplitude = (row, column) => {
  const code = view.codes[channel][row * view.nx + column];
  return code ? view.largest[channel] * 10 ** (((code - TOP) * STEP_DB) / 20) : 0;
};
const columnOf = (x) => clamp(Math.round((x - view.x0) / view.dx), 0, view.nx - 1);
const rowOf = (speed) => view.rows.findIndex((cell) => within(speed, cell.slice(1)));

// what is in the cell, and what the findings say of it
const reading = () => {
  const [row, column] = at, [speed] = view.rows[row], x = view.x0 + column * view.dx, a = amplitude(row, column);
  const hz = x / perHertz(speed), order = (60 * hz) / speed, near = (1.5 * view.dx) / perHertz(speed);
  const meets = (r) => within(speed, r.range) && !(Math.abs(hertzOf(r, speed) - hz) > Math.max(near, r.half));
  const pick = (records, most) => records.filter(meets).slice(0, most).map((record) => `${record.text}.`), own = D.orders.filter(here);
  const level = a > 0 ? `${sig(a)} ${D.channels[channel].unit} · ${decibel(a).toFixed(1)} dB` : "no signal";
  const said = [...pick(own, 2), ...pick(D.fixed, 2), ...pick(D.crossings, 1)];
  return {
    spot: [x, speed], order: own.find(meets)?.slope ?? order, head: `${sig(speed, 4)} rpm · ${sig(hz, 4)} Hz · order ${sig(order, 4)} · ${level}`,
    text: [...(said.length ? said : pick(D.lines.filter(here), 1)), ...pick(D.bands, 1)].join(" "),
  };
};
const tell = () => {
  const { head, text } = at ? reading() : { head: "", text: D.hint };
  $("live-head").textContent = head;
  $("live-text").textContent = text;
  draw();
};

// a pixel column of the map shows its largest cell: no thin line is lost
const drawMap = ([x, y], range) => {
  const [wide, gap, bar, tall] = [x.to - x.from, 8, 9, y.from - y.to].map((size) => Math.round(size * scale)), all = wide + gap + bar;
  const image = new ImageData(all, tall), sheet = new OffscreenCanvas(all, tall), pixels = new Uint32Array(image.data.buffer).fill(0xff9e948a);
  const line = new Uint32Array(wide), codes = view.codes[channel], most = decibel(view.largest[channel]);
  const edge = list(wide + 1, (k) => columnOf(x.of(x.from + k / scale)));
  view.rows.forEach(([, slow, fast], row) => {
    const [from, to] = [fast, slow].map((speed) => clamp(Math.round((y.at(speed) - y.to) * scale), 0, tall));
    for (let k = 0; k < wide && from < to; k++) {
      let code = 0;
      for (let c = edge[k]; c === edge[k] || c < edge[k + 1]; c++) code = Math.max(code, codes[row * view.nx + c]);
      const level = (code - TOP) * STEP_DB, share = db ? (most + level - range[0]) / (range[1] - range[0]) : 10 ** (level / 20);
      line[k] = D.paint[code && clamp(Math.round(255 * share), 0, 255)];
    }
    for (let p = from; p < to; p++) pixels.set(line, p * all);
  });
  for (let p = 0; p < tall; p++) {
    pixels.fill(0, p * all + wide, p * all + wide + gap);
    pixels.fill(D.paint[Math.round(255 * (1 - p / tall))], p * all + wide + gap, (p + 1) * all);
  }
  sheet.getContext("2d").putImageData(image, 0, 0);
  pen.drawImage(sheet, x.from, y.to, all / scale, tall / scale); // pixels alone are not printed
  for (const [value, text] of ticks(range, 6)) write(text, x.to + 20, axis(y.from, y.to, range).at(value), "left");
  write(db ? "dB" : D.channels[channel].unit, canvas.clientWidth - 2, y.to - 14, "right");
};
const drawLines = () => {
  const [x, y] = axes, speeds = list(41, (k) => y.of(y.from + (k / 40) * (y.to - y.from))).filter((speed) => speed > 0);
  const pointsOf = (line) => speeds.map((speed) => [xOf(line, speed), speed]);
  const asked = (name, records) => ($(`live-${name}`).checked ? records : []);
  const lines = [...asked("orders", D.orders.filter(here)), ...asked("modes", D.fixed)], taken = [[0, 78, y.to - 14]];
  for (const line of lines) curve(axes, pointsOf(line), line.colour, 1, here(line) ? line.alpha : line.alpha / 2, line.dashes);
  curve(axes, pointsOf(cursor()), "#7dff9a");
  curve(axes, x.range.map((end) => [end, rpm]), "#7dff9a");
  const circles = asked("crossings", D.crossings.filter(here)).map((met) => [xOf(met, met.rpm), met.rpm, "#66e0ff"]);
  for (const [across, up, ink] of at ? [...circles, [...reading().spot, "white"]] : circles) {
    if (!isShown([across, up])) continue;
    style({ strokeStyle: ink, lineWidth: 2 }).beginPath();
    pen.arc(x.at(across), y.at(up), 6, 0, 7);
    pen.stroke();
  }
  for (const { label, ink, ...line } of lines) {
    const end = pointsOf(line).findLast(([value]) => within(value, x.range)), half = pen.measureText(label).width / 2 + 2;
    if (!end) continue;
    const px = Math.min(x.at(end[0]), x.to - half), py = ink ? y.to - 14 : y.at(end[1]) + 9;
    if (taken.some(([left, right, up]) => px + half > left && px - half < right && Math.abs(up - py) < 14)) continue;
    taken.push([px - half, px + half, py]);
    if (!ink) style({ fillStyle: "#00000099" }).fillRect(px - half, py - 7, 2 * half, 14);
    write(label, px, py, "center", ink ? colour(ink) : "white");
  }
};

// spectrum at the speed and amplitude along the order of the cursors
const cut = (half, across, amplitudes, xLabel, title, mark) => {
  const points = amplitudes.map(([value, a]) => [value, db ? decibel(a) : a]), h = side.clientHeight / 2;
  const seen = points.filter(([value]) => within(value, across)).map(([, level]) => level), top = Math.max(...seen);
  const up = db ? [Math.max(Math.min(...seen), top - 100) - 3, top + 3] : [0, 1.08 * top];
  const both = [axis(66, side.clientWidth - 20, across), axis(half * h + h - 42, half * h + 28, up)];
  curve(both, points, colour("accent"));
  curve(both, up.map((level) => [mark, level]), colour("faint"));
  frame(both, xLabel, `${title}: ${db ? "level, dB" : `amplitude, ${D.channels[channel].unit}`}`);
};
const drawCuts = () => {
  begin(side);
  const row = Math.max(0, rowOf(rpm)), [speed] = view.rows[row], xAt = (value) => xOf(cursor(), value);
  const spectrum = list(view.nx, (c) => [view.x0 + c * view.dx, amplitude(row, c)]);
  const peak = (r, x) => Math.max(...[-1, 0, 1].map((k) => amplitude(r, columnOf(x + k * view.dx))));
  const along = view.rows.map(([value], r) => [value, peak(r, xAt(value))]).filter(([value]) => within(xAt(value), whole()[0]));
  cut(0, axes[0].range, spectrum, view.label, `Spectrum at ${sig(speed, 4)} rpm`, xAt(speed));
  cut(1, axes[1].range, along, "Speed, rpm", `Along order ${sig(order, 4)}`, rpm);
};
const whole = () => [[view.x0, view.x0 + (view.nx - 1) * view.dx], [view.rows[0][1], view.rows.at(-1)[2]]];
const draw = () => {
  db = $("live-scale").value === "db";
  const ranges = box || whole(), range = db ? view.limits[channel] : [0, view.largest[channel] || 1];
  begin(canvas);
  axes = [axis(66, canvas.clientWidth - 70, ranges[0]), axis(canvas.clientHeight - 40, 28, ranges[1])];
  drawMap(axes, range);
  drawLines();
  frame(axes, view.label, "Speed, rpm");
  if (drag?.to) style({ strokeStyle: "white" }).strokeRect(...drag.from, ...drag.to.map((p, k) => p - drag.from[k]));
  drawCuts();
};

// zoom
const show = (ranges) => {
  const all = whole(), size = ([low, high]) => Math.abs(high - low);
  box = ranges && all.map(([first, last], k) => {
    const wide = Math.min(size(ranges[k]), last - first), from = clamp(Math.min(...ranges[k]), first, last - wide);
    return [from, from + wide];
  });
  if (box?.every((range, k) => size(range) > 0.999 * size(all[k]))) box = null;
  draw();
};
const showAll = () => show();
const middle = ({ from, to }) => (from + to) / 2;
const move = (moved) => show(axes.map(({ from, to, of }, k) => [from, to].map((p) => of(moved(p, k)))));
const zoom = (factor, about = axes.map(middle)) => move((p, k) => about[k] + (p - about[k]) * factor);
const place = (event) => [event.offsetX, event.offsetY];
const point = (event) => {
  const values = place(event).map((p, k) => axes[k].of(p)), row = rowOf(values[1]);
  at = row >= 0 && isShown(values) ? [row, columnOf(values[0])] : null;
};
const fix = () => {
  if (at) ({ spot: [, rpm], order } = reading());
  tell();
};
const step = (right, up) => {
  at = at ? [clamp(at[0] + up, 0, view.rows.length - 1), clamp(at[1] + right, 0, view.nx - 1)] : [Math.max(0, rowOf(rpm)), columnOf(xOf(cursor(), rpm))];
  const { spot } = reading(), off = spot.map((value, k) => axes[k].at(value) - middle(axes[k]));
  if (!isShown(spot)) move((p, k) => p + off[k]);
  fix();
};
const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const fill = (select, records, chosen) => select.replaceChildren(...records.map(({ name }, n) => new Option(name, n, false, n === chosen)));
const choose = () => {
  const select = $("live-channel");
  view = D.maps[$("live-view").value];
  fill(select, D.channels.slice(0, view.largest.length), Number(select.value || D.first));
  channel = Number(select.value);
  ({ rpm, order } = D.channels[channel]);
  box = at = null;
  tell();
};
if (D) {
  D.paint = new Uint32Array(bytes(D.colours));
  for (const map of D.maps) map.codes = map.cells.map((text) => new Uint16Array(bytes(text)));
  fill($("live-view"), D.maps, 0);
  $("live").hidden = $("stills").open = false;
  choose();
  canvas.onpointerdown = (event) => {
    if (event.pointerType === "touch" || event.button) return;
    drag = { from: place(event) };
    canvas.setPointerCapture(event.pointerId);
  };
  canvas.onpointermove = (event) => {
    if (!drag) point(event);
    else if (Math.abs(event.offsetX - drag.from[0]) > 5) drag.to = place(event);
    tell();
  };
  canvas.onpointerup = (event) => {
    const { from, to } = drag || {};
    drag = null;
    if (to) return show(axes.map(({ of }, k) => [from[k], to[k]].map(of)));
    point(event);
    fix();
  };
  canvas.ondblclick = showAll;
  canvas.onwheel = (event) => {
    if (event.deltaY > 0 && !box) return;
    event.preventDefault();
    zoom(Math.exp(clamp(event.deltaY / 300, -1, 1)), place(event));
  };
  canvas.onkeydown = (event) => {
    const does = arrows[event.key], button = { "+": "in", "-": "out", 0: "all" }[event.key];
    if (!(does || button) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (does) step(...does);
    else $(`live-${button}`).click();
  };
  $("live-in").onclick = () => zoom(1 / 1.5);
  $("live-out").onclick = () => zoom(1.5);
  $("live-all").onclick = showAll;
  $("live-view").onchange = $("live-channel").onchange = choose;
  $("live").onchange = draw;
  window.onbeforeprint = window.onafterprint = (event) => draw(root.classList.toggle("paper", event.type === "beforeprint"));
  new ResizeObserver(draw).observe(canvas);
}
