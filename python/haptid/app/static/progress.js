// A job as it goes: steps with their shares and seconds, and a button that ends it.
import { call, el } from "./common.js";

const PERIOD = 250; // between two looks at a job, ms
const WORDS = { running: "running", done: "done", failed: "failed", cancelled: "cancelled", interrupted: "interrupted" };

export class Progress {
  // `finished` is told of a job that ends as it should, `ended` of any other end.
  constructor(parent, record, finished, ended = (_) => {}) {
    this.id = record.id;
    this.finished = finished;
    this.ended = ended;
    const head = el("p", { class: "row" }, parent);
    el("strong", {}, head, record.title);
    this.state = el("span", { class: "badge", role: "status" }, head);
    this.cancel = el("button", { type: "button" }, head, "Cancel");
    this.cancel.addEventListener("click", async () => {
      this.cancel.disabled = true;
      this.told(await call(`jobs/${this.id}/cancel`, {}, "POST"));
    });
    this.steps = el("ol", { class: "steps" }, parent);
    this.error = el("p", { class: "problem" }, parent);
    this.detail = el("pre", { hidden: true, tabindex: 0 }, parent);
    this.lines = new Map();
    this.told(record);
  }

  told(record) {
    this.state.textContent = WORDS[record.state];
    this.state.className = `badge ${{ done: "ok", failed: "bad" }[record.state] ?? "doubt"}`;
    for (const step of record.steps) {
      const known = this.lines.get(step.name) ?? this.line(step.name);
      known.text.textContent = step.text;
      known.bar.value = step.share;
      known.time.textContent = `${(step.until - step.at).toFixed(1)} s`;
    }
    this.error.textContent = record.error;
    this.detail.hidden = !record.defect;
    this.detail.textContent = record.defect;
    this.cancel.hidden = record.state !== "running";
    clearTimeout(this.timer);
    if (record.state === "running") this.timer = setTimeout(() => this.look(), PERIOD);
    else if (!this.over) {
      this.over = true;
      if (record.state === "done") this.finished(record); else this.ended(record);
    }
  }

  async look() {
    try {
      this.told(await call(`jobs/${this.id}`));
    } catch (error) {
      this.error.textContent = error.message;
    }
  }

  line(name) {
    const item = el("li", {}, this.steps), made = {};
    made.text = el("span", {}, item);
    made.bar = el("progress", { max: 1, "aria-label": name }, item);
    made.time = el("span", {}, item);
    this.lines.set(name, made);
    return made;
  }
}
