// Curves over one horizontal axis, of whole logs and of streams, by uPlot, which no other module knows. Least and greatest
// of each pixel are drawn, so that no peak is lost.
import uPlot from "./vendor/uPlot.esm.js";
import { el } from "./common.js";
import { resolved } from "/report/charts.js";

const INKS = ["c-blue", "vermillion", "green", "purple", "orange", "sky", "black", "yellow"];

function lower(t, value) {
  let [a, b] = [0, t.length];
  while (a < b) { const m = (a + b) >> 1; if (t[m] < value) a = m + 1; else b = m; }
  return a;
}

// Samples between two times as they are where there are few, else least and greatest of each of `width` runs.
export function thin(t, ys, from, to, width) {
  const i0 = Math.max(0, lower(t, from) - 1), i1 = Math.min(t.length - 1, lower(t, to) + 1), n = i1 - i0 + 1;
  if (n <= 4 * width) return [t.subarray(i0, i1 + 1), ...ys.map((y) => y.subarray(i0, i1 + 1))];
  const start = (c) => i0 + Math.floor((c * n) / width);
  const x = new Float64Array(2 * width);
  for (let c = 0; c < width; c++) x[2 * c] = x[2 * c + 1] = t[start(c)];
  return [x, ...ys.map((y) => {
    const made = new Float32Array(2 * width);
    for (let c = 0; c < width; c++) {
      let lo = NaN, hi = NaN;
      for (let i = start(c), end = start(c + 1); i < end; i++) { const v = y[i]; if (!(v >= lo)) lo = v === v ? v : lo; if (!(v <= hi)) hi = v === v ? v : hi; }
      made[2 * c] = lo; made[2 * c + 1] = hi;
    }
    return made;
  })];
}

// A chart under its title, as wide as its place, in the colours of the page.
class Chart {
  constructor(parent, { title, unit, names }, height) {
    this.holder = el("div", { class: "plot", role: "group", "aria-label": `${title}: ${names.join(", ")}` }, parent);
    el("h3", {}, this.holder, unit ? `${title}, ${unit}` : title);
    this.names = names;
    this.plain = height;
    this.chart = null;
    document.addEventListener("colours", () => this.make());
    new ResizeObserver(() => {
      if (!this.chart) return;
      if (this.scale !== this.drawn) this.make();
      else if (Math.abs(this.width - this.chart.width) > 1) this.chart.setSize({ width: this.width, height: this.height });
    }).observe(this.holder);
  }

  get width() { return Math.max(240, this.holder.clientWidth); }

  get scale() { return parseFloat(getComputedStyle(document.documentElement).fontSize) / 16; } // larger on large screens

  get height() { return this.plain * this.scale; }

  make() {} // of each kind, again when the colours change

  // A new chart of uPlot in place of the last, with options beside those of all charts, and of each curve.
  begin(data, options, curve) {
    this.chart?.destroy();
    this.drawn = this.scale;
    const axis = { font: `${12 * this.scale}px system-ui, sans-serif`, size: 50 * this.scale, stroke: resolved("soft"), grid: { stroke: resolved("grid"), width: 1 }, ticks: { stroke: resolved("line") } };
    const ink = (k) => resolved(INKS[k % INKS.length]);
    const lines = this.names.map((label, k) => ({ label, stroke: ink(k), width: 1, points: { show: false }, spanGaps: false, ...curve(k, ink) }));
    this.chart = new uPlot({
      width: this.width, height: this.height, scales: { x: { time: false } }, axes: [axis, { ...axis, size: 62 * this.scale }],
      series: [{ label: "t, s" }, ...lines], ...options,
    }, data, this.holder);
    this.chart.ctx.canvas.setAttribute("aria-hidden", "true"); // its holder is named, its numbers are in the legend
  }

  put(data, min, max) {
    this.holder.dataset.points = String(data[0].length);
    this.chart.batch(() => {
      this.chart.setData(data, false);
      this.chart.setScale("x", { min, max });
    });
  }
}

// A whole log. Charts of one group have one horizontal axis and one cursor.
export class Curves extends Chart {
  constructor(parent, { title, unit, names, t, ys, group }) {
    super(parent, { title, unit, names }, 240);
    this.t = t;
    this.ys = ys;
    this.group = group;
    this.full = [t[0], t[t.length - 1]];
    group.add(this);
    this.holder.tabIndex = 0;
    this.holder.addEventListener("keydown", (event) => this.key(event));
    this.make();
  }

  get view() { return [this.chart.scales.x.min, this.chart.scales.x.max]; }

  // As in the report: arrows move the cursor, with shift the view; + and - zoom about the cursor, 0 shows all.
  key(event) {
    const [from, to] = this.view, wide = to - from, way = event.key === "ArrowLeft" ? -1 : 1;
    const inside = this.at >= from && this.at <= to ? this.at : (from + to) / 2;
    const zoom = (factor) => this.all(inside - (factor * wide) / 2, inside + (factor * wide) / 2);
    const move = () => (event.shiftKey ? this.all(from + 0.2 * way * wide, to + 0.2 * way * wide) : this.read(inside + 0.01 * way * wide));
    const acts = { ArrowLeft: move, ArrowRight: move, "+": () => zoom(0.5), "-": () => zoom(2), 0: () => this.all(...this.full) };
    if (!acts[event.key] || event.target !== this.holder || event.ctrlKey || event.metaKey) return;
    acts[event.key]();
    event.preventDefault();
  }

  // The cursor at a time, in all charts.
  read(t) {
    this.at = Math.min(Math.max(t, this.view[0]), this.view[1]);
    this.chart.setCursor({ left: this.chart.valToPos(this.at, "x"), top: 0 }, true, true);
  }

  make() {
    const [from, to] = this.chart ? this.view : this.full;
    const chosen = (u) => {
      const { left, width } = u.select;
      if (width > 3) this.all(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
      u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    };
    this.begin(thin(this.t, this.ys, from, to, this.width), {
      cursor: { sync: { key: "log" }, drag: { x: true, y: false, setScale: false } }, hooks: { setSelect: [chosen] },
    }, () => ({}));
    this.chart.over.addEventListener("dblclick", () => this.all(...this.full));
    this.show(from, to);
  }

  show(from, to) {
    this.put(thin(this.t, this.ys, from, to, this.width), from, to);
  }

  // A stretch in all charts, within the log and at least some samples wide; said by an event `view`.
  all(from, to) {
    const [first, last] = this.full, wide = Math.min(Math.max(to - from, (10 * (last - first)) / this.t.length), last - first);
    const start = Math.min(Math.max(from, first), last - wide);
    for (const one of this.group) one.show(start, start + wide);
    this.holder.dispatchEvent(new CustomEvent("view", { bubbles: true, detail: wide < last - first ? [start, start + wide] : null }));
  }
}

// Samples of the last seconds, contiguous in memory: twice the room, moved to the front when it is full.
export class Ring {
  constructor(channels, room) {
    this.room = room;
    this.from = this.to = 0;
    this.times = new Float64Array(2 * room);
    this.values = Array.from({ length: channels }, () => new Float32Array(2 * room));
  }

  append(t, ys) {
    const n = t.length, cut = Math.max(0, n - this.room);
    if (this.to + n - cut > 2 * this.room) {
      const keep = Math.min(this.to - this.from, this.room);
      for (const array of [this.times, ...this.values]) array.copyWithin(0, this.to - keep, this.to);
      this.from = 0;
      this.to = keep;
    }
    this.times.set(t.subarray(cut), this.to);
    this.values.forEach((array, k) => array.set(ys[k].subarray(cut), this.to));
    this.to += n - cut;
    this.from = Math.max(this.from, this.to - this.room);
  }

  get t() { return this.times.subarray(this.from, this.to); }
  get ys() { return this.values.map((array) => array.subarray(this.from, this.to)); }
  get last() { return this.to > this.from ? this.times[this.to - 1] : 0; }
}

// The last seconds of some channels of a ring.
export class Rolling extends Chart {
  constructor(parent, { title, unit, names, ring, channels, seconds, dashed = [] }) {
    super(parent, { title, unit, names }, 200);
    this.ring = ring;
    this.channels = channels;
    this.seconds = seconds;
    this.dashed = dashed;
    this.make();
  }

  make() {
    const pairs = this.dashed.length > 0;
    this.begin([[], ...this.names.map(() => [])], { cursor: { show: false }, legend: { live: false } }, (k, ink) => ({
      stroke: ink(pairs ? Math.floor(k / 2) : k), ...(this.dashed.includes(k) && { dash: [6, 4] }),
    }));
  }

  // Draws what is seen at a time.
  draw(now) {
    const { t, ys } = this.ring;
    if (t.length) this.put(thin(t, this.channels.map((k) => ys[k]), now - this.seconds, now, this.width), now - this.seconds, now);
  }
}
