// Curves over one horizontal axis, by uPlot: least and greatest of each pixel are drawn, so that no peak is lost.
import uPlot from "./vendor/uPlot.esm.js";
import { el } from "./common.js";

export const INKS = ["--c-blue", "--vermillion", "--green", "--purple", "--orange", "--sky", "--black", "--yellow"];
const ink = (name) => getComputedStyle(document.body).getPropertyValue(name);

// A colour that depends on light and dark, as a canvas needs it.
export function resolved(name) {
  const probe = document.body.appendChild(document.createElement("i"));
  probe.style.color = `var(${name})`;
  const made = getComputedStyle(probe).color;
  probe.remove();
  return made || ink(name);
}

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

// Charts of one group have one horizontal axis and one cursor.
export class Curves {
  constructor(parent, { title, unit, names, t, ys, group }) {
    this.holder = el("div", { class: "plot", role: "group", "aria-label": `${title}: ${names.join(", ")}` }, parent);
    el("h3", {}, this.holder, unit ? `${title}, ${unit}` : title);
    this.holder.curves = this;
    Object.assign(this, { t, ys, names, group, full: [t[0], t[t.length - 1]] });
    group.add(this);
    this.make();
    document.addEventListener("colours", () => this.make());
    new ResizeObserver(() => { if (Math.abs(this.width - this.chart.width) > 1) this.chart.setSize({ width: this.width, height: 240 }); }).observe(this.holder);
  }

  get width() { return Math.max(240, this.holder.clientWidth); }

  make() {
    const view = this.chart ? [this.chart.scales.x.min, this.chart.scales.x.max] : this.full;
    this.chart?.destroy();
    const axis = { stroke: resolved("--soft"), grid: { stroke: resolved("--grid"), width: 1 }, ticks: { stroke: resolved("--line") } };
    this.chart = new uPlot({
      width: this.width, height: 240, scales: { x: { time: false } }, axes: [axis, { ...axis, size: 62 }],
      cursor: { sync: { key: "log" }, drag: { x: true, y: false, setScale: false } },
      series: [{ label: "t, s" }, ...this.names.map((label, k) => ({ label, stroke: resolved(INKS[k % INKS.length]), width: 1, points: { show: false }, spanGaps: false }))],
      hooks: { setSelect: [(u) => { if (u.select.width > 3) this.all(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")); u.setSelect({ width: 0, height: 0 }, false); }] },
    }, thin(this.t, this.ys, ...view, this.width), this.holder);
    this.chart.ctx.canvas.setAttribute("aria-hidden", "true"); // its holder is named, its numbers are in the legend
    this.chart.over.addEventListener("dblclick", () => this.all(...this.full));
    this.show(...view);
  }

  show(from, to) {
    this.chart.batch(() => {
      this.chart.setData(thin(this.t, this.ys, from, to, this.width), false);
      this.chart.setScale("x", { min: from, max: to });
    });
  }

  all(from, to) {
    for (const one of this.group) one.show(from, to);
    this.holder.dispatchEvent(new CustomEvent("view", { bubbles: true, detail: [from, to] }));
  }
}
