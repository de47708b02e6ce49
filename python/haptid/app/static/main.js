// The shell: which page this is, its colours, and errors that no page has caught.
import { complain, el } from "./common.js";

const name = location.pathname.replace(/^\/|\/$/g, "");
const main = document.getElementById("main");

// From the system's colours to light, to dark; kept as the report keeps it.
function colours() {
  const press = /** @type {HTMLButtonElement} */ (document.getElementById("theme")), root = document.documentElement, order = ["system", "light", "dark"];
  const set = (wanted) => {
    if (wanted === "system") delete root.dataset.theme; else root.dataset.theme = wanted;
    press.textContent = `colours: ${wanted}`;
    press.value = wanted;
    document.dispatchEvent(new Event("colours"));
  };
  press.addEventListener("click", () => {
    set(order[(order.indexOf(press.value) + 1) % order.length]);
    localStorage.setItem("haptid-theme", press.value);
  });
  const kept = localStorage.getItem("haptid-theme");
  set(order.includes(kept) ? kept : "system");
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.dispatchEvent(new Event("colours")));
}

async function begin() {
  colours();
  const here = document.querySelector(`nav a[data-page="${name}"]`);
  here?.setAttribute("aria-current", "page");
  document.title = `${here?.textContent.replace(/^\d /, "") ?? "haptid"} – haptid workbench`;
  try {
    const page = await import(`./pages/${name || "home"}.js`);
    await page.show(main, new URLSearchParams(location.search));
  } catch (error) {
    if (!main.querySelector("h1")) el("h1", {}, main, here?.textContent.replace(/^\d /, "") ?? "haptid");
    complain(main, error);
  }
  document.body.dataset.ready = "";
}

begin();
