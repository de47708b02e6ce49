// Data: logs are dropped, their channels guessed with reasons and drawn; a study is drafted from them.
import { acting, answered, bytes, call, devices, el, field, link, options, reached, table, typed } from "../common.js";
import { Editor } from "../editor.js";
import { Form } from "../form.js";
import { remedies } from "../remedies.js";
import { Curves } from "../curves.js";

export async function show(main, query) {
  el("h1", {}, main, "Data");
  dropping(main, (path) => { location.href = link("data", { ...(query.get("device") && { device: query.get("device") }), path }); });
  const row = el("div", { class: "row" }, main);
  const choice = field(row, "Log", el("select"));
  const { lists } = await call("workspace");
  const logs = lists.log.map((e) => e.path);
  if (!logs.length) {
    row.remove();
    el("p", { class: "empty" }, main, "This folder has no logs yet.");
    typed("");
    return;
  }
  const path = logs.includes(query.get("path")) ? query.get("path") : logs[0];
  options(choice, logs.map((log) => [log, log.slice(5)]), path);
  choice.addEventListener("change", () => { location.href = link("data", { path: choice.value }); });
  typed(`haptid channels ${path}`);
  const part = el("section", { "aria-labelledby": "channels" }, main);
  el("h2", { id: "channels" }, part, "Channels");
  await channels(part, path).catch((error) => el("p", { class: "problem", role: "alert" }, part, error.message));
  await drafting(main, path, logs, query.get("device") ?? "", lists.device);
}

// Files are streamed to the disk of the folder; one is opened as soon as it is there.
function dropping(main, opened) {
  const box = el("div", { class: "drop" }, main);
  const input = field(box, "Drop logs here, or choose files: ", el("input", { type: "file", multiple: true }));
  const said = el("p", { class: "said", role: "status" }, box);
  const take = acting(main, async (files) => {
    let last = "";
    for (const file of files) {
      said.textContent = `Writing ${file.name} (${bytes(file.size)}) ...`;
      const answer = await reached(`/api/drop?${new URLSearchParams({ name: file.name })}`, { method: "POST", body: file });
      const made = await answered(answer);
      said.textContent = made.known ? `${file.name} is there already, as ${made.path}.` : `${made.path}: ${bytes(made.bytes)}`;
      last = made.path;
    }
    if (last) opened(last);
  });
  input.addEventListener("change", () => take(input.files));
  for (const kind of ["dragenter", "dragover"]) box.addEventListener(kind, (event) => { event.preventDefault(); box.classList.add("over"); });
  box.addEventListener("dragleave", () => box.classList.remove("over"));
  box.addEventListener("drop", (event) => { event.preventDefault(); box.classList.remove("over"); take(event.dataTransfer.files); });
}

const QUANTITIES = ["position", "torque", "velocity", "other"];
const MOST = 8; // curves in one chart
const drawn = new Set(); // charts of the log, with one axis

async function channels(part, path) {
  const found = await call("log", { path });
  for (const note of found.notes) el("p", { class: "small" }, part, note);
  const all = found.topics.flatMap((topic) => topic.channels);
  const time = all.find((c) => c.quantity === "time")?.name ?? "";
  const first = new Set(all.filter((c) => ["position", "torque"].includes(c.quantity) && c.count && c.high > c.low).slice(0, 2 * MOST).map((c) => c.name));
  const boxes = [];
  for (const topic of found.topics) {
    el("h3", {}, part, `${topic.name || found.format}: ${topic.count} ${topic.name ? "messages" : "rows"}${topic.rate_hz ? `, ${Number(topic.rate_hz.toPrecision(5))} Hz` : ""}`);
    if (topic.why_not) { el("p", {}, part, topic.why_not); continue; }
    const rows = topic.channels.map((c) => {
      const box = el("input", { type: "checkbox", "aria-label": `draw ${c.name}`, checked: first.has(c.name), disabled: !c.count || c.name === time });
      boxes.push([c, box]);
      const range = c.count ? `${Number(c.low.toPrecision(5))} .. ${Number(c.high.toPrecision(5))}` : "nothing but NaN";
      return [box, c.name, c.unit ? `${c.quantity}, ${c.unit}` : c.quantity, range, String(c.count), String(c.missing || ""), c.reason];
    });
    table(part, ["draw", "channel", "guess", "range", "samples", "missing", "reason"], rows);
  }
  const said = el("p", { class: "small", role: "status" }, part);
  const plots = el("div", { id: "plots" }, part);
  const draw = acting(part, async () => {
    const chosen = boxes.filter(([, box]) => box.checked).map(([c]) => c);
    plots.replaceChildren();
    if (!chosen.length) { said.textContent = "No channel is drawn."; return; }
    const data = await samples(path, time, chosen.map((c) => c.name));
    said.textContent = `As recorded, before any treatment. Drag across a chart to zoom, double-click to show all; with the keys + and -, 0, and the arrows.${data.each > 1 ? ` Least and greatest of every ${data.each} samples are drawn.` : ""}`;
    drawn.clear();
    for (const quantity of QUANTITIES) {
      const of = chosen.filter((c) => c.quantity === quantity);
      for (let k = 0; k < of.length; k += MOST) {
        const some = of.slice(k, k + MOST), units = [...new Set(some.map((c) => c.unit).filter(Boolean))];
        new Curves(plots, { title: quantity, unit: units.length === 1 ? units[0] : "", names: some.map((c) => c.name), t: data.t, ys: some.map((c) => data.of[c.name]), group: drawn });
      }
    }
    plots.dataset.drawn = performance.now();
  });
  for (const [, box] of boxes) box.addEventListener("change", draw);
  await draw();
}

// Channels as float32, and the times.
export async function samples(path, time, names) {
  const query = new URLSearchParams({ path, time });
  for (const name of names) query.append("channel", name);
  const answer = await reached(`/api/samples?${query}`);
  if (!answer.ok) await answered(answer);
  const buffer = await answer.arrayBuffer();
  const size = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  const begin = 4 + size, n = head.rows, of = {};
  head.names.forEach((name, k) => { of[name] = new Float32Array(buffer, begin + 8 * n + 4 * n * k, n); });
  const t = new Float64Array(buffer, begin, n);
  return { t: t.map((v) => v - t[0]), of, each: head.each };
}

// The text of a study of chosen logs, and where it is saved.
async function drafting(main, path, logs, device, own) {
  const part = el("section", { "aria-labelledby": "study" }, main);
  el("h2", { id: "study" }, part, "Study");
  el("p", {}, part, "A study names the device, the logs with their roles and channels, and how to identify. A draft is made of the guesses above: check units and channels before it is saved.");
  const form = el("form", { class: "row" }, part);
  const choice = devices(form, own, await call("shipped"), device);
  const first = field(form, "Identify from", el("select"));
  options(first, logs.map((log) => [log, log.slice(5)]), path);
  const second = field(form, "Validate with", el("select"));
  options(second, [["", "no other log"], ...logs.map((log) => [log, log.slice(5)])], logs.find((log) => log !== path) ?? "");
  el("button", { type: "submit" }, form, "Draft a study");
  const place = el("div", { hidden: true }, part);
  const words = (said) => `Valid: ${said.method}; ${said.logs.map((log) => `${log.path} (${log.role})`).join(", ")}.`;
  const editor = new Editor(place, {
    label: "Study file", rows: 24,
    check: (at, text) => call("study/read", { path: at, text }, "POST"),
    found: (said) => { if (!said.error) editor.words.textContent = words(said); press.disabled = Boolean(said.error); },
  });
  new Form(place, editor, "study");
  const found = el("div", { id: "remedies" }, place);
  const zoom = (from, to) => {
    const [first] = drawn;
    first?.all(from, to);
    first?.holder.scrollIntoView({ block: "nearest" });
  };
  const row = el("p", { class: "row" }, place);
  el("button", { type: "button", onclick: acting(part, () => remedies(found, editor, zoom)) }, row, "Read the logs again");
  brushing(main, row, path, editor, () => remedies(found, editor, zoom));
  const save = el("form", { class: "row" }, place);
  const name = field(save, "Save as studies/", el("input", { type: "text", size: 24, required: true, autocomplete: "off" }));
  const press = el("button", { type: "submit", class: "main" }, save, "Save and go on to solve");
  form.addEventListener("submit", acting(part, async (event) => {
    event.preventDefault();
    const chosen = [...new Set([first.value, second.value].filter(Boolean))];
    const made = await call("study/draft", { device: choice.value, logs: chosen }, "POST");
    place.hidden = false;
    name.value = made.path.replace(/^studies\/|\.toml$/g, "");
    typed(made.command);
    await editor.show(made.path, made.text, "");
    await remedies(found, editor, zoom);
  }));
  save.addEventListener("submit", acting(part, async (event) => {
    event.preventDefault();
    const at = `studies/${name.value.replace(/(\.toml)?$/, ".toml")}`;
    await editor.save(at);
    if (!editor.conflict.childElementCount) location.href = link("solve", { path: at });
  }));
}

// The stretch that the charts show can be left out of the log.
function brushing(main, row, path, editor, again) {
  const words = "Leave out a stretch: zoom to it in a chart first", press = el("button", { type: "button", disabled: true }, row, words);
  let seen = [0, 0];
  main.addEventListener("view", ({ detail }) => {
    press.disabled = !detail;
    seen = detail ?? seen;
    press.textContent = detail ? `Leave out ${seen[0].toFixed(3)} to ${seen[1].toFixed(3)} s of this log` : words;
  });
  press.addEventListener("click", acting(main, async () => {
    const [begin, end] = seen.map((t) => t.toFixed(3));
    const { text } = await call("form/leave-out", { text: editor.text, log: path, begin, end }, "POST");
    editor.area.value = text;
    await editor.look();
    await again();
  }));
}
