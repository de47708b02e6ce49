// What a plot is painted of: axes with their ticks, and the paths of lines, bands, stacks and intervals.

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

/** @param {number[]} range @param {number[]} pixels @param {boolean} [log] */
function scale([low, high], [start, end], log) {
  const f = log ? Math.log10 : (v) => v;
  const g = log ? (v) => 10 ** v : (v) => v;
  const ratio = (end - start) / (f(high) - f(low));
  return {
    low, high, at: (v) => start + ratio * (f(v) - f(low)), back: (p) => g(f(low) + (p - start) / ratio),
    ticks: (pixels) => (log ? logTicks(low, high) : ticks(low, high, Math.abs(end - start) / pixels)),
  };
}

// Both ranges, the narrower one widened about its middle, so that a unit has the same length along both axes of a box.
function equalised(across, up, box) {
  const length = Math.max((across[1] - across[0]) / (box.right - box.left), (up[1] - up[0]) / (box.bottom - box.top));
  const about = ([a, b], size) => [(a + b - length * size) / 2, (a + b + length * size) / 2];
  return [about(across, box.right - box.left), about(up, box.bottom - box.top)];
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
  const ordered = s.style !== "path"; // a path in space, whose x may go back: all of it is drawn
  const first = ordered ? Math.max(0, nearest(s.x, x.low) - 1) : 0;
  const last = ordered ? Math.min(s.x.length - 1, nearest(s.x, x.high) + 1) : s.x.length - 1;
  const dense = ordered && last - first > 3 * (box.right - box.left);
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
  path: (g, s, x, y, box) => PAINT.line(g, s, x, y, box),
  envelope: (g, s, x, y) => svg("path", { d: areaPath(s, x, y), fill: s.ink, "fill-opacity": 0.75, stroke: s.ink, "stroke-width": Math.max(0.6, (s.width ?? 1) - 0.6) }, g),
  band: (g, s, x, y) => svg("path", { d: areaPath(s, x, y), fill: s.ink, "fill-opacity": 0.35 }, g),
  stack: (g, s, x, y) => svg("path", { d: areaPath(s, x, y), fill: s.ink, "fill-opacity": 0.85 }, g),
  points: (g, s, x, y) => {
    let path = "";
    const few = s.x.length < 100;
    s.x.forEach((v, k) => { if (Number.isFinite(s.y[k])) path += `M${x.at(v).toFixed(1)} ${y.at(s.y[k]).toFixed(1)}h0`; });
    svg("path", { d: path, stroke: s.ink, "stroke-width": few ? 7 : 2.6, "stroke-linecap": "round", "stroke-opacity": few ? 0.9 : 0.55, fill: "none" }, g);
  },
  interval: (g, s, x, y) => s.x.forEach((v, k) => {
    const at = x.at(v);
    svg("path", { d: `M${at} ${y.at(s.low[k])}V${y.at(s.high[k])}m-3 0h6M${at - 3} ${y.at(s.low[k])}h6`, stroke: s.ink, fill: "none" }, g);
    svg("circle", { cx: at, cy: y.at(s.y[k]), r: 3, fill: s.ink }, g);
  }),
};
