// Every chart of the page is drawn into its figure, again when the width changes, a folded part opens, or on paper.

const KINDS = { plot: Plot, heat: Heat, bars: Bars, intervals: Intervals, scene: Scene };

function start() {
  const drawings = JSON.parse(document.getElementById("drawings").textContent);
  const charts = new Map();
  const draw = (holder) => {
    if (!charts.has(holder)) charts.set(holder, new KINDS[drawings[holder.id].kind](holder, drawings[holder.id]));
    charts.get(holder).draw();
    holder.dataset.drawn = "";
  };
  const holders = [...document.querySelectorAll(".chart[id]")];
  const visible = () => holders.filter((holder) => holder.clientWidth);
  startTables();
  const queue = visible();
  const next = () => {
    const until = performance.now() + 40;
    while (queue.length && performance.now() < until) draw(queue.shift());
    if (queue.length) requestAnimationFrame(next);
    else document.body.dataset.ready = "";
  };
  next();
  document.querySelectorAll("details").forEach((part) => {
    part.addEventListener("toggle", () => { if (part.open) part.querySelectorAll(".chart[id]").forEach(draw); });
  });
  let width = window.innerWidth;
  window.addEventListener("resize", () => {
    if (window.innerWidth === width) return;
    width = window.innerWidth;
    visible().forEach(draw);
  });
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((part) => { part.open = true; });
    visible().forEach(draw);
  });
  follow();
}

// The list of sections shows where the reader is.
function follow() {
  const links = new Map([...document.querySelectorAll("nav a")].map((a) => [a.hash.slice(1), a]));
  const watcher = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) links.get(target.id)?.classList.toggle("here", isIntersecting);
  }, { rootMargin: "-10% 0px -60% 0px" });
  document.querySelectorAll("main > section").forEach((section) => watcher.observe(section));
}

start();
