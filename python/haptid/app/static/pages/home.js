// Home: what the folder has, what runs, and a trial on the virtual bench.
import { acting, bytes, call, el, field, link, percent, typed, when } from "../common.js";

const KINDS = [
  ["device", "Devices", (e) => link("device", { path: e.path }), (e) => e.about.description ?? ""],
  ["study", "Studies", (e) => link("solve", { path: e.path }), (e) => e.about.device ?? ""],
  ["log", "Logs", (e) => link("data", { path: e.path }), (e) => `${bytes(e.size)}${e.results.length ? `, in ${e.results.length} result${e.results.length > 1 ? "s" : ""}` : ""}`],
  ["result", "Results", (e) => link("results", { path: e.path }), (e) => `${e.about.device ?? ""}${e.about.error_percent === null || e.about.error_percent === undefined ? "" : `, error ${percent(e.about.error_percent)}`}`],
];

export async function show(main, query) {
  el("h1", {}, main, "Workbench");
  const folder = el("p", { class: "quiet" }, main);
  const row = el("div", { class: "row" }, main);
  const begin = el("button", { type: "button", class: "main", disabled: true }, row, "Try it on the virtual bench");
  const why = el("span", { class: "quiet" }, row);
  begin.addEventListener("click", acting(main, async () => {
    const job = await call("try-out", {}, "POST");
    location.href = link("solve", { job: job.id });
  }));
  const form = el("form", { class: "row", role: "search" }, main);
  const words = field(form, "Search", el("input", { type: "search", value: query.get("words") ?? "" }));
  const grid = el("div", { class: "columns" }, main);

  const look = acting(main, async () => {
    const found = await call("workspace", { words: words.value });
    folder.title = found.folder;
    folder.textContent = `Folder ${found.folder.replace(/^.*[\\/]/, "")}. All files are plain files of this folder; the pages show them and the commands read them.`;
    begin.disabled = !found.bench;
    why.textContent = found.bench ? "Simulates two logs of a PHANToM Premium 1.5, identifies it and shows the verdict, in less than a minute." : 'Needs MuJoCo: pip install "haptid[bench]"';
    grid.replaceChildren();
    for (const kind of KINDS) list(grid, found, ...kind);
    jobs(grid, found.jobs);
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  words.addEventListener("input", () => {
    clearTimeout(words.timer);
    words.timer = setTimeout(() => {
      history.replaceState(null, "", words.value ? link("", { words: words.value }) : "/");
      look();
    }, 150);
  });
  typed("");
  await look();
}

function list(grid, found, kind, title, address, about) {
  const part = el("section", { "aria-labelledby": `list-${kind}` }, grid);
  const [entries, count] = [found.lists[kind], found.counts[kind]];
  el("h2", { id: `list-${kind}` }, part, entries.length < count ? `${title} (${entries.length} of ${count})` : title);
  const made = el("ul", { class: "list" }, part);
  for (const entry of entries) {
    const item = el("li", {}, made);
    el("a", { href: address(entry) }, item, entry.path.split("/").slice(1).join("/"));
    if (kind === "result" && entry.about.met !== null && entry.about.met !== undefined)
      el("span", { class: `badge ${entry.about.met ? "ok" : "bad"}` }, item, entry.about.met ? "criterion met" : "criterion not met");
    el("small", {}, item, entry.about.unreadable ? `cannot be read: ${entry.about.unreadable}` : about(entry));
    el("small", {}, item, when(entry.modified));
  }
  if (!entries.length) el("p", { class: "empty" }, part, count ? "None with these words." : EMPTY[kind]);
}

const EMPTY = {
  device: "None yet: take a shipped one on the page Device, or write a device file.",
  study: "None yet: the page Data drafts one from a log.",
  log: "None yet: drop one on the page Data.",
  result: "None yet: the page Solve makes them.",
};

function jobs(grid, records) {
  const part = el("section", { "aria-labelledby": "list-job" }, grid);
  el("h2", { id: "list-job" }, part, "Jobs");
  const made = el("ul", { class: "list" }, part);
  const tones = { done: "ok", failed: "bad", interrupted: "doubt", cancelled: "doubt" };
  for (const job of records) {
    const item = el("li", {}, made);
    el("a", { href: link("solve", { job: job.id }) }, item, job.title);
    el("span", { class: `badge ${tones[job.state] ?? ""}` }, item, job.state);
    el("small", {}, item, when(job.begun));
  }
  if (!records.length) el("p", { class: "empty" }, part, "None yet.");
}
