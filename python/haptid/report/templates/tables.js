// Tables that sort when a heading is pressed, and can be copied and downloaded.

function sortable(table) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    if (!heading.hasAttribute("data-sort")) return;
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

// By number where both have one, empty last; else by text.
function ordered(a, b) {
  const [x, y] = [a, b].map((cell) => cell.dataset.value ?? cell.textContent.trim());
  const [p, q] = [x, y].map((text) => (text === "" ? Infinity : Number(text)));
  if (Number.isNaN(p) || Number.isNaN(q)) return String(x).localeCompare(String(y), "en", { numeric: true });
  return p === q ? 0 : p - q;
}

const FORMATS = {
  csv: (rows) => {
    const keys = ["name", "value", "low", "high", "sd", "relative", "textbook_sd", "prior", "unit", "essential", "grouping"];
    const cell = (v) => (v === null ? "" : /[",\n]/.test(v) ? `"${String(v).replace(/"/g, '""')}"` : v);
    return [keys.join(","), ...rows.map((row) => keys.map((key) => cell(row[key])).join(","))].join("\n") + "\n";
  },
  json: (rows) => JSON.stringify(rows.map(({ shown: _, symbol, formula, ...rest }) => rest), null, 1) + "\n",
  tex: (rows) => {
    const body = rows.map((row) => {
      const name = row.latex ? row.latex.split(" = ")[0] : `\\mathrm{${row.name.replace(/_/g, "\\_")}}`;
      return `$${name}$ & ${row.shown.value} & ${row.shown.low} to ${row.shown.high} & ${row.unit.replace(/\^2/g, "$^2$")} \\\\`;
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

// Where the clipboard is closed to scripts of a local file.
function selected(text, done) {
  const box = html("textarea", { class: "hidden" }, document.body);
  box.value = text;
  box.select();
  if (document.execCommand("copy")) done();
  box.remove();
}

function tableText(table) {
  return [...table.rows].map((row) => [...row.cells].map((cell) => (cell.dataset.copy ?? cell.textContent).trim()).join("\t")).join("\n");
}

function startTables() {
  document.querySelectorAll("table.sortable").forEach(sortable);
  document.querySelectorAll("button[data-copy-table]").forEach((press) => {
    press.addEventListener("click", () => copied(press, tableText(document.getElementById(press.dataset.copyTable))));
  });
  document.querySelectorAll("button[data-copy-text]").forEach((press) => {
    press.addEventListener("click", () => copied(press, document.getElementById(press.dataset.copyText).textContent));
  });
  document.querySelectorAll("button[data-download]").forEach((press) => {
    const format = press.dataset.download;
    press.addEventListener("click", () => {
      const rows = JSON.parse(document.getElementById("parameter-rows").textContent);
      download(`parameters.${format}`, FORMATS[format](rows));
    });
  });
}
