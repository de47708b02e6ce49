// The mechanism in three dimensions: rotated by dragging, moved by sliders, with the apparent mass at the handle.

class Scene {
  constructor(holder, drawing) {
    this.holder = holder;
    this.device = new Mechanism(drawing);
    this.height = drawing.height;
    this.trail = drawing.trail ? numbers(drawing.trail) : null;
    const name = "the device in three dimensions; arrow keys turn it, plus and minus zoom, 0 returns";
    this.canvas = html("canvas", { class: "scene", tabindex: 0, role: "img", "aria-label": name }, holder);
    this.words = readout(holder);
    [this.yaw, this.pitch, this.zoom] = [-0.9, 0.42, 1];
    this.frame();
    this.unit = this.massUnit();
    this.addControls();
    this.listen();
  }

  // Centre and size of the initial drawing.
  frame() {
    const points = [...this.parts().flatMap((part) => part.points), ...this.way()];
    const all = [0, 1, 2].map((k) => points.map((p) => p[k]));
    this.middle = all.map((v) => (Math.min(...v) + Math.max(...v)) / 2);
    this.size = Math.max(...all.map((v, k) => Math.max(...v) - this.middle[k]), 1e-3) * 1.25;
  }

  // Path of the handle in the first log.
  way() {
    return Array.from({ length: (this.trail?.length ?? 0) / 3 }, (_, k) => [...this.trail.slice(3 * k, 3 * k + 3)]);
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
    this.sliders = [...document.querySelectorAll("input[data-joint]")];
    for (const slider of this.sliders) slider.addEventListener("input", () => this.moved());
  }

  moved() {
    const wanted = this.sliders.map((s) => s.valueAsNumber);
    const closes = this.device.move(wanted);
    this.sliders.forEach((s, k) => {
      if (!closes) s.value = this.device.qa[k];
      s.parentElement.querySelector("output").textContent = shown(this.device.qa[k], 3);
    });
    this.draw();
    if (!closes) this.words.textContent = "The loops do not close at this position.";
  }

  listen() {
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
    this.ground(c);
    this.drawTrail(c);
    const far = (part) => part.points.reduce((sum, p) => sum + this.project(p).depth, 0) / part.points.length;
    const parts = this.parts().map((part) => ({ ...part, far: far(part) })).sort((a, b) => b.far - a.far);
    for (const part of parts) this.paint(c, part);
    this.ellipsoid(c);
    this.triad(c);
  }

  trace(c, points, close = false) {
    c.beginPath();
    points.map((p) => this.project(p)).forEach(({ x, y }, k) => (k ? c.lineTo(x, y) : c.moveTo(x, y)));
    if (close) c.closePath();
  }

  ground(c) {
    c.strokeStyle = this.inks.grid;
    c.lineWidth = 1;
    const step = ticks(0, this.size, 4)[1] || this.size, low = Math.min(0, this.middle[2] - this.size);
    for (let k = -5; k <= 5; k++) {
      const [x, y] = [Math.round(this.middle[0] / step) * step, Math.round(this.middle[1] / step) * step];
      for (const ends of [[[x + k * step, y - 5 * step, low], [x + k * step, y + 5 * step, low]], [[x - 5 * step, y + k * step, low], [x + 5 * step, y + k * step, low]]]) {
        this.trace(c, ends);
        c.stroke();
      }
    }
  }

  drawTrail(c) {
    if (!this.trail) return;
    c.strokeStyle = this.inks.zero;
    c.lineWidth = 1;
    this.trace(c, this.way());
    c.stroke();
  }

  paint(c, part) {
    c.lineCap = c.lineJoin = "round";
    if (part.kind === "bar") {
      const wide = 0.03 * this.size * this.project(part.points[0]).scale;
      for (const [ink, share] of [[part.link < 0 ? this.inks.soft : this.inks.bar, 1], [part.link < 0 ? this.inks.body : this.inks["c-blue"], 0.68]]) {
        c.strokeStyle = ink;
        c.lineWidth = Math.max(wide * share, 1.2);
        this.trace(c, part.points);
        c.stroke();
      }
    } else if (part.kind === "handle") {
      const { x, y } = this.project(part.points[0]);
      c.strokeStyle = this.inks.vermillion;
      c.lineWidth = 3;
      c.beginPath();
      c.arc(x, y, 6, 0, 2 * Math.PI);
      c.stroke();
    } else {
      this.trace(c, part.points, true);
      c.fillStyle = part.kind === "pin" ? this.inks.paper : part.active ? this.inks.orange : this.inks.passive;
      c.strokeStyle = this.inks.ink;
      c.lineWidth = 1.2;
      c.fill();
      c.stroke();
    }
  }

  // Half-axes of the ellipsoid are the principal masses, in one scale for all poses.
  ellipsoid(c) {
    if (!this.device.mass) return;
    const { masses: felt, why } = this.device.felt();
    if (why) {
      this.words.textContent = why;
      return;
    }
    this.unit ||= (0.22 * this.size) / felt[0].mass;
    const at = this.device.placed(this.device.links(), this.device.handle).p;
    const arms = felt.map(({ mass, vector }) => vector.map((v) => v * Math.min(this.unit * mass, this.size)));
    c.lineWidth = 1.3;
    c.strokeStyle = this.inks.vermillion;
    c.fillStyle = "rgba(213,94,0,0.13)";
    for (const [a, b] of [[0, 1], [0, 2], [1, 2]]) {
      if (!arms[a] || !arms[b]) continue;
      this.trace(c, Array.from({ length: 49 }, (_, k) => add(add(at, arms[a], Math.cos((k * Math.PI) / 24)), arms[b], Math.sin((k * Math.PI) / 24))));
      c.fill();
      c.stroke();
    }
    const text = felt.map(({ mass, vector }) => `${shown(mass, 3)} kg along (${vector.map((v) => shown(Math.round(100 * v) / 100, 2)).join(", ")})`);
    this.words.textContent = `Apparent mass at the handle: ${text.join("; ")}.`;
  }

  triad(c) {
    const length = 0.25 * this.size;
    c.font = "12px system-ui, sans-serif";
    [["x", [length, 0, 0]], ["y", [0, length, 0]], ["z", [0, 0, length]]].forEach(([name, end]) => {
      c.strokeStyle = c.fillStyle = this.inks.ink;
      c.lineWidth = 1;
      this.trace(c, [[0, 0, 0], end]);
      c.stroke();
      const { x, y } = this.project(end);
      c.fillText(name, x + 3, y - 3);
    });
  }
}

// A closed line about the z axis of a frame.
function ring({ R, p }, radius, corners) {
  return Array.from({ length: corners }, (_, k) => {
    const angle = (2 * Math.PI * (k + 0.5)) / corners;
    return add(add(p, column(R, 0), radius * Math.cos(angle)), column(R, 1), radius * Math.sin(angle));
  });
}
