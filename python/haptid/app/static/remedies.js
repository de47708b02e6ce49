// What is said of the logs of a study, with buttons that change the study's text so that they can be read.
import { acting, call, el } from "./common.js";

// `zoom(from, to)` shows a stretch of the log where curves are drawn.
export async function remedies(parent, editor, zoom = null) {
  parent.replaceChildren(el("p", { class: "quiet", role: "status" }, null, "Reading the logs ..."));
  const { logs } = await call("study/remedies", { path: editor.path, text: editor.text }, "POST");
  parent.replaceChildren();
  for (const one of logs.toSorted((a, b) => Number(!a.problem) - Number(!b.problem))) {
    el("h3", {}, parent, one.log);
    if (!one.problem) el("p", { class: "said ok" }, parent, "It can be read.");
    else el("p", { class: "problem" }, parent, one.problem);
    const row = el("p", { class: "row" }, parent);
    if (one.at !== null && zoom) el("button", { type: "button", onclick: () => zoom(one.at - 0.5, one.at + 0.5) }, row, `Show ${one.at.toFixed(2)} s`);
    for (const remedy of one.remedies) {
      const press = el("button", { type: "button", class: "remedy" }, row, remedy.title);
      press.addEventListener("click", acting(parent, async () => {
        editor.area.value = remedy.text;
        await editor.look();
        await remedies(parent, editor, zoom);
      }));
    }
    if (one.problem && !one.remedies.length) el("span", { class: "quiet" }, row, "No change of the study that was tried mends it.");
    if (!one.notes.length) continue;
    const list = el("ul", { class: "findings small" }, parent);
    for (const note of one.notes) el("li", {}, list, note);
  }
}
