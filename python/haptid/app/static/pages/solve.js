// Solve: a study is checked first, then identified by a job that outlives the tab.
import { acting, call, el, field, link, options, typed, uncomplain } from "../common.js";
import { Editor } from "../editor.js";
import { Form } from "../form.js";
import { Progress } from "../progress.js";

export async function show(main, query) {
  el("h1", {}, main, "Solve");
  if (query.get("job")) return job(main, query.get("job"));
  const { lists } = await call("workspace");
  const studies = lists.study.map((e) => e.path);
  if (!studies.length) {
    el("p", { class: "empty" }, main, "This folder has no studies yet: the page Data drafts one from a log.");
    typed("");
    return null;
  }
  const row = el("div", { class: "row" }, main);
  const choice = field(row, "Study", el("select"));
  const path = studies.includes(query.get("path")) ? query.get("path") : studies[0];
  options(choice, studies.map((one) => [one, one.slice(8)]), path);
  choice.addEventListener("change", () => { location.href = link("solve", { path: choice.value }); });
  const columns = el("div", { class: "columns" }, main);
  const left = el("div", {}, columns), right = el("div", {}, columns);
  return new Solving(main, left, right, path).open();
}

// One job by its number, as its address has it.
async function job(main, id) {
  const place = el("div", {}, main);
  const record = await call(`jobs/${id}`);
  typed(record.command);
  new Progress(place, record, (done) => { if (done.outcome.result) location.href = link("results", { path: done.outcome.result }); });
}

class Solving {
  constructor(main, left, right, path) {
    this.main = main;
    this.path = path;
    this.editor = new Editor(left, {
      label: "Study file", rows: 26,
      check: (at, text) => call("study/read", { path: at, text }, "POST"),
      found: (said) => {
        if (!said.error) this.editor.words.textContent = `Valid: ${said.method}; ${said.logs.map((log) => `${log.path} (${log.role})`).join(", ")}.`;
        return this.state();
      },
    });
    new Form(left, this.editor, "study");
    this.save = el("button", { type: "button" }, el("p", { class: "row" }, left), "Save");
    this.save.addEventListener("click", acting(main, async () => { await this.editor.save(); await this.state(); }));
    el("h2", {}, right, "1. Check");
    el("p", { class: "quiet" }, right, "Reads everything that the study names, chooses the treatment, fits nothing.");
    this.check = el("button", { type: "button" }, el("p", { class: "row" }, right), "Check");
    this.check.addEventListener("click", acting(main, () => this.begin("check", {})));
    this.findings = el("div", {}, right);
    el("h2", {}, right, "2. Identify");
    const row = el("div", { class: "row" }, right);
    this.out = field(row, "Result in results/", el("input", { type: "text", size: 24, autocomplete: "off", value: path.replace(/^studies\/|\.toml$/g, "") }));
    this.out.addEventListener("input", () => this.command());
    this.why = el("p", { class: "quiet", role: "status" }, right);
    const cluster = el("details", { class: "small" }, right);
    el("summary", {}, cluster, "On a cluster");
    this.scheduler = field(cluster, "Dask scheduler (empty: this computer)", el("input", { type: "text", size: 24, autocomplete: "off", placeholder: "tcp://host:8786" }));
    this.scheduler.addEventListener("input", () => this.command());
    this.run = el("button", { type: "button", class: "main", disabled: true }, row, "Run");
    this.run.addEventListener("click", acting(main, () => this.begin("identify", { out: `results/${this.out.value}`, scheduler: this.scheduler.value.trim() })));
    this.work = el("div", {}, right);
    this.command();
  }

  async open() {
    const file = await call("file", { path: this.path });
    await this.editor.show(this.path, file.text, file.sha256);
    const { running, last } = await call("study/state", { path: this.path });
    if (running) this.follow(running);
    else if (last && last.state !== "done") this.follow(last);
  }

  command() {
    const where = this.scheduler.value.trim();
    typed(`haptid check ${this.path}\nhaptid identify ${this.path} --out results/${this.out.value}${where && ` --scheduler ${where}`}`);
  }

  async begin(kind, values) {
    uncomplain(this.main);
    this.follow(await call(kind, { path: this.path, ...values }, "POST"));
    await this.state();
  }

  follow(record) {
    this.work.replaceChildren();
    new Progress(this.work, record, async (done) => {
      if (done.kind === "check") this.work.replaceChildren();
      await this.state();
      if (done.outcome.result) el("a", { href: link("results", { path: done.outcome.result }) }, el("p", { class: "criterion" }, this.work), "Open the result");
    }, () => this.state());
  }

  // What may be pressed now, and why not.
  async state() {
    const found = await call("study/state", { path: this.path });
    const unsaved = this.editor.changed, busy = Boolean(found.running);
    this.save.disabled = !unsaved || this.editor.wrong;
    this.check.disabled = unsaved || busy || this.editor.wrong;
    this.run.disabled = unsaved || busy || !found.ready;
    this.why.textContent = busy ? `${found.running.title} is running.`
      : unsaved ? "The text is not saved."
      : found.error ? found.error
      : found.ready ? "Checked as it is now."
      : found.fresh ? "The check found problems: change what they say first."
      : found.check ? "Study, device or logs have changed since the check: check again." : "Check first.";
    this.told(found.check, found.fresh);
  }

  told(record, fresh) {
    this.findings.replaceChildren();
    const found = record?.outcome.check;
    if (!found) return;
    const box = el("div", { class: fresh ? "" : "quiet" }, this.findings);
    if (!fresh) el("p", { class: "badge doubt" }, box, "of an earlier state");
    if (found.problems.length) {
      el("h3", {}, box, "To be changed first");
      const list = el("ul", { class: "findings" }, box);
      for (const one of found.problems) el("li", { class: "problem" }, list, one);
    } else el("p", { class: "said ok" }, box, "No problems were found.");
    if (found.device) el("p", { class: "small" }, box, found.device);
    for (const log of found.logs) {
      el("h3", {}, box, `${log.path} (${log.role})`);
      if (log.summary) el("p", { class: "small" }, box, log.summary);
      notes(box, log.notes);
    }
    for (const [title, lines] of [["Would be done", found.steps], ["Treatment", found.treatment]]) {
      if (!lines.length) continue;
      const more = el("details", { open: title === "Would be done" }, box);
      el("summary", {}, more, title);
      notes(more, lines);
    }
  }
}

function notes(parent, lines) {
  const list = el("ul", { class: "findings small" }, parent);
  for (const line of lines) el("li", {}, list, line);
}
