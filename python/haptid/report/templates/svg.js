// SVG elements, colour-blind safe palette (Okabe and Ito 2008), legends and readouts.

const COLOURS = {
  black: "#000000", blue: "#0072B2", vermillion: "#D55E00", green: "#009E73",
  purple: "#CC79A7", orange: "#E69F00", sky: "#56B4E9", yellow: "#F0E442",
};

function svg(name, attributes = {}, parent = null, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

function html(name, attributes = {}, parent = null, text = "") {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// Drawing area of a chart, as wide as its figure; role and label are in the template.
function canvasOf(holder, height) {
  const width = Math.max(240, holder.clientWidth || 640);
  const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, class: "drawing", "aria-hidden": "true" });
  holder.querySelector("svg.drawing")?.remove();
  holder.insertBefore(root, holder.querySelector(".readout"));
  return { root, width, height };
}

function legend(holder, entries) {
  const box = html("div", { class: "legend", "aria-hidden": "true" });
  for (const entry of entries) {
    const one = html("span", { class: "entry" }, box);
    html("i", { class: `swatch ${entry.style ?? "bar"}`, style: `--ink:${COLOURS[entry.colour]}` }, one);
    one.append(entry.name);
  }
  holder.prepend(box);
}

function readout(holder) {
  return html("div", { class: "readout", "aria-hidden": "true" }, holder, "\u00a0");
}

function button(parent, text, label, act) {
  const made = html("button", { type: "button", "aria-label": label, title: label }, parent, text);
  made.addEventListener("click", act);
  return made;
}
