// Device: the file as text, what it means by haptid's own reader, and the mechanism in three dimensions.
import { acting, call, el, field, link, options, table, typed } from "../common.js";
import { Editor } from "../editor.js";
import { Form } from "../form.js";
import { drawAll } from "/report/charts.js";

export async function show(main, query) {
  el("h1", {}, main, "Device");
  const row = el("div", { class: "row" }, main);
  const choice = field(row, "Device", el("select"));
  const file = field(row, "or import a URDF, SDF, MJCF or SYMORO file", el("input", { type: "file", accept: ".urdf,.sdf,.xml,.par" }));
  const taken = el("div", {}, main);
  const columns = el("div", { class: "columns" }, main);
  const left = el("div", {}, columns), right = el("div", {}, columns);
  const view = new View(right);
  const editor = new Editor(left, {
    label: "Device file", rows: 30,
    check: (path, text) => call("device/check", { path, text }, "POST"),
    found: (said) => {
      if (!said.error) editor.words.textContent = `Valid: ${said.name}, ${said.count} base parameters of ${said.standard} standard parameters.`;
      view.show(said);
      buttons();
    },
  });
  new Form(left, editor, "device");
  const save = el("form", { class: "row" }, left);
  const place = field(save, "Save as devices/", el("input", { type: "text", size: 24, required: true, autocomplete: "off" }));
  const press = el("button", { type: "submit" }, save, "Save");
  const next = el("a", {}, save, "Go on to data");
  const said = el("span", { class: "quiet", role: "status" }, save);
  const buttons = () => {
    press.disabled = editor.wrong;
    press.title = editor.wrong ? "The file is wrong: see the sentence below it." : "";
  };
  save.addEventListener("submit", acting(main, async (event) => {
    event.preventDefault();
    const path = `devices/${place.value.replace(/(\.toml)?$/, ".toml")}`;
    await editor.save(path);
    if (editor.conflict.childElementCount) return;
    said.textContent = `Saved as ${path}.`;
    await list(path);
    address(path);
  }));

  const address = (path) => {
    const shipped = !path.includes("/");
    history.replaceState(null, "", link("device", { path }));
    typed(`haptid model ${path}`);
    next.href = link("data", { device: path });
    place.value = shipped ? path : path.replace(/^devices\/|\.toml$/g, "");
  };
  file.addEventListener("change", acting(main, async () => {
    if (!file.files.length) return;
    const name = file.files[0].name, made = await call("import", { name, text: await file.files[0].text() }, "POST");
    imported(taken, name, made);
    said.textContent = "Imported: not saved yet.";
    place.value = made.path.replace(/^devices\/|\.toml$/g, "");
    typed(made.command);
    await editor.show(made.path, made.text, "");
  }));
  const open = async (path) => {
    said.textContent = "";
    taken.replaceChildren();
    address(path);
    if (path.includes("/")) {
      const file = await call("file", { path });
      await editor.show(path, file.text, file.sha256);
    } else {
      const { text } = await call(`shipped/${path}`);
      await editor.show(`devices/${path}.toml`, text, "");
      editor.saved = text; // unchanged until it is edited
      said.textContent = "A shipped device: an edited copy is saved in the folder.";
    }
  };
  const list = async (chosen) => {
    const [{ lists }, shipped] = await Promise.all([call("workspace"), call("shipped")]);
    const own = lists.device.map((e) => [e.path, `${e.path.slice(8)} (this folder)`]);
    options(choice, [...own, ...shipped.map((e) => [e.name, e.name])], chosen);
    return choice.value;
  };
  choice.addEventListener("change", acting(main, () => open(choice.value)));
  await open(await list(query.get("path") ?? ""));
}

// What was taken from a robot description as it is, what is approximate, and what was left out.
function imported(parent, name, made) {
  parent.replaceChildren();
  el("h2", {}, parent, `Imported from ${name}`);
  el("p", {}, parent, made.check);
  const grades = { exact: "ok", approximate: "doubt", "left out": "bad" };
  const rows = made.notes.map((note) => [el("span", { class: `badge ${grades[note.grade] ?? ""}` }, null, note.grade), note.text, note.line ? String(note.line) : ""]);
  if (rows.length) table(parent, ["", "", "line"], rows);
}

// What a device file means: kept as it was while the text is wrong.
class View {
  constructor(parent) {
    el("h2", {}, parent, "Mechanism");
    this.scene = el("div", {}, parent);
    this.count = el("p", { class: "criterion", role: "status" }, parent);
    this.tables = el("div", {}, parent);
    document.addEventListener("colours", () => this.redraw?.());
  }

  show(said) {
    this.scene.classList.toggle("stale", Boolean(said.error));
    if (said.error) {
      this.count.textContent = "The drawing and the tables are of the last valid text.";
      return;
    }
    const { html } = said.sections[0];
    this.scene.innerHTML = html; // made by the server from templates that escape
    this.redraw = drawAll(this.scene, said.drawings);
    this.count.textContent = `${said.count} base parameters of ${said.standard} standard parameters`;
    this.tables.replaceChildren();
    for (const part of said.tables) {
      el("h2", {}, this.tables, part.title);
      table(this.tables, part.head, part.rows);
    }
    if (said.loops.length) {
      el("h2", {}, this.tables, "Loops");
      el("p", {}, this.tables, said.loops.join(", "));
    }
    const more = el("details", {}, this.tables);
    el("summary", {}, more, "Base parameters and what they regroup");
    table(more, ["parameter", "unit", "regroups"], said.base.map((b) => [b.name, b.unit, b.grouping]), "base");
    if (said.no_effect.length) el("p", { class: "small" }, more, `Without effect on the torque: ${said.no_effect.join(" ")}.`);
    for (const note of said.notes) el("p", { class: "small" }, this.tables, note);
  }
}
