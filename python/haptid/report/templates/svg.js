// SVG elements, colour-blind safe palette (Okabe and Ito 2008), legends and readouts.

// By name of a chart's colour: a custom property of the style sheet, which has it for light and dark.
const COLOURS = Object.fromEntries(["black", "blue", "vermillion", "green", "purple", "orange", "sky", "yellow"].map(
  (name) => [name, `var(--${name === "blue" ? "c-blue" : name})`]));

// A custom property as a canvas needs it.
function resolved(name) {
  const probe = html("i", { style: `color:var(--${name})` }, document.body);
  const made = getComputedStyle(probe).color;
  probe.remove();
  return made;
}

function svg(name, attributes = {}, parent = null, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// A style is set as a property: as an attribute a content security policy would refuse it.
function html(name, attributes = {}, parent = null, text = "") {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "style") made.style.cssText = value;
    else made.setAttribute(key, value);
  }
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// Width of names beside a chart: a quarter of it at most.
function besides(names, width, least) {
  return Math.min(14 + 7.6 * Math.max(...names.map((name) => name.length)), Math.max(least, width / 4));
}

// A name in so many pixels, without its middle where it is longer; all of it is in the title.
function named(name, room, attributes, parent) {
  const most = Math.max(Math.floor(room / 7.2), 6);
  const short = name.length > most ? `${name.slice(0, Math.ceil(most / 2) - 1)}…${name.slice(-Math.floor(most / 2))}` : name;
  const made = svg("text", attributes, parent, short);
  if (short !== name) svg("title", {}, made, name);
}

// Drawing area of a chart, as wide as its figure; role and label are in the template.
function canvasOf(holder, height) {
  const width = Math.max(240, holder.clientWidth || 640);
  const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, class: "drawing", "aria-hidden": "true" });
  holder.querySelector("svg.drawing")?.remove();
  holder.insertBefore(root, holder.querySelector(".readout"));
  return { root, width, height };
}

// Entries are buttons where `toggle` hides and shows a curve by its number.
function legend(holder, entries, toggle = null) {
  const box = html("div", { class: "legend" });
  entries.forEach((entry, k) => {
    const one = toggle && entries.length > 1 ? button(box, "", `hide or show ${entry.name}`, () => {
      const on = one.getAttribute("aria-pressed") !== "true";
      one.setAttribute("aria-pressed", on);
      toggle(k, on);
    }) : html("span", {}, box);
    one.classList.add("entry");
    if (one.type) { one.setAttribute("aria-pressed", "true"); one.removeAttribute("aria-label"); }
    html("i", { class: `swatch ${entry.style ?? "bar"}`, style: `--tint:${COLOURS[entry.colour]}` }, one);
    one.append(entry.name);
  });
  holder.prepend(box);
}

function readout(holder) {
  return html("div", { class: "readout", role: "status" }, holder, "\u00a0");
}

function button(parent, text, label, act) {
  const made = html("button", { type: "button", "aria-label": label, title: label }, parent, text);
  made.addEventListener("click", act);
  return made;
}
