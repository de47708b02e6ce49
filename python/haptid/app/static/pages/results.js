// Results: the sections of a result's report by the report's own script; comparison and drift of several.
import { acting, call, el, field, link, percent, typed, when } from "../common.js";
import { drawAll, startTables } from "/report/charts.js";

export async function show(main, query) {
  el("h1", {}, main, "Results");
  if (query.get("compare")) return compared(main, query.get("compare").split(","), query.get("times") ?? "");
  if (query.get("path")) return result(main, query.get("path"));
  return list(main);
}

async function list(main) {
  typed("");
  const form = el("form", {}, main);
  const row = el("div", { class: "row" }, form);
  const words = field(row, "Search", el("input", { type: "search" }));
  const press = el("button", { type: "submit", disabled: true }, row, "Compare the chosen");
  const dated = field(row, "with drift over their dates", el("input", { type: "checkbox" }));
  const why = el("span", { class: "quiet", role: "status" }, row);
  const place = el("div", {}, form), chosen = new Map();
  const told = () => {
    press.disabled = chosen.size < 2;
    why.textContent = chosen.size < 2 ? "Choose two or more; the first chosen is compared with each of the others." : `${chosen.size} chosen`;
  };
  const look = acting(main, async () => {
    const { lists, counts } = await call("workspace", { words: words.value });
    place.replaceChildren();
    if (!lists.result.length) el("p", { class: "empty" }, place, counts.result ? "None with these words." : "This folder has no results yet: the page Solve makes them.");
    const made = el("ul", { class: "list" }, place);
    for (const entry of lists.result) {
      const item = el("li", {}, made);
      const box = el("input", { type: "checkbox", "aria-label": `choose ${entry.path}`, checked: chosen.has(entry.path) }, item);
      box.addEventListener("change", () => { if (box.checked) chosen.set(entry.path, entry); else chosen.delete(entry.path); told(); });
      el("a", { href: link("results", { path: entry.path }) }, item, entry.path.slice(8));
      el("small", {}, item, `${entry.title}; ${entry.about.device ?? ""}; ${entry.about.method ?? ""}`);
      if (entry.about.error_percent !== null && entry.about.error_percent !== undefined) el("small", {}, item, `error ${percent(entry.about.error_percent)}`);
      if (entry.about.met !== null && entry.about.met !== undefined) el("span", { class: `badge ${entry.about.met ? "ok" : "bad"}` }, item, entry.about.met ? "criterion met" : "criterion not met");
      el("small", {}, item, when(entry.modified));
    }
  });
  words.addEventListener("input", () => { clearTimeout(words.timer); words.timer = setTimeout(look, 150); });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const entries = [...chosen.values()];
    const times = dated.checked ? { times: entries.map((e) => new Date(e.modified * 1000).toISOString().slice(0, 19)).join(",") } : {};
    location.href = link("results", { compare: entries.map((e) => e.path).join(","), ...times });
  });
  told();
  await look();
}

async function result(main, path) {
  const found = await call("result", { path });
  main.querySelector("h1").textContent = found.name;
  el("p", { class: "quiet" }, main, found.about);
  typed(found.command);
  const row = el("p", { class: "row" }, main);
  el("a", { href: link("use", { path }) }, row, "Use this model");
  for (const file of found.files.filter((name) => ["report.html", "result.json", "parameters.csv"].includes(name)))
    el("a", { href: `/api/download?${new URLSearchParams({ path: `${path}/${file}` })}`, download: file }, row, file);
  if (found.entry?.logs.length) {
    const logs = el("p", { class: "small" }, main, "Made of ");
    found.entry.logs.forEach((log, k) => { if (k) logs.append(", "); el("a", { href: link("data", { path: log }) }, logs, log); });
  }
  parts(main, found);
}

async function compared(main, paths, times) {
  main.querySelector("h1").textContent = `Comparison of ${paths.length} results`;
  const form = el("form", { class: "row" }, main);
  const dates = field(form, "Dates, one for each result", el("input", { type: "text", size: 60, value: times, placeholder: "2026-03-02, 2026-03-09" }));
  el("button", { type: "submit" }, form, "Show the drift");
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    location.href = link("results", { compare: paths.join(","), ...(dates.value.trim() && { times: dates.value.replace(/\s/g, "") }) });
  });
  const found = await call("compare", { paths: paths.join(","), ...(times && { times }) });
  typed(found.command);
  parts(main, found);
}

// Sections of a report: their HTML is made by the server from templates that escape every value.
function parts(main, { sections, drawings }) {
  const nav = el("nav", { class: "chapters", "aria-label": "Sections" }, main);
  for (const section of sections) {
    el("a", { href: `#${section.key}` }, nav, section.title);
    const part = el("section", { id: section.key, class: "part" }, main);
    el("h2", {}, part, section.title);
    part.insertAdjacentHTML("beforeend", section.html);
  }
  startTables(main);
  const redraw = drawAll(main, drawings, () => { main.dataset.drawn = ""; });
  document.addEventListener("colours", redraw);
}
