// Live: samples are recorded first, then drawn; parameters as they become known, and the motion that is missing.
import { acting, answered, call, digits, el, field, link, options, reached, table, typed } from "../common.js";
import { Ring, Rolling } from "../curves.js";

const SECONDS = 10; // that are seen
const STATE_MS = 500, FRAME_MS = 33, CALM_MS = 500, PATIENCE_MS = 5000;

export async function show(main, query) {
  el("h1", {}, main, "Live");
  typed("");
  const state = await call("live/state");
  if (state.running) return new Watching(main, state);
  return beginning(main, query);
}

async function beginning(main, query) {
  const { lists } = await call("workspace");
  el("p", { class: "quiet" }, main, "A controller sends positions and torques as frames by UDP, or through a WebSocket: the layout is in the documentation. Every sample is written to logs/ before it is shown; the study says what its channels are.");
  if (!lists.study.length) {
    el("p", { class: "empty" }, main, "This folder has no studies yet: the page Data drafts one from a log, and the trial on the home page writes one.");
    return;
  }
  const form = el("form", { class: "row" }, main);
  const study = field(form, "Study", el("select"));
  options(study, lists.study.map((e) => [e.path, e.path.slice(8)]), query.get("study") ?? "");
  const name = field(form, "Record as logs/", el("input", { type: "text", size: 18, required: true, autocomplete: "off", value: "live" }));
  const rate = field(form, "Samples in a second", el("input", { type: "number", min: 1, max: 100000, value: query.get("rate") ?? 1000, required: true }));
  const port = field(form, "UDP port (0: a free one)", el("input", { type: "number", min: 0, max: 65535, value: 0, required: true }));
  const forgetting = field(form, "Forget in, s (empty: never)", el("input", { type: "number", min: 1, max: 1000000 }));
  const play = field(form, "Sent by", el("select"));
  options(play, [["", "a controller"], ...lists.log.map((e) => [e.path, `${e.path.slice(5)}, played again and again`])], query.get("play") ?? "");
  el("button", { type: "submit", class: "main" }, form, "Begin");
  form.addEventListener("submit", acting(main, async (event) => {
    event.preventDefault();
    await call("live/start", { study: study.value, name: name.value, rate: rate.value, port: port.value, forgetting: forgetting.value, play: play.value }, "POST");
    location.href = "/live";
  }));
}

class Watching {
  constructor(main, state) {
    this.main = main;
    const row = el("p", { class: "row" }, main);
    el("strong", {}, row, `Recording ${state.path}`);
    this.counts = el("span", { class: "quiet", role: "status" }, row);
    el("button", { type: "button", onclick: acting(main, () => this.end()) }, row, "End the recording");
    this.error = el("p", { class: "problem", role: "alert" }, main);
    const columns = el("div", { class: "columns" }, main);
    const left = el("div", {}, columns), right = el("div", {}, columns);
    this.guide(right);
    this.plots(left, state);
    this.next = Math.max(0, state.drawn - SECONDS * state.rate_hz);
    this.rowsSince = -1;
    this.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.told(state);
    this.look();
    this.frame();
  }

  plots(parent, state) {
    const n = state.positions, room = Math.ceil(1.2 * SECONDS * state.rate_hz), all = state.names.length;
    this.ring = new Ring(all, room);
    this.torques = new Ring(2 * state.rows.length, 100 * SECONDS * 10);
    this.force = new Ring(3, 100 * SECONDS * 10);
    const index = (from, to) => Array.from({ length: to - from }, (_, k) => from + k);
    el("h2", {}, parent, "Signals");
    this.charts = [
      new Rolling(parent, { title: "Positions", unit: state.units[0], names: state.names.slice(0, n), ring: this.ring, channels: index(0, n), seconds: SECONDS }),
      new Rolling(parent, { title: "Torques as sent", unit: state.units[1], names: state.names.slice(n), ring: this.ring, channels: index(n, all), seconds: SECONDS }),
      new Rolling(parent, {
        title: "Torque measured, and predicted (dashed)", unit: "at the joint", ring: this.torques, seconds: SECONDS, channels: index(0, 2 * state.rows.length),
        names: state.rows.flatMap((label) => [label, `${label} predicted`]), dashed: state.rows.map((_, k) => 2 * k + 1),
      }),
    ];
    this.hand = el("div", { hidden: true }, parent);
    this.charts.push(new Rolling(this.hand, { title: "Force of the hand", unit: "N, in the base frame", names: ["x", "y", "z"], ring: this.force, channels: [0, 1, 2], seconds: SECONDS }));
  }

  guide(parent) {
    el("h2", {}, parent, "Missing motion");
    this.prompt = el("p", { class: "criterion", role: "status", id: "prompt" }, parent, "Move the device: every joint, slowly and quickly.");
    const row = el("p", { class: "row" }, parent);
    this.score = field(row, "Torque not yet known, in the whole workspace", el("meter", { min: 0, max: 1, low: 0.1, high: 0.5, optimum: 0, value: 1 }));
    this.percent = el("strong", { id: "score" }, row, "100 %");
    this.others = el("ul", { class: "findings small" }, parent);
    el("h2", {}, parent, "Model");
    const hold = el("p", { class: "row" }, parent);
    this.hold = el("button", { type: "button", onclick: acting(this.main, async () => this.told(await call("live/hold", { held: String(!this.held) }, "POST"))) }, hold, "Hold this model");
    this.holding = el("span", { class: "quiet" }, hold);
    this.alarms = el("ul", { class: "findings", id: "alarms" }, el("div", { role: "log", "aria-label": "Alarms" }, parent));
    this.parameters = el("div", { id: "live-parameters" }, parent);
  }

  // Samples as fast as they are drawn; after a pause in which the tab was hidden, only the last seconds.
  async look() {
    try {
      const answer = await reached(`/api/live/samples?since=${this.next}`, { signal: AbortSignal.timeout(PATIENCE_MS) });
      if (!answer.ok) await answered(answer);
      if (answer.status === 204) return this.ended();
      const buffer = await answer.arrayBuffer(), size = new DataView(buffer).getUint32(0, true);
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size))), begin = 4 + size, n = head.rows;
      if (n) {
        const ys = this.ring.values.map((_, k) => new Float32Array(buffer, begin + 8 * n + 4 * n * k, n));
        this.ring.append(new Float64Array(buffer, begin, n), ys);
      }
      this.next = head.next;
      const now = performance.now();
      if (now - (this.asked ?? 0) > STATE_MS) {
        this.asked = now;
        const state = await call("live/state", { since: this.rowsSince }, "GET", PATIENCE_MS);
        if (!state.running) return this.ended();
        if (this.over) return;
        this.rows(state.new);
        this.told(state);
      }
    } catch (error) {
      if (!this.over) this.error.textContent = error.message;
    }
    if (!this.over) this.timer = setTimeout(() => this.look(), this.calm ? CALM_MS : FRAME_MS);
  }

  rows(found) {
    if (!found.t.length) return;
    const ys = found.measured.flatMap((m, k) => [Float32Array.from(m), Float32Array.from(found.predicted[k])]);
    this.torques.append(Float64Array.from(found.t), ys);
    this.rowsSince = found.t.at(-1);
    this.hand.hidden = !found.force;
    if (found.force) this.force.append(Float64Array.from(found.t), found.force.map((f) => Float32Array.from(f, (v) => v ?? NaN)));
  }

  frame(at = 0) {
    if (at - (this.shown ?? -1e9) >= (this.calm ? CALM_MS : FRAME_MS) - 2 && !document.hidden) {
      this.shown = at;
      for (const chart of this.charts) chart.draw(this.ring.last);
      this.main.dataset.frames = Number(this.main.dataset.frames ?? 0) + 1;
    }
    requestAnimationFrame((time) => this.frame(time));
  }

  told(state) {
    const { counts, analysis } = state;
    const also = [["late", counts.late], ["repeated", counts.repeated], [counts.restarts === 1 ? "restart" : "restarts", counts.restarts], ["broken", state.broken], ["of others", state.foreign]].filter(([, many]) => many);
    this.counts.textContent = `UDP port ${state.port}; ${counts.written} samples written, ${counts.lost} lost${also.map(([what, many]) => `, ${many} ${what}`).join("")}`;
    this.error.textContent = state.error;
    this.held = analysis.held;
    this.hold.textContent = analysis.held ? "Let it move again" : "Hold this model";
    this.holding.textContent = analysis.held ? "Held: residuals are watched, at most one false alarm in ten hours." : "Held, it is compared with what comes.";
    const score = analysis.score;
    if (score !== null && score !== undefined) {
      this.score.value = score;
      this.percent.textContent = `${Number((100 * score).toPrecision(2))} %`;
      const [first, ...rest] = analysis.prompts;
      this.prompt.textContent = score < 0.02 ? "Enough motion: the torque is known everywhere." : first?.sentence ?? "";
      this.others.replaceChildren(...rest.map((p) => el("li", {}, null, p.sentence)));
    } else if (analysis.trouble) this.prompt.textContent = analysis.trouble;
    this.alarms.replaceChildren(...analysis.alarms.slice(-6).reverse().map((a) => el("li", { class: "problem" }, null, a.sentence)));
    this.parameters.replaceChildren();
    const rows = analysis.parameters.map((p) => {
      if (p.se === null) return [p.name, "unknown", "", p.unit];
      const to = digits(p.se), [low, high] = p.conf_int;
      return [p.name, to(p.value), `${to(low)} .. ${to(high)}`, p.unit];
    });
    if (rows.length) table(this.parameters, ["parameter", "value", "95 % interval", "unit"], rows);
  }

  // By another page, or by this one, which goes on to the log itself.
  ended() {
    if (!this.over) location.href = "/live";
  }

  async end() {
    this.over = true; // an answer that is on its way changes nothing any more
    clearTimeout(this.timer);
    const made = await call("live/stop", {}, "POST");
    location.href = made.counts.written ? link("data", { path: made.path }) : "/live";
  }
}
