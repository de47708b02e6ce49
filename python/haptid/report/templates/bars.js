// Stacked horizontal bars, and changes with confidence intervals: one row for each name.

class Bars {
  constructor(holder, drawing) {
    this.holder = holder;
    this.drawing = drawing;
    this.values = numbers(drawing.values);
    legend(holder, drawing.parts);
    this.words = readout(holder);
  }

  draw() {
    if (!this.holder.clientWidth) return;
    const { rows, parts, unit } = this.drawing;
    const pitch = rows.length > 20 ? 15 : 20;
    const { root, width } = canvasOf(this.holder, rows.length * pitch + 30);
    const left = besides(rows, width, 120);
    const x = scale([0, 100], [left, width - 24], false);
    const group = svg("g", { class: "axes" }, root);
    rows.forEach((name, row) => {
      const y = 4 + row * pitch;
      named(name, left - 8, { x: left - 6, y: y + pitch / 2 + 3, "text-anchor": "end" }, group);
      let sum = 0;
      parts.forEach((part, k) => {
        const value = this.values[row * parts.length + k];
        const bar = svg("rect", { x: x.at(sum), y, width: Math.max(x.at(sum + value) - x.at(sum), 0), height: pitch - 4, fill: COLOURS[part.colour] }, root);
        bar.addEventListener("pointerenter", () => { this.words.textContent = `${name}: ${part.name} ${shown(value, 3)} ${unit}`; });
        sum += value;
      });
    });
    for (const value of [0, 25, 50, 75, 100])
      svg("text", { x: x.at(value), y: rows.length * pitch + 18, "text-anchor": "middle" }, group, `${value} ${unit}`);
  }
}

class Intervals {
  constructor(holder, drawing) {
    this.holder = holder;
    this.drawing = drawing;
    this.sets = drawing.sets.map((s) => ({ ...s, value: numbers(s.value), low: numbers(s.low), high: numbers(s.high) }));
    legend(holder, drawing.sets);
    this.words = readout(holder);
  }

  draw() {
    if (!this.holder.clientWidth) return;
    const { rows, unit, widest } = this.drawing;
    const sets = this.sets;
    const pitch = 10 + 9 * sets.length;
    const { root, width } = canvasOf(this.holder, rows.length * pitch + 44);
    const left = besides(rows, width, 120);
    const ends = sets.flatMap((s) => [...s.low, ...s.high]).filter(Number.isFinite).map(Math.abs);
    const reach = Math.min(widest, 1.05 * Math.max(1e-9, ...ends));
    const x = scale([-reach, reach], [left, width - 14], false);
    const cut = (v) => x.at(Math.min(Math.max(v, -reach), reach));
    const group = svg("g", { class: "axes" }, root);
    const bottom = rows.length * pitch + 6;
    for (const value of x.ticks(80)) {
      svg("line", { x1: x.at(value), x2: x.at(value), y1: 4, y2: bottom, class: value === 0 ? "zero" : "grid" }, group);
      svg("text", { x: x.at(value), y: bottom + 15, "text-anchor": "middle" }, group, shown(value));
    }
    svg("text", { x: (left + width) / 2, y: bottom + 32, "text-anchor": "middle", class: "label" }, group, `change, ${unit}`);
    rows.forEach((name, row) => {
      named(name, left - 8, { x: left - 6, y: row * pitch + pitch / 2 + 6, "text-anchor": "end" }, group);
      sets.forEach((s, k) => {
        if (!Number.isFinite(s.value[row])) return;
        const y = row * pitch + 11 + 9 * k, ink = COLOURS[s.colour];
        svg("line", { x1: cut(s.low[row]), x2: cut(s.high[row]), y1: y, y2: y, stroke: ink, "stroke-width": 2 }, root);
        const dot = svg("circle", { cx: cut(s.value[row]), cy: y, r: 4, stroke: ink, "stroke-width": 1.5, fill: s.differs[row] ? ink : "var(--paper)" }, root);
        dot.addEventListener("pointerenter", () => {
          this.words.textContent = `${name}, ${s.name}: ${shown(s.value[row], 3)} (${shown(s.low[row], 3)} to ${shown(s.high[row], 3)}) ${unit}`;
        });
      });
    });
  }
}
