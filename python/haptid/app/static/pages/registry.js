// Registry: devices by serial number, their results over time, drift, and logs that nothing was made of.
import { acting, bytes, call, el, field, link, percent, typed, when } from "../common.js";

export async function show(main, query) {
  el("h1", {}, main, "Registry");
  typed("");
  el("p", { class: "quiet" }, main, "Devices by their serial number (the key serial of a device file), results by device, logs by their content: renamed files are found again.");
  const form = el("form", { class: "row", role: "search" }, main);
  const words = field(form, "Search", el("input", { type: "search", value: query.get("words") ?? "" }));
  const place = el("div", {}, main);
  const look = acting(main, async () => {
    const found = await call("registry", { words: words.value });
    place.replaceChildren();
    for (const device of found.devices) one(main, place, device, look);
    if (!found.devices.length) el("p", { class: "empty" }, place, "No devices and no results yet.");
    unused(main, place, found.unused, look);
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  words.addEventListener("input", () => { clearTimeout(words.timer); words.timer = setTimeout(look, 150); });
  await look();
}

function one(main, place, device, look) {
  const part = el("section", {}, place);
  const head = el("h2", {}, part, device.name || "without a name");
  if (device.serial) head.append(" ", el("span", { class: "badge" }, null, `serial ${device.serial}`));
  const files = el("p", { class: "row" }, part);
  for (const path of device.files) el("a", { href: link("device", { path }) }, files, path);
  if (!device.files.length) el("span", { class: "quiet" }, files, "No device file in this folder.");
  const made = el("ul", { class: "list" }, part), dates = new Map(), told = () => {
    const chosen = device.results.filter((e) => dates.get(e.path).box.checked);
    press.disabled = chosen.length < 2;
    why.textContent = chosen.length < 2 ? "Drift needs two results or more." : `Drift of ${chosen.length} results over these dates`;
  };
  for (const entry of device.results) {
    const item = el("li", {}, made);
    const box = el("input", { type: "checkbox", checked: true, "aria-label": `take ${entry.path}`, onchange: told }, item);
    const date = el("input", { type: "text", size: 19, value: entry.date, "aria-label": `date of ${entry.path}` }, item);
    dates.set(entry.path, { box, date });
    el("a", { href: link("results", { path: entry.path }) }, item, entry.path.slice(8));
    el("small", {}, item, `${entry.title}; ${entry.about.method ?? ""}`);
    if (entry.about.error_percent !== null) el("small", {}, item, `error ${percent(entry.about.error_percent)}`);
    if (entry.about.met !== null) el("span", { class: `badge ${entry.about.met ? "ok" : "bad"}` }, item, entry.about.met ? "criterion met" : "criterion not met");
    removing(main, item, entry.path, look);
  }
  const row = el("p", { class: "row" }, part);
  const press = el("button", { type: "button" }, row, "Show the drift");
  const why = el("span", { class: "quiet", role: "status" }, row);
  press.addEventListener("click", () => {
    const chosen = device.results.filter((e) => dates.get(e.path).box.checked).map((e) => e.path);
    location.href = link("results", { compare: chosen.join(","), times: chosen.map((path) => dates.get(path).date.value.trim()).join(",") });
  });
  if (!device.results.length) el("p", { class: "empty" }, part, "No results yet.");
  row.hidden = !device.results.length;
  told();
}

function unused(main, place, logs, look) {
  if (!logs.length) return;
  const part = el("section", { "aria-labelledby": "unused" }, place);
  el("h2", { id: "unused" }, part, "Logs that no result was made of");
  const made = el("ul", { class: "list" }, part);
  for (const log of logs) {
    const item = el("li", {}, made);
    el("a", { href: link("data", { path: log.path }) }, item, log.path.slice(5));
    el("small", {}, item, `${bytes(log.size)}, ${when(log.modified)}${log.sha256 ? `, SHA-256 ${log.sha256.slice(0, 12)}` : ""}`);
    removing(main, item, log.path, look);
  }
}

function removing(main, item, path, look) {
  const press = el("button", { type: "button", "aria-label": `remove ${path}` }, item, "Remove");
  press.addEventListener("click", acting(main, async () => {
    if (press.dataset.asked === undefined) { press.dataset.asked = ""; press.textContent = "Move it to .haptid/trash?"; return; }
    await call("registry/remove", { path }, "POST");
    await look();
  }));
}
