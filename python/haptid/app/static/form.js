// A form beside a text: fields from the published schema; a change is made in the text, whose comments stay.
import { call, el, field, options } from "./common.js";

export class Form {
  // Under an editor of a kind of file ("study", "device"); rendered when it is opened, and again with the text.
  constructor(parent, editor, kind) {
    this.editor = editor;
    this.kind = kind;
    this.box = el("details", { class: "form" }, parent);
    el("summary", {}, this.box, "As a form");
    this.said = el("p", { class: "said", role: "status" }, this.box);
    this.place = el("div", {}, this.box);
    this.box.addEventListener("toggle", () => this.render());
    editor.area.addEventListener("change", () => this.render());
  }

  async render() {
    if (!this.box.open || this.shown === this.editor.text) return;
    const text = (this.shown = this.editor.text), found = await call("form", { kind: this.kind, text }, "POST");
    if (text !== this.editor.text) return this.render();
    this.say(found.error ?? "");
    if (found.error) return;
    const active = document.activeElement, focused = active instanceof HTMLElement ? active.dataset.field : undefined;
    this.place.replaceChildren();
    let group = "", at = null;
    for (const one of found.fields) {
      const name = one.path.slice(0, -1).map((key) => (typeof key === "number" ? `${key + 1}` : key)).join(" ") || "the file";
      if (name !== group) {
        at = el("fieldset", {}, this.place);
        el("legend", {}, at, name);
        group = name;
      }
      this.field(at, one);
    }
    if (focused) /** @type {HTMLElement} */ (this.place.querySelector(`[data-field='${CSS.escape(focused)}']`))?.focus();
  }

  field(parent, one) {
    const key = JSON.stringify(one.path), row = el("p", { class: "row" }, parent), given = one.value ?? "";
    const about = { "data-field": key, title: one.about };
    let input;
    if (one.kind === "choice") {
      input = field(row, one.path.at(-1), el("select", about));
      options(input, [["", "not given"], ...one.choices.map((c) => [JSON.stringify(c), String(c)])], one.value === null ? "" : JSON.stringify(given));
    } else {
      const number = one.kind === "number" || one.kind === "integer";
      input = field(row, one.path.at(-1), el("input", { ...about, type: number ? "number" : "text", ...(number && { step: one.kind === "integer" ? 1 : "any" }), value: Array.isArray(given) ? given.join(", ") : given, autocomplete: "off" }));
    }
    if (one.about) el("small", { class: "quiet" }, row, one.about);
    input.addEventListener("change", () => this.changed(one, input));
  }

  async changed(one, input) {
    const text = input.value.trim();
    let value = text;
    if (text === "") value = null;
    else if (one.kind === "choice") value = JSON.parse(text);
    else if (one.kind === "numbers") value = text.split(",").map(Number);
    else if (one.kind !== "text") value = Number(text);
    try {
      const made = await call("form/set", { text: this.editor.text, field: JSON.stringify(one.path), value: JSON.stringify(value) }, "POST");
      this.shown = this.editor.area.value = made.text;
      this.say("");
      await this.editor.look();
    } catch (error) {
      this.say(error.message);
      this.shown = null;
      await this.render();
      this.say(error.message);
    }
  }

  say(text) {
    this.said.className = text ? "said bad" : "said";
    this.said.textContent = text;
  }
}
