// The mechanism in three dimensions: rotated by dragging, moved by sliders, with the apparent mass at the handle.

class Scene {
  constructor(holder, drawing) {
    this.holder = holder;
    this.device = new Mechanism(drawing);
    this.height = drawing.height;
    this.trail = drawing.trail ? numbers(drawing.trail) : null;
    this.swept = drawing.swept ? points(numbers(drawing.swept.ends)) : [];
    this.widths = drawing.swept ? numbers(drawing.swept.widths) : [];
    this.nearest = drawing.nearest ?? [];
    const name = "the device in three dimensions; arrow keys turn it, plus and minus zoom, 0 returns";
    this.canvas = html("canvas", { class: "scene", tabindex: 0, role: "img", "aria-label": name }, holder);
    this.words = readout(holder);
    this.yaw = -0.9;
    this.pitch = 0.42;
    this.zoom = 1;
    this.frame();
    this.unit = this.massUnit();
    this.logs = new Map((drawing.logs ?? []).map(({ group, t, q }) => [group, { t: numbers(t), q: q.map(numbers) }]));
    this.addControls();
    this.listen();
  }

  // Centre and size of the initial drawing.
  frame() {
    const points = [...this.parts().flatMap((part) => part.points), ...this.way(), ...this.swept, ...this.nearest.flat()];
    const all = [0, 1, 2].map((k) => points.map((p) => p[k]));
    this.middle = all.map((v) => (Math.min(...v) + Math.max(...v)) / 2);
    this.size = Math.max(...all.map((v, k) => Math.max(...v) - this.middle[k]), 1e-3) * 1.25;
  }

  // Path of the handle.
  way() {
    return this.trail ? points(this.trail) : [];
  }

  // Scale in metres per kilogram: the largest initial mass is a fifth of the drawing.
  massUnit() {
    const felt = this.device.mass && this.device.felt();
    return felt?.masses ? (0.22 * this.size) / felt.masses[0].mass : 0;
  }

  addControls() {
    const bar = html("div", { class: "controls" }, this.holder);
    const acts = {
      "+": () => { this.zoom *= 1.25; }, "-": () => { this.zoom /= 1.25; },
      0: () => { [this.yaw, this.pitch, this.zoom] = [-0.9, 0.42, 1]; },
      ArrowLeft: () => { this.yaw += 0.08; }, ArrowRight: () => { this.yaw -= 0.08; },
      ArrowUp: () => { this.pitch = Math.min(this.pitch + 0.08, 1.55); }, ArrowDown: () => { this.pitch = Math.max(this.pitch - 0.08, -1.55); },
    };
    for (const [key, text, label] of [["+", "+", "zoom in"], ["-", "−", "zoom out"], [0, "⟲", "first view"]])
      button(bar, text, label, () => { acts[key](); this.draw(); });
    this.canvas.addEventListener("keydown", (event) => {
      if (!acts[event.key] || event.ctrlKey || event.metaKey) return;
      acts[event.key]();
      this.draw();
      event.preventDefault();
    });
    this.sliders = /** @type {HTMLInputElement[]} */ ([...document.querySelectorAll("input[data-joint]")]);
    for (const slider of this.sliders) slider.addEventListener("input", () => this.moved());
  }

  // The pose of a log at a time, between two samples by their line.
  follow({ group, x }) {
    const log = this.logs.get(group), n = log?.t.length;
    if (!(n > 1)) return;
    const at = Math.min(Math.max((x - log.t[0]) / (log.t[1] - log.t[0]), 0), n - 1), k = Math.min(Math.floor(at), n - 2);
    const qa = log.q.map((q) => q[k] + (at - k) * (q[k + 1] - q[k]));
    this.sliders.forEach((slider, j) => { slider.valueAsNumber = qa[j]; });
    this.moved(qa);
  }

  moved(wanted = this.sliders.map((s) => s.valueAsNumber)) {
    const closes = this.device.move(wanted);
    this.sliders.forEach((s, k) => {
      if (!closes) s.valueAsNumber = this.device.qa[k];
      s.parentElement.querySelector("output").textContent = shown(this.device.qa[k], 3);
    });
    this.draw();
    if (!closes) this.words.textContent = "The loops do not close at this position.";
  }

  listen() {
    document.addEventListener("cursor", (/** @type {CustomEvent} */ event) => this.follow(event.detail));
    this.canvas.addEventListener("pointerdown", (event) => {
      let [x, y] = [event.clientX, event.clientY];
      this.canvas.setPointerCapture(event.pointerId);
      this.canvas.onpointermove = (move) => {
        this.yaw -= 0.008 * (move.clientX - x);
        this.pitch = Math.min(Math.max(this.pitch + 0.008 * (move.clientY - y), -1.55), 1.55);
        [x, y] = [move.clientX, move.clientY];
        this.draw();
      };
      this.canvas.onpointerup = this.canvas.onpointercancel = () => { this.canvas.onpointermove = null; };
    });
  }

  // Polygons and polylines of the drawing.
  parts() {
    const { joints, cuts, handle } = this.device, links = this.device.links(), made = [];
    const origin = (link) => (link < 0 ? [0, 0, 0] : links[link].p);
    const pins = [...cuts.flatMap((c) => [c.frame_a, c.frame_b]), ...(handle ? [handle] : [])];
    for (const [link, end] of [...joints.map((j, k) => [j.parent, links[k].p]), ...pins.map((f) => [f.link, this.device.placed(links, f).p])])
      if (Math.hypot(...add(end, origin(link), -1)) > 1e-9) made.push({ kind: "bar", link, points: [origin(link), end] });
    const size = 0.045 * (this.size ?? 0);
    joints.forEach((joint, k) => made.push({ kind: joint.slides ? "slide" : "disc", active: this.device.active.includes(k), name: joint.name, points: ring(links[k], size, joint.slides ? 4 : 24) }));
    for (const cut of cuts) made.push({ kind: "pin", points: ring(this.device.placed(links, cut.frame_b), 0.7 * size, 16) });
    if (handle) made.push({ kind: "handle", points: [this.device.placed(links, handle).p] });
    return made;
  }

  project(p) {
    const [x, y, z] = add(p, this.middle, -1);
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const [right, deep] = [cy * x + sy * y, -sy * x + cy * y];
    const [up, depth] = [cp * z + sp * deep * -1, cp * deep + sp * z];
    const scale = (this.zoom * Math.min(this.width, this.height)) / 2 / this.size / (1 + (0.18 * depth) / this.size);
    return { x: this.width / 2 + scale * right, y: this.height / 2 - scale * up, depth, scale };
  }

  draw() {
    if (!this.holder.clientWidth) return;
    const ratio = window.devicePixelRatio || 1;
    this.width = this.holder.clientWidth;
    [this.canvas.width, this.canvas.height] = [this.width * ratio, this.height * ratio];
    this.canvas.style.height = `${this.height}px`;
    const c = this.canvas.getContext("2d");
    c.scale(ratio, ratio);
    this.inks = Object.fromEntries(["ink", "paper", "soft", "grid", "bar", "body", "passive", "c-blue", "vermillion", "orange", "zero"].map((name) => [name, resolved(name)]));
    c.clearRect(0, 0, this.width, this.height);
    drawGround(this, c);
    drawSwept(this, c);
    drawTrail(this, c);
    const far = (part) => part.points.reduce((sum, p) => sum + this.project(p).depth, 0) / part.points.length;
    const parts = this.parts().map((part) => ({ ...part, far: far(part) })).sort((a, b) => b.far - a.far);
    for (const part of parts) drawPart(this, c, part);
    drawNearest(this, c);
    drawEllipsoid(this, c);
    drawTriad(this, c);
  }

  trace(c, points, close = false) {
    c.beginPath();
    points.map((p) => this.project(p)).forEach(({ x, y }, k) => (k ? c.lineTo(x, y) : c.moveTo(x, y)));
    if (close) c.closePath();
  }
}
