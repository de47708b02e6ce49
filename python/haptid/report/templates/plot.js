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
    const [across, up] = this.drawing.equal ? equalised(this.view, this.heights(), box) : [this.view, this.heights()];
    this.x = scale(across, [box.left, box.right], this.drawing.x.log);
    this.y = scale(up, [box.bottom, box.top], this.drawing.y.log);
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

  // The values at a place; other drawings of the group's log follow by an event `cursor`.
  tell(x) {
    if (this.drawing.group) document.dispatchEvent(new CustomEvent("cursor", { detail: { group: this.drawing.group, x } }));
    const parts = this.series.filter((s) => s.style !== "points" && !s.hidden).map((s) => {
      const k = nearest(s.x, x);
      const value = s.raw ?? s.y;
      return `${s.name} ${value ? shown(value[k]) : `${shown(s.low[k])} to ${shown(s.high[k])}`}`;
    });
    this.words.textContent = `${this.drawing.x.label} ${shown(x)} ${this.drawing.x.unit}: ${parts.join(", ")} ${this.drawing.y.unit}`;
  }
}
