// Experiment: an exciting motion is searched for by a job, played back on the drawing, rehearsed and downloaded.
import { acting, call, devices, el, field, link, table, typed } from "../common.js";
import { Progress } from "../progress.js";
import { Curves } from "../curves.js";
import { samples } from "./data.js";
import { drawAll } from "/report/charts.js";

const LIMITS = [
  ["speed", "Largest speed, rad/s or m/s"], ["acceleration", "Largest acceleration"], ["torque", "Largest torque, N m or N"],
  ["centre", "Centre, rad or m"], ["stroke", "Stroke to either side"],
];

export async function show(main, query) {
  el("h1", {}, main, "Experiment");
  typed("");
  if (query.get("path")) return played(main, query.get("path"), query.get("device") ?? "");
  const [{ lists, bench }, shipped] = await Promise.all([call("workspace"), call("shipped")]);
  el("p", { class: "quiet" }, main, "A motion that makes every base parameter visible, within the limits of the device. Empty fields are the limits of the device file; one number is for all joints, or one for each with commas.");
  const form = el("form", {}, main), first = el("div", { class: "row" }, form);
  const device = devices(first, lists.device, shipped, query.get("device"));
  const name = field(first, "Save as experiments/", el("input", { type: "text", size: 18, required: true, autocomplete: "off", value: "motion" }));
  const seconds = field(first, "Duration, s", el("input", { type: "number", min: 1, max: 3600, value: 20, required: true }));
  const evaluations = field(first, "Motions evaluated, at most", el("input", { type: "number", min: 1, max: 100000, value: 1000, required: true }));
  const second = el("div", { class: "row" }, form);
  const given = LIMITS.map(([key, label]) => [key, field(second, label, el("input", { type: "text", size: 12, autocomplete: "off" }))]);
  el("button", { type: "submit", class: "main" }, el("p", { class: "row" }, form), "Search");
  const work = el("div", {}, main);
  const follow = (record) => {
    typed(record.command);
    work.replaceChildren();
    new Progress(work, record, (done) => { location.href = link("experiment", { path: done.outcome.experiment, device: done.outcome.device }); });
  };
  form.addEventListener("submit", acting(main, async (event) => {
    event.preventDefault();
    const limits = Object.fromEntries(given.map(([key, input]) => [key, input.value]));
    follow(await call("experiment/search", { device: device.value, name: name.value, seconds: seconds.value, evaluations: evaluations.value, ...limits }, "POST"));
  }));
  const part = el("section", { "aria-labelledby": "known" }, main);
  el("h2", { id: "known" }, part, "Experiments of this folder");
  const made = el("ul", { class: "list" }, part);
  for (const entry of lists.experiment) el("a", { href: link("experiment", { path: entry.path }) }, el("li", {}, made), entry.path.slice(12));
  if (!lists.experiment.length) el("p", { class: "empty" }, part, "None yet.");
  if (!bench) el("p", { class: "quiet" }, part, 'Rehearsal needs MuJoCo: pip install "haptid[bench]"');
}

async function played(main, path, named) {
  const found = await call("experiment", { path });
  const device = named || found.job?.arguments.device || "";
  main.querySelector("h1").textContent = `Experiment ${path.slice(12)}`;
  typed([found.job?.command, device && `haptid bench ${device} ${path} --out logs/${path.slice(12, -5)}.parquet`].filter(Boolean).join("\n"));
  const row = el("p", { class: "row" }, main);
  for (const file of [path, found.samples].filter(Boolean)) el("a", { href: `/api/download?${new URLSearchParams({ path: file })}`, download: "" }, row, `Download ${file.slice(12)}`);
  const work = el("div", {}, main);
  const press = el("button", { type: "button", disabled: !device }, row, "Rehearse on the virtual bench");
  if (!device) el("span", { class: "quiet" }, row, "Choose a device on the page Experiment: a file of an experiment names none.");
  press.addEventListener("click", acting(main, async () => {
    work.replaceChildren();
    new Progress(work, await call("experiment/rehearse", { device, path }, "POST"), (done) => { location.href = link("data", { path: done.outcome.log }); });
  }));
  const outcome = found.job?.outcome;
  if (outcome?.limits) {
    el("p", { class: "criterion" }, main, `Condition number ${Number(outcome.condition[1].toPrecision(4))} with unit columns; ${Number(outcome.condition[0].toPrecision(4))} for the first motion within the limits.`);
    if (outcome.weak.length) el("p", {}, main, `Poorly identifiable at the prior values: ${outcome.weak.join(", ")}.`);
  }
  const columns = el("div", { class: "columns" }, main), left = el("div", {}, columns), right = el("div", {}, columns);
  if (found.samples) await playback(left, right, found, device);
  if (outcome?.limits) {
    el("h2", {}, right, "Which limit binds");
    table(right, ["limit", "of", "used"], outcome.limits.map((one) => [one.limit, one.of, `${Math.round(100 * one.share)} %`]), "limits");
  }
  const more = el("details", {}, main);
  el("summary", {}, more, "The file");
  el("pre", { class: "code", tabindex: 0, "aria-label": path }, more, found.text);
}

// Curves, and the drawing at the time of a slider.
async function playback(left, right, found, device) {
  const [time, ...names] = found.columns, n = names.length / 3, data = await samples(found.samples, time, names);
  el("h2", {}, left, "Motion");
  const group = new Set(), kinds = [["Position", "rad or m"], ["Velocity", "rad/s or m/s"], ["Acceleration", "rad/s² or m/s²"]];
  kinds.forEach(([title, unit], k) => {
    const own = names.slice(k * n, (k + 1) * n);
    new Curves(left, { title, unit, names: own, t: data.t, ys: own.map((name) => data.of[name]), group });
  });
  if (!device) return;
  const text = device.includes("/") ? await call("file", { path: device }) : await call(`shipped/${device}`);
  const said = await call("device/check", { path: device.includes("/") ? device : `devices/${device}.toml`, text: text.text }, "POST");
  if (said.error) throw new Error(said.error);
  el("h2", {}, right, "Mechanism");
  const scene = el("div", { id: "scene" }, right);
  scene.innerHTML = said.sections[0].html; // made by the server from templates that escape
  drawAll(scene, said.drawings);
  const row = el("p", { class: "row" }, right), end = data.t[data.t.length - 1];
  const at = field(row, "Time", el("input", { type: "range", id: "time", min: 0, max: end, step: "any", value: 0 }));
  const shown = el("output", {}, row, "0.00 s"), play = el("button", { type: "button" }, row, "Play");
  const sliders = [...scene.querySelectorAll("input[data-joint]")];
  const moved = () => {
    const k = Math.min(data.t.length - 1, Math.round((at.valueAsNumber / end) * (data.t.length - 1)));
    shown.textContent = `${at.valueAsNumber.toFixed(2)} s`;
    sliders.forEach((slider, j) => { slider.value = data.of[names[j]][k]; });
    sliders[0]?.dispatchEvent(new Event("input", { bubbles: true }));
  };
  at.addEventListener("input", moved);
  let last = 0;
  const step = (now) => {
    if (play.textContent !== "Pause" || !play.isConnected) return;
    at.value = (at.valueAsNumber + (last ? (now - last) / 1000 : 0)) % end;
    last = now;
    moved();
    requestAnimationFrame(step);
  };
  play.addEventListener("click", () => {
    play.textContent = play.textContent === "Play" ? "Pause" : "Play";
    last = 0;
    requestAnimationFrame(step);
  });
  moved();
}
