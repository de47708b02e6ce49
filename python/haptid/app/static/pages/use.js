// Use: exports of a result's model, seen before they are written.
import { acting, bytes, call, el, field, link, options, typed } from "../common.js";

const ABOUT = {
  c: "C99 for a control loop, double precision", "c-single": "C99, single precision", rust: "a no_std crate", matlab: "for MATLAB and Octave",
  mjcf: "for MuJoCo", urdf: "for simulators", json: "parameters, groupings and covariance for programs", latex: "tables for a paper",
};

export async function show(main, query) {
  el("h1", {}, main, "Use");
  const [{ lists }, formats] = await Promise.all([call("workspace"), call("formats")]);
  const results = lists.result.map((e) => e.path);
  if (!results.length) {
    el("p", { class: "empty" }, main, "This folder has no results yet: the page Solve makes them.");
    typed("");
    return;
  }
  const row = el("div", { class: "row" }, main);
  const choice = field(row, "Result", el("select"));
  const path = results.includes(query.get("path")) ? query.get("path") : results[0];
  options(choice, results.map((one) => [one, one.slice(8)]), path);
  const format = field(row, "Format", el("select"));
  options(format, formats.map((one) => [one, ABOUT[one] ? `${one}: ${ABOUT[one]}` : one]), query.get("to") ?? "c");
  const said = el("p", { class: "said", role: "status" }, main);
  const verdict = el("p", {}, main);
  const write = el("button", { type: "button", class: "main", disabled: true }, el("p", { class: "row" }, main), "Write these files");
  const files = el("div", {}, main);
  const look = acting(main, async () => {
    history.replaceState(null, "", link("use", { path: choice.value, to: format.value }));
    files.replaceChildren();
    write.disabled = true;
    verdict.textContent = "";
    said.textContent = "Making the files ...";
    try {
      const made = await call("export", { path: choice.value, to: format.value });
      typed(made.command);
      verdict.textContent = made.verdict;
      said.textContent = `${made.files.length} files`;
      write.disabled = false;
      made.files.forEach((file, k) => {
        const more = el("details", { open: k === 0 }, files);
        el("summary", {}, more, `${file.name} (${bytes(file.bytes)}${file.cut ? ", its beginning" : ""})`);
        el("pre", { class: "code", tabindex: 0, "aria-label": file.name }, more, file.text || "not a text");
      });
    } catch (error) {
      said.textContent = "";
      throw error;
    }
  });
  choice.addEventListener("change", look);
  format.addEventListener("change", look);
  write.addEventListener("click", acting(main, async () => {
    const made = await call("export", { path: choice.value, to: [format.value] }, "POST");
    said.textContent = `Written into ${made.folders.join(", ")}.`;
  }));
  await look();
}
