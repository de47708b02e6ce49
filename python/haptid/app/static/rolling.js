// Rolling curves: the last seconds of a stream, least and greatest of each pixel, drawn at most thirty times a second.
import uPlot from "./vendor/uPlot.esm.js";
import { el } from "./common.js";
import { INKS, resolved, thin } from "./series.js";

// Samples of the last seconds, contiguous in memory: twice the room, moved to the front when it is full.
export class Ring {
  constructor(channels, room) {
    Object.assign(this, { room, from: 0, to: 0, times: new Float64Array(2 * room) });
    this.values = Array.from({ length: channels }, () => new Float32Array(2 * room));
  }

  append(t, ys) {
    const n = t.length, cut = Math.max(0, n - this.room);
    if (this.to + n - cut > 2 * this.room) {
      const keep = Math.min(this.to - this.from, this.room);
      for (const array of [this.times, ...this.values]) array.copyWithin(0, this.to - keep, this.to);
      Object.assign(this, { from: 0, to: keep });
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

// A chart of some channels of a ring; `seconds` of it are seen.
export class Rolling {
  constructor(parent, { title, unit, names, ring, channels, seconds, dashed = [] }) {
    Object.assign(this, { ring, channels, seconds, names, dashed });
    this.holder = el("div", { class: "plot", role: "group", "aria-label": `${title}: ${names.join(", ")}` }, parent);
    el("h3", {}, this.holder, unit ? `${title}, ${unit}` : title);
    this.make();
    this.colours = () => this.make();
    document.addEventListener("colours", this.colours);
    new ResizeObserver(() => { if (Math.abs(this.width - this.chart.width) > 1) this.chart.setSize({ width: this.width, height: 200 }); }).observe(this.holder);
  }

  get width() { return Math.max(240, this.holder.clientWidth); }

  make() {
    this.chart?.destroy();
    const axis = { stroke: resolved("--soft"), grid: { stroke: resolved("--grid"), width: 1 }, ticks: { stroke: resolved("--line") } };
    const line = (label, k) => ({
      label, width: 1, points: { show: false }, spanGaps: false, stroke: resolved(INKS[(this.dashed.length ? Math.floor(k / 2) : k) % INKS.length]),
      ...(this.dashed.includes(k) && { dash: [6, 4] }),
    });
    this.chart = new uPlot({
      width: this.width, height: 200, scales: { x: { time: false } }, axes: [axis, { ...axis, size: 62 }], cursor: { show: false }, legend: { live: false },
      series: [{ label: "t, s" }, ...this.names.map(line)],
    }, [[], ...this.names.map(() => [])], this.holder);
    this.chart.ctx.canvas.setAttribute("aria-hidden", "true");
  }

  // Draws what is seen at a time.
  draw(now) {
    const ys = this.ring.ys, t = this.ring.t;
    if (!t.length) return;
    const data = thin(t, this.channels.map((k) => ys[k]), now - this.seconds, now, this.width);
    this.chart.batch(() => {
      this.chart.setData(data, false);
      this.chart.setScale("x", { min: now - this.seconds, max: now });
    });
  }
}
