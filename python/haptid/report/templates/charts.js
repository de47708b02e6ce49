// Draws the charts of a part of a page, and again when the width changes or a folded part opens.

const KINDS = { plot: Plot, heat: Heat, bars: Bars, intervals: Intervals, scene: Scene };

// Draws a little at a time, then calls `done`; returns a function that draws all visible charts again.
function drawAll(root, drawings, done = () => {}) {
  const charts = new Map();
  const draw = (holder) => {
    if (!charts.has(holder)) charts.set(holder, new KINDS[drawings[holder.id].kind](holder, drawings[holder.id]));
    charts.get(holder).draw();
    holder.dataset.drawn = "";
  };
  const holders = [...root.querySelectorAll(".chart[id]")];
  const visible = () => holders.filter((holder) => holder.clientWidth);
  const queue = visible();
  const next = () => {
    const until = performance.now() + 40;
    while (queue.length && performance.now() < until) draw(queue.shift());
    if (queue.length) requestAnimationFrame(next);
    else done();
  };
  next();
  root.querySelectorAll("details").forEach((part) => {
    part.addEventListener("toggle", () => { if (part.open) part.querySelectorAll(".chart[id]").forEach(draw); });
  });
  let width = window.innerWidth;
  window.addEventListener("resize", () => {
    if (window.innerWidth === width) return;
    width = window.innerWidth;
    visible().forEach(draw);
  });
  return () => visible().forEach(draw);
}
