// Maps of a value over rows and columns: correlations, information over time, slices of the workspace.

const RAMPS = {
  diverging: ["#0072B2", "#8fbfdc", "#ffffff", "#f0b48a", "#D55E00"],
  sequential: ["#00224e", "#35456c", "#666970", "#948e77", "#c8b866", "#fee838"],
};

function ramp(name, share) {
  const stops = RAMPS[name];
  const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const k = Math.min(Math.floor(at), stops.length - 2);
  const [a, b] = [stops[k], stops[k + 1]].map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
  return a.map((v, i) => Math.round(v + (at - k) * (b[i] - v)));
}

class Heat {
  constructor(holder, drawing) {
    this.holder = holder;
    this.drawing = drawing;
    this.layers = drawing.layers.map((layer) => ({ ...layer, values: numbers(layer.values) }));
    this.shares = scale([drawing.low, drawing.high], [0, 1], drawing.log);
    this.layer = this.layers[Math.floor(this.layers.length / 2)];
    if (this.layers.length > 1) this.addSlices();
    this.words = readout(holder);
  }

  addSlices() {
    const bar = html("label", { class: "slices" }, this.holder, `slice through ${this.drawing.slice} `);
    const input = html("input", { type: "range", min: 0, max: this.layers.length - 1, value: Math.floor(this.layers.length / 2) }, bar);
    const name = html("output", {}, bar, this.layer.name);
    input.addEventListener("input", () => {
      this.layer = this.layers[input.valueAsNumber];
      name.textContent = this.layer.name;
      this.draw();
    });
  }

  draw() {
    if (!this.holder.clientWidth) return;
    const { rows, columns, square, x } = this.drawing;
    const room = Math.max(240, this.holder.clientWidth);
    const left = besides(rows, room, 110) + (this.drawing.y ? 18 : 0), right = 64;
    const wide = square ? Math.min(room - left - right, 26 * columns.length, 560) : room - left - right;
    const below = x ? 44 : 14 + 7.6 * Math.max(...columns.map((c) => c.length));
    const high = square ? (wide * rows.length) / columns.length : Math.min(Math.max(rows.length * 15, 150), 640);
    const { root } = canvasOf(this.holder, high + below + 12);
    this.box = { left, top: 8, wide, high };
    svg("image", { href: this.picture(), x: left, y: 8, width: wide, height: high, preserveAspectRatio: "none", class: "pixels" }, root);
    svg("rect", { x: left, y: 8, width: wide, height: high, class: "outline" }, root);
    this.labels(root);
    this.bar(root, left + wide + 12);
    for (const mark of this.layer.marks) this.mark(root, mark);
    root.addEventListener("pointermove", (event) => this.tell(root, event));
  }

  picture() {
    const { rows, columns, ramp: name } = this.drawing;
    const canvas = html("canvas", { width: columns.length, height: rows.length });
    const context = canvas.getContext("2d");
    const image = context.createImageData(columns.length, rows.length);
    this.layer.values.forEach((value, k) => {
      const [row, column] = [Math.floor(k / columns.length), k % columns.length];
      const colour = Number.isFinite(value) ? ramp(name, this.shares.at(value)) : [205, 205, 205];
      image.data.set([...colour, 255], 4 * (this.line(row) * columns.length + column));
    });
    context.putImageData(image, 0, 0);
    return canvas.toDataURL();
  }

  // Vertical position of a row.
  line(row) {
    return this.drawing.upwards ? this.drawing.rows.length - 1 - row : row;
  }

  labels(root) {
    const { left, top, wide, high } = this.box;
    const { rows, columns, x, y } = this.drawing;
    const [h, w] = [high / rows.length, wide / columns.length];
    const group = svg("g", { class: "axes" }, root);
    const everyRow = Math.ceil((y ? 34 : 11) / h), everyColumn = Math.ceil((x ? 64 : 12) / w);
    rows.forEach((name, k) => {
      if (k % everyRow === 0) named(name, left - (y ? 26 : 8), { x: left - 5, y: top + (this.line(k) + 0.5) * h + 4, "text-anchor": "end" }, group);
    });
    columns.forEach((name, k) => {
      if (k % everyColumn) return;
      const at = left + (k + 0.5) * w;
      if (x) svg("text", { x: at, y: top + high + 15, "text-anchor": "middle" }, group, name);
      else svg("text", { x: at, y: top + high + 8, "text-anchor": "end", transform: `rotate(-90 ${at} ${top + high + 8}) translate(0 4)` }, group, name);
    });
    if (x) svg("text", { x: left + wide / 2, y: top + high + 34, "text-anchor": "middle", class: "label" }, group, x);
    if (y) svg("text", { x: 12, y: top + high / 2, "text-anchor": "middle", class: "label", transform: `rotate(-90 12 ${top + high / 2})` }, group, y);
  }

  bar(root, at) {
    const { top, high } = this.box;
    const { ramp: name, unit } = this.drawing;
    const group = svg("g", { class: "axes" }, root);
    const steps = 24;
    for (let k = 0; k < steps; k++)
      svg("rect", { x: at, y: top + (high * k) / steps, width: 10, height: high / steps + 0.5, fill: `rgb(${ramp(name, 1 - (k + 0.5) / steps)})` }, group);
    for (const value of this.shares.ticks(30 / high))
      svg("text", { x: at + 14, y: top + high * (1 - this.shares.at(value)) + 4 }, group, shown(value, 3));
    if (unit) svg("text", { x: at, y: top + high + 16 }, group, unit);
  }

  mark(root, { name, row, column }) {
    const { left, top, wide, high } = this.box;
    const { rows, columns } = this.drawing;
    const [cx, cy] = [left + ((column + 0.5) * wide) / columns.length, top + ((this.line(row) + 0.5) * high) / rows.length];
    const value = shown(this.layer.values[row * columns.length + column], 3);
    const end = column > columns.length / 2;
    svg("circle", { cx, cy, r: 6, class: "mark" }, root);
    svg("text", { x: cx + (end ? -10 : 10), y: cy + (cy < top + 16 ? 14 : 4), "text-anchor": end ? "end" : "start", class: "mark" }, root, `${name} ${value}`);
  }

  tell(root, event) {
    const { left, top, wide, high } = this.box;
    const { rows, columns, unit } = this.drawing;
    const at = root.getBoundingClientRect();
    const column = Math.floor(((event.clientX - at.left - left) / wide) * columns.length);
    const line = Math.floor(((event.clientY - at.top - top) / high) * rows.length);
    if (column < 0 || line < 0 || column >= columns.length || line >= rows.length) return;
    const row = this.line(line);
    this.words.textContent = `${rows[row]}, ${columns[column]}: ${shown(this.layer.values[row * columns.length + column], 3)} ${unit}`;
  }
}
