// The page of a report: all its charts, its colours, print, and the list of its sections.

function start() {
  startTables(document);
  const drawings = JSON.parse(document.getElementById("drawings").textContent);
  const redraw = drawAll(document, drawings, () => { document.body.dataset.ready = ""; });
  themes(redraw);
  onPaper(redraw);
  unfolding();
  follow();
}

// The switch goes from the system's colours to light, to dark; charts on a canvas are drawn again.
function themes(redraw) {
  const press = document.getElementById("theme"), root = document.documentElement, order = ["system", "light", "dark"];
  const kept = (value) => { try { return value ? localStorage.setItem("haptid-theme", value) : localStorage.getItem("haptid-theme"); } catch { return null; } };
  const set = (name) => {
    if (name === "system") delete root.dataset.theme; else root.dataset.theme = name;
    press.textContent = `colours: ${name}`;
    press.value = name;
  };
  press.addEventListener("click", () => {
    set(order[(order.indexOf(press.value) + 1) % order.length]);
    kept(press.value);
    redraw();
  });
  set(order.includes(kept()) ? kept() : "system");
  press.hidden = false;
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

// For print all parts are unfolded and every chart has the width of a sheet; the state is restored afterwards.
function onPaper(redraw) {
  const folded = [];
  window.addEventListener("beforeprint", () => {
    folded.push(...document.querySelectorAll("details:not([open], .screen)"));
    folded.forEach((part) => { part.open = true; });
    document.body.classList.add("paper");
    redraw();
  });
  window.addEventListener("afterprint", () => {
    document.body.classList.remove("paper");
    folded.splice(0).forEach((part) => { part.open = false; });
    redraw();
  });
}

// A link into a folded part unfolds it.
function unfolding() {
  document.querySelectorAll('main a[href^="#"]').forEach((link) => link.addEventListener("click", () => {
    const part = document.querySelector(link.hash)?.closest("details");
    if (part) part.open = true;
  }));
}

// The list of sections marks the current one.
function follow() {
  const links = new Map([...document.querySelectorAll("nav a")].map((a) => [a.hash.slice(1), a]));
  const watcher = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) links.get(target.id)?.classList.toggle("here", isIntersecting);
  }, { rootMargin: "-10% 0px -60% 0px" });
  document.querySelectorAll("main > section").forEach((section) => watcher.observe(section));
}

start();
