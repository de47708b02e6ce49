// A text file under edit: checked while it is typed by the reader of the file's kind, saved against its hash.
import { call, el, Refused } from "./common.js";

const PAUSE = 200; // after the last key, ms

export class Editor {
  // `check(path, text)` returns what the text means, with `error` where it is wrong; `found` is told of each.
  constructor(parent, { label, rows, check, found }) {
    this.check = check;
    this.found = found;
    this.path = this.known = this.saved = "";
    this.run = 0;
    const name = `editor-${label.replace(/\W+/g, "-").toLowerCase()}`;
    el("label", { for: name }, parent, label);
    this.area = el("textarea", { id: name, rows, spellcheck: "false", autocomplete: "off", "aria-describedby": `${name}-said` }, parent);
    this.words = el("p", { class: "said", role: "status", id: `${name}-said` }, parent);
    this.conflict = el("div", {}, parent);
    this.area.addEventListener("input", () => { clearTimeout(this.timer); this.timer = setTimeout(() => this.look(), PAUSE); });
    addEventListener("beforeunload", (event) => { if (this.changed) event.preventDefault(); });
  }

  get text() { return this.area.value; }
  get changed() { return this.path !== "" && this.text !== this.saved; }

  show(path, text, known) {
    this.path = path;
    this.known = known;
    this.saved = known ? text : "";
    this.area.value = text;
    this.conflict.replaceChildren();
    return this.look();
  }

  async look() {
    const text = this.text, run = ++this.run;
    let said;
    try { said = await this.check(this.path, text); } catch (error) { said = { error: error.message }; }
    if (run !== this.run) return; // a later text is being checked
    this.area.setAttribute("aria-invalid", said.error ? "true" : "false");
    this.words.className = said.error ? "said bad" : "said ok";
    this.words.textContent = said.error ?? "";
    this.wrong = Boolean(said.error);
    await this.found(said);
  }

  async save(path = this.path) {
    const text = this.text;
    try {
      const { sha256 } = await call("file", { path, text, known: path === this.path ? this.known : "" }, "POST");
      this.path = path;
      this.known = sha256;
      this.saved = text;
      this.conflict.replaceChildren();
    } catch (error) {
      if (!(error instanceof Refused) || error.status !== 409) throw error;
      await this.differ(path, error);
    }
  }

  // Both versions, and what may be done with them.
  async differ(path, error) {
    const current = await call("file", { path });
    this.conflict.replaceChildren();
    const box = el("div", { class: "overlay", role: "alert" }, this.conflict);
    el("p", { class: "problem" }, box, error.message);
    el("pre", { class: "code", tabindex: 0, "aria-label": "the file as it is on the disk" }, box, current.text);
    const row = el("p", { class: "row" }, box);
    el("button", { type: "button", onclick: () => this.show(path, current.text, current.sha256) }, row, "Take the file on the disk");
    el("button", { type: "button", onclick: () => { this.path = path; this.known = current.sha256; return this.save(); } }, row, "Keep this text and write it");
  }
}
