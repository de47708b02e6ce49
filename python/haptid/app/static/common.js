// What all pages use: elements, calls of the server, errors as sentences, the command line that does the same.

// An element with attributes, listeners (`onclick`) and text, put at the end of a parent.
export function el(name, attributes = {}, parent = null, text = "") {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value);
  }
  if (text !== "") made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// An answer that is no success: `error` is a sentence for people, `current` the file as it is now.
export class Refused extends Error {
  constructor(status, said) {
    super(said.error ?? (said.defect ? "This is a defect of haptid." : `The server answered with status ${status}.`));
    this.status = status;
    this.defect = said.defect;
    this.current = said.current;
  }
}

// Values of a GET go into the address, those of a POST into the body. A call that is given up after some milliseconds is
// for what is asked again: an answer that came while the tab was frozen is lost.
export async function call(path, values = {}, method = "GET", patience = 0) {
  const address = new URL(`/api/${path}`, location.href);
  const settings = /** @type {RequestInit} */ ({ method, ...(patience && { signal: AbortSignal.timeout(patience) }) });
  if (method === "GET") for (const [key, value] of Object.entries(values)) address.searchParams.set(key, value);
  else settings.body = JSON.stringify(values);
  return answered(await reached(address, settings));
}

export async function reached(address, settings = {}) {
  try {
    return await fetch(address, settings);
  } catch {
    throw new Refused(0, { error: "The workbench does not answer: was it ended? Start `haptid app` again." });
  }
}

export async function answered(answer) {
  const text = await answer.text();
  let said;
  try { said = JSON.parse(text); } catch { said = { error: text.trim() || undefined }; }
  if (!answer.ok) throw new Refused(answer.status, said);
  return said;
}

export function complain(parent, error) {
  parent.querySelector(":scope > .overlay")?.remove();
  const box = el("div", { class: "overlay", role: "alert" });
  el("p", { class: "problem" }, box, error.message);
  const detail = error.defect ?? (error instanceof Refused ? "" : error.stack);
  if (detail) {
    const more = el("details", {}, box);
    el("summary", {}, more, "A report to copy");
    el("pre", {}, more, detail);
  }
  const heading = parent.querySelector(":scope > h1");
  if (heading) heading.after(box); else parent.prepend(box);
  return box;
}

export function uncomplain(parent) {
  parent.querySelector(":scope > .overlay")?.remove();
}

// Runs an act of a button or a form, and shows its error on the page.
export function acting(parent, act) {
  return async (event) => {
    try {
      uncomplain(parent);
      await act(event);
    } catch (error) {
      complain(parent, error).scrollIntoView({ block: "nearest" });
    }
  };
}

export function typed(command) {
  const box = document.getElementById("command");
  box.hidden = !command;
  box.querySelector("pre").textContent = command;
}

export function link(page, values) {
  return `/${page}?${new URLSearchParams(values)}`;
}

export function when(seconds) {
  return new Date(seconds * 1000).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

export function bytes(count) {
  if (count < 1024) return `${count} B`;
  const power = Math.min(Math.floor(Math.log2(count) / 10), 3);
  return `${(count / 1024 ** power).toPrecision(3)} ${["", "KiB", "MiB", "GiB"][power]}`;
}

// A table of texts; a cell may be an element.
export function table(parent, heads, rows, id = "") {
  const holder = el("div", { class: "wide" }, parent);
  scrolled(holder);
  const made = el("table", id ? { id } : {}, holder);
  const head = el("tr", {}, el("thead", {}, made));
  for (const text of heads) el("th", { scope: "col" }, head, text);
  const body = el("tbody", {}, made);
  for (const cells of rows) {
    const row = el("tr", {}, body);
    for (const cell of cells) {
      const place = el("td", {}, row);
      if (cell instanceof Node) place.append(cell); else place.textContent = cell;
    }
  }
  return made;
}

// What is wider than its place is scrolled by keyboard too.
function scrolled(holder) {
  new ResizeObserver(() => {
    if (holder.scrollWidth > holder.clientWidth) holder.tabIndex = 0; else holder.removeAttribute("tabindex");
  }).observe(holder);
}

let number = 0;
// A label and its field, which stay together where a row is broken.
export function field(parent, label, input) {
  input.id ||= `field-${++number}`;
  const pair = el("span", { class: "field" }, parent);
  el("label", { for: input.id }, pair, label);
  pair.append(input);
  return input;
}

// A choice of a device: those of the folder, then the shipped ones; none is chosen where none is known.
export function devices(parent, own, shipped, chosen) {
  const select = field(parent, "Device", el("select", { required: true }));
  const named = [...own.map((e) => [e.path, `${e.path.slice(8)} (this folder)`]), ...shipped.map((e) => [e.name, e.name])];
  options(select, [["", "choose one"], ...named], chosen || own[0]?.path);
  return select;
}

// Numbers to two digits of their standard error.
export function digits(se) {
  const places = Math.min(Math.max(1 - Math.floor(Math.log10(se)), 0), 12);
  return (value) => (se > 0 && Number.isFinite(value) ? value.toFixed(places) : String(value));
}

// Per cent, to two digits.
export function percent(value) {
  return `${value < 100 ? value.toPrecision(2) : value.toFixed(0)} %`;
}

export function options(select, entries, chosen = "") {
  select.replaceChildren();
  for (const [value, text] of entries) el("option", { value, selected: value === chosen }, select, text);
}
