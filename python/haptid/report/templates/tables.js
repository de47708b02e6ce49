// Tables: sorting by heading, copying, saving, and a hint where a table is wider than the page.

function sortable(table) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const press = html("button", { type: "button", class: "sort", title: "sort" });
    press.append(...heading.childNodes);
    heading.append(press);
    press.addEventListener("click", () => {
      const way = heading.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
      for (const other of headings) other.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", way);
      const rows = [...table.tBodies[0].rows];
      rows.sort((a, b) => (way === "ascending" ? 1 : -1) * ordered(a.cells[column], b.cells[column]));
      table.tBodies[0].append(...rows);
    });
  });
}

// Numeric order where both have a number, empty cells last; otherwise by text.
function ordered(a, b) {
  const [x, y] = [a, b].map((cell) => cell.dataset.value ?? cell.textContent.trim());
  const [p, q] = [x, y].map((text) => (text === "" ? Infinity : Number(text)));
  if (Number.isNaN(p) || Number.isNaN(q)) return String(x).localeCompare(String(y), "en", { numeric: true });
  return p === q ? 0 : p - q;
}

function commas(rows) {
  const cell = (v) => (v === null ? "" : /[",\n]/.test(v) ? `"${String(v).replace(/"/g, '""')}"` : v);
  return rows.map((row) => row.map(cell).join(",")).join("\n") + "\n";
}

const FORMATS = {
  csv: (rows) => {
    const keys = ["name", "value", "low", "high", "se", "relative", "classical_se", "prior", "unit", "excited", "essential", "grouping"];
    return commas([keys, ...rows.map((row) => keys.map((key) => row[key]))]);
  },
  json: (rows) => JSON.stringify(rows.map(({ shown: _, symbol, formula, ...rest }) => rest), null, 1) + "\n",
  tex: (rows) => {
    const body = rows.map((row) => {
      const name = row.latex ? row.latex.split(" = ")[0] : `\\mathrm{${row.name.replace(/_/g, "\\_")}}`;
      return `$${name}$ & ${row.shown.value} & ${row.shown.interval.replace("…", "to")} & ${row.unit.replace(/\^2/g, "$^2$")} \\\\`;
    });
    return ["\\begin{tabular}{lrrl}", "parameter & value & 95\\,\\% interval & unit \\\\ \\hline", ...body, "\\end{tabular}", ""].join("\n");
  },
};

function download(name, text) {
  const link = html("a", { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: name });
  link.click();
  URL.revokeObjectURL(link.href);
}

function copied(press, text) {
  const done = () => {
    const before = press.textContent;
    press.textContent = "copied";
    setTimeout(() => { press.textContent = before; }, 1500);
  };
  if (navigator.clipboard && window.isSecureContext) navigator.clipboard.writeText(text).then(done, () => selected(text, done));
  else selected(text, done);
}

// Fallback where scripts of a local file cannot use the clipboard.
function selected(text, done) {
  const box = html("textarea", { class: "hidden" }, document.body);
  box.value = text;
  box.select();
  if (document.execCommand("copy")) done();
  box.remove();
}

function texts(table) {
  return [...table.rows].map((row) => [...row.cells].map((cell) => (cell.dataset.copy ?? cell.textContent).trim()));
}

// Buttons below a table; a table with embedded rows is saved from these, with all digits.
function actions(table) {
  const bar = html("p", { class: "actions" });
  const copy = html("button", { type: "button", "data-copy-table": table.id }, bar, "copy the table");
  copy.addEventListener("click", () => copied(copy, texts(table).map((row) => row.join("\t")).join("\n")));
  const rows = document.getElementById(`${table.id}-rows`);
  const save = (format, word, made) => {
    const press = html("button", { type: "button", "data-download": format }, bar, word);
    press.addEventListener("click", () => download(`${table.id.replace("-table", "")}.${format}`, made()));
  };
  const whole = () => JSON.parse(rows.textContent);
  if (rows) for (const [format, word] of [["csv", "CSV"], ["json", "JSON"], ["tex", "LaTeX"]]) save(format, word, () => FORMATS[format](whole()));
  else save("csv", "CSV", () => commas(texts(table)));
  return bar;
}

function hinted(table) {
  const holder = table.closest(".wide");
  const hint = html("p", { class: "hint", hidden: "" }, null, "The table continues to the right: scroll sideways →");
  holder.before(hint);
  holder.after(actions(table));
  new ResizeObserver(() => {
    hint.hidden = holder.scrollWidth <= holder.clientWidth + 1;
    if (hint.hidden) holder.removeAttribute("tabindex"); else holder.tabIndex = 0;
  }).observe(holder);
}

function startTables(root) {
  root.querySelectorAll(".wide > table").forEach((table) => {
    sortable(table);
    hinted(table);
  });
  root.querySelectorAll("button[data-copy-text]").forEach((press) => {
    press.addEventListener("click", () => copied(press, document.getElementById(press.dataset.copyText).textContent));
  });
}
