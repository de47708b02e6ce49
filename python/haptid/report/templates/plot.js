// Lines, scatter, bands and stacked areas over two axes. Horizontal axes of one group are linked.

const groups = new Map();

class Plot {
  constructor(holder, drawing) {
    this.holder = holder;
    this.drawing = drawing;
    this.series = drawing.series.map(decoded);
    stackUp(this.series.filter((s) => s.style === "stack"));
    this.full = this.range();
    this.view = [...this.full];
    legend(holder, drawing.series, (k, on) => { this.series[k].hidden = !on; this.draw(); });
    this.holder.tabIndex = 0;
    this.holder.addEventListener("keydown", (event) => this.key(event));
    if (drawing.zoom) this.addControls();
    this.words = readout(holder);
    if (drawing.group) groups.set(drawing.group, [...(groups.get(drawing.group) ?? []), this]);
  }

  range() {
    const { low, high, log } = this.drawing.x;
    const xs = this.series.flatMap((s) => extent(s.x, log));
    const made = [low ?? Math.min(...xs), high ?? Math.max(...xs)];
    return made[1] > made[0] ? made : [made[0] - 0.5, made[0] + 0.5];
  }

  addControls() {
    const bar = html("div", { class: "controls" }, this.holder);
    button(bar, "+", "zoom in", () => this.zoom(0.5));
    button(bar, "−", "zoom out", () => this.zoom(2));
    button(bar, "⟲", "show all", () => this.show(...this.full));
  }

  // Arrows move a reading line, with shift the view; + and - zoom about the line, 0 shows all.
  key(event) {
    const [a, b] = this.view;
    const step = (event.key === "ArrowLeft" ? -1 : 1) * (event.shiftKey ? 0.2 : 0.01) * (b - a);
    const move = () => (event.shiftKey && this.drawing.zoom ? this.show(a + step, b + step) : this.read((this.cursor ?? (a + b) / 2) + step));
    const acts = { ArrowLeft: move, ArrowRight: move };
    if (this.drawing.zoom) Object.assign(acts, { "+": () => this.zoom(0.5), "-": () => this.zoom(2), 0: () => this.show(...this.full) });
    if (!acts[event.key] || event.target !== this.holder || event.ctrlKey || event.metaKey) return;
    acts[event.key]();
    event.preventDefault();
  }

  read(x) {
    this.cursor = Math.min(Math.max(x, this.view[0]), this.view[1]);
    this.draw();
    this.tell(this.cursor);
  }

  zoom(factor) {
    const [a, b] = this.view;
    const middle = this.cursor >= a && this.cursor <= b ? this.cursor : (a + b) / 2;
    this.show(middle - (factor * (b - a)) / 2, middle + (factor * (b - a)) / 2);
  }

  // Clamped to the full range, at least a ten-thousandth of it wide; all plots of the group follow.
  show(a, b) {
    const [low, high] = this.full;
    const width = Math.min(Math.max(b - a, 1e-4 * (high - low)), high - low);
    const start = Math.min(Math.max(a, low), high - width);
    for (const plot of groups.get(this.drawing.group) ?? [this]) {
      plot.view = [start, start + width];
      plot.draw();
    }
  }

  draw() {
    if (!this.holder.clientWidth) return; // in a folded part of the page: drawn when it is opened
    const { root, width, height } = canvasOf(this.holder, this.drawing.height);
    const box = { left: 62, right: width - 10, top: 8, bottom: height - 36 };
    this.box = box;
    this.x = scale(this.view, [box.left, box.right], this.drawing.x.log);
    this.y = scale(this.heights(), [box.bottom, box.top], this.drawing.y.log);
    const id = `clip-${this.holder.id}`;
    const clip = svg("clipPath", { id }, svg("defs", {}, root));
    svg("rect", { x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top }, clip);
    this.shade(svg("g", { "clip-path": `url(#${id})` }, root));
    axes(root, box, this.x, this.y, this.drawing);
    const inside = svg("g", { "clip-path": `url(#${id})` }, root);
    for (const s of this.series) if (!s.hidden) PAINT[s.style](inside, s, this.x, this.y, box);
    if (this.cursor >= this.view[0] && this.cursor <= this.view[1])
      svg("line", { x1: this.x.at(this.cursor), x2: this.x.at(this.cursor), y1: box.top, y2: box.bottom, class: "cursor" }, root);
    this.listen(root);
  }

  // Vertical range of the visible part.
  heights() {
    const { low, high, log, zero } = this.drawing.y;
    let [a, b] = [Infinity, -Infinity];
    for (const s of this.series.filter((one) => !one.hidden))
      for (const ys of [s.y, s.low, s.high])
        if (ys) ys.forEach((y, k) => {
          if (s.x[k] < this.view[0] || s.x[k] > this.view[1] || !Number.isFinite(y) || (log && y <= 0)) return;
          a = Math.min(a, y);
          b = Math.max(b, y);
        });
    if (!(b >= a)) return [0.1, 1];
    if (log) return [low ?? a / 1.3, high ?? b * 1.3];
    if (zero) [a, b] = [Math.min(a, 0), Math.max(b, 0)];
    const pad = 0.06 * (b - a) || Math.abs(a) || 1;
    return [low ?? a - pad, high ?? b + pad];
  }

  shade(parent) {
    const { top, bottom } = this.box;
    for (const [a, b] of this.drawing.shade ?? []) {
      if (b < this.view[0] || a > this.view[1]) continue;
      svg("rect", { x: this.x.at(a), y: top, width: Math.max(this.x.at(b) - this.x.at(a), 0.5), height: bottom - top, class: "shade" }, parent);
    }
  }

  listen(root) {
    const at = (event) => Math.min(Math.max(event.clientX - root.getBoundingClientRect().left, this.box.left), this.box.right);
    root.addEventListener("pointermove", (event) => this.tell(this.x.back(at(event))));
    root.addEventListener("pointerleave", () => { this.words.textContent = "\u00a0"; });
    if (!this.drawing.zoom) return;
    root.classList.add("zoomable");
    root.addEventListener("dblclick", () => this.show(...this.full));
    root.addEventListener("pointerdown", (event) => {
      const start = at(event);
      const band = svg("rect", { y: this.box.top, height: this.box.bottom - this.box.top, class: "band", x: start, width: 0 }, root);
      root.setPointerCapture(event.pointerId);
      root.onpointermove = (move) => {
        band.setAttribute("x", Math.min(start, at(move)));
        band.setAttribute("width", Math.abs(at(move) - start));
      };
      root.onpointercancel = () => { root.onpointermove = root.onpointerup = null; band.remove(); };
      root.onpointerup = (end) => {
        root.onpointermove = root.onpointerup = null;
        band.remove();
        const [a, b] = [this.x.back(start), this.x.back(at(end))].sort((p, q) => p - q);
        if (Math.abs(at(end) - start) > 5) this.show(a, b);
      };
    });
  }

  tell(x) {
    const parts = this.series.filter((s) => s.style !== "points" && !s.hidden).map((s) => {
      const k = nearest(s.x, x);
      const value = s.raw ?? s.y;
      return `${s.name} ${value ? shown(value[k]) : `${shown(s.low[k])} to ${shown(s.high[k])}`}`;
    });
    this.words.textContent = `${this.drawing.x.label} ${shown(x)} ${this.drawing.x.unit}: ${parts.join(", ")} ${this.drawing.y.unit}`;
  }
}

function decoded(s) {
  const made = { ...s };
  for (const key of ["x", "y", "low", "high"]) if (s[key]) made[key] = numbers(s[key]);
  made.ink = COLOURS[s.colour];
  return made;
}

// Stacks positive parts upwards and negative parts downwards.
function stackUp(parts) {
  if (!parts.length) return;
  const up = new Float64Array(parts[0].x.length), down = new Float64Array(parts[0].x.length);
  for (const s of parts) {
    s.raw = s.y;
    s.low = new Float64Array(s.raw.length);
    s.high = new Float64Array(s.raw.length);
    s.y = null;
    s.raw.forEach((y, k) => {
      const base = y >= 0 ? up : down;
      s.low[k] = base[k];
      base[k] += y;
      s.high[k] = base[k];
    });
  }
}

function extent(xs, log) {
  const known = Array.from(xs).filter((x) => Number.isFinite(x) && (!log || x > 0));
  return known.length ? [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))] : [0, 1];
}

function scale([low, high], [start, end], log) {
  const f = log ? Math.log10 : (v) => v;
  const g = log ? (v) => 10 ** v : (v) => v;
  const ratio = (end - start) / (f(high) - f(low));
  return {
    low, high, at: (v) => start + ratio * (f(v) - f(low)), back: (p) => g(f(low) + (p - start) / ratio),
    ticks: (pixels) => (log ? logTicks(low, high) : ticks(low, high, Math.abs(end - start) / pixels)),
  };
}

function nearest(xs, x) {
  if (xs[0] > xs[xs.length - 1]) return 0;
  let [a, b] = [0, xs.length - 1];
  while (b - a > 1) {
    const middle = (a + b) >> 1;
    if (xs[middle] < x) a = middle; else b = middle;
  }
  return Math.abs(xs[a] - x) < Math.abs(xs[b] - x) ? a : b;
}

function axes(root, box, x, y, drawing) {
  const group = svg("g", { class: "axes" }, root);
  for (const value of x.ticks(60)) {
    svg("line", { x1: x.at(value), x2: x.at(value), y1: box.top, y2: box.bottom, class: "grid" }, group);
    svg("text", { x: x.at(value), y: box.bottom + 14, "text-anchor": "middle" }, group, shown(value));
  }
  for (const value of y.ticks(22)) {
    svg("line", { x1: box.left, x2: box.right, y1: y.at(value), y2: y.at(value), class: value === 0 ? "zero" : "grid" }, group);
    svg("text", { x: box.left - 5, y: y.at(value) + 4, "text-anchor": "end" }, group, shown(value));
  }
  svg("text", { x: (box.left + box.right) / 2, y: box.bottom + 31, "text-anchor": "middle", class: "label" }, group, labelled(drawing.x));
  const middle = (box.top + box.bottom) / 2;
  svg("text", { x: 12, y: middle, "text-anchor": "middle", class: "label", transform: `rotate(-90 12 ${middle})` }, group, labelled(drawing.y));
}

// Minimum and maximum of each pixel where there are more points than pixels; lines break where a value is missing.
function linePath(s, x, y, box) {
  const first = Math.max(0, nearest(s.x, x.low) - 1), last = Math.min(s.x.length - 1, nearest(s.x, x.high) + 1);
  const dense = last - first > 3 * (box.right - box.left);
  let [path, pen, k] = ["", "M", first];
  const point = (i) => {
    path += `${pen}${x.at(s.x[i]).toFixed(1)} ${y.at(s.y[i]).toFixed(1)}`;
    pen = "L";
  };
  while (k <= last) {
    if (!Number.isFinite(s.y[k])) { pen = "M"; k++; continue; }
    if (!dense) { point(k++); continue; }
    const pixel = Math.floor(x.at(s.x[k]));
    let [least, most] = [k, k];
    for (; k <= last && Math.floor(x.at(s.x[k])) === pixel; k++) {
      if (s.y[k] < s.y[least]) least = k;
      if (s.y[k] > s.y[most]) most = k;
    }
    point(Math.min(least, most));
    if (least !== most) point(Math.max(least, most));
  }
  return path;
}

// Areas between low and high, one for each run of known values.
function areaPath(s, x, y) {
  const first = Math.max(0, nearest(s.x, x.low) - 1), last = Math.min(s.x.length - 1, nearest(s.x, x.high) + 1);
  let path = "", above = [], below = [];
  const close = () => {
    if (above.length) path += `M${above.join("L")}L${below.reverse().join("L")}Z`;
    [above, below] = [[], []];
  };
  for (let k = first; k <= last; k++) {
    if (!Number.isFinite(s.low[k]) || !Number.isFinite(s.high[k])) { close(); continue; }
    const at = x.at(s.x[k]).toFixed(1);
    above.push(`${at} ${y.at(s.high[k]).toFixed(1)}`);
    below.push(`${at} ${y.at(s.low[k]).toFixed(1)}`);
  }
  close();
  return path;
}

const PAINT = {
  line: (g, s, x, y, box) => svg("path", { d: linePath(s, x, y, box), fill: "none", stroke: s.ink, "stroke-width": s.width ?? 1.1, "stroke-dasharray": s.dash ?? "none", "stroke-linejoin": "round" }, g),
  envelope: (g, s, x, y) => svg("path", { d: areaPath(s, x, y), fill: s.ink, "fill-opacity": 0.75, stroke: s.ink, "stroke-width": Math.max(0.6, (s.width ?? 1) - 0.6) }, g),
  band: (g, s, x, y) => svg("path", { d: areaPath(s, x, y), fill: s.ink, "fill-opacity": 0.35 }, g),
  stack: (g, s, x, y) => svg("path", { d: areaPath(s, x, y), fill: s.ink, "fill-opacity": 0.85 }, g),
  points: (g, s, x, y) => {
    let path = "";
    s.x.forEach((v, k) => { if (Number.isFinite(s.y[k])) path += `M${x.at(v).toFixed(1)} ${y.at(s.y[k]).toFixed(1)}h0`; });
    svg("path", { d: path, stroke: s.ink, "stroke-width": 2.6, "stroke-linecap": "round", "stroke-opacity": 0.55, fill: "none" }, g);
  },
  interval: (g, s, x, y) => s.x.forEach((v, k) => {
    const at = x.at(v);
    svg("path", { d: `M${at} ${y.at(s.low[k])}V${y.at(s.high[k])}m-3 0h6M${at - 3} ${y.at(s.low[k])}h6`, stroke: s.ink, fill: "none" }, g);
    svg("circle", { cx: at, cy: y.at(s.y[k]), r: 3, fill: s.ink }, g);
  }),
};
