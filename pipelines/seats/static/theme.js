/**
 * Dark or light: the system's choice, until the button `#theme` is pressed.
 *
 * The choice is kept for this tab only: the address of a session changes with each start.
 */
const KEY = "theme";

/** @returns {"dark" | "light"} */
export function theme() {
  const chosen = document.documentElement.dataset.theme;
  if (chosen === "dark" || chosen === "light") return chosen;
  return matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
}

/** Changes to the other theme; canvases follow the event `themechange` of the document. */
export function toggleTheme() {
  const next = theme() === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = next;
  sessionStorage.setItem(KEY, next);
  tell();
}

/** @type {HTMLElement | null} */
let probe = null;

/** The colour of a design token in this theme, for canvases. @param {string} name As "--accent". */
export function colour(name) {
  if (probe === null) {
    probe = document.createElement("span");
    probe.hidden = true;
    document.body.append(probe);
  }
  probe.style.color = `var(${name})`;
  return getComputedStyle(probe).color;
}

function tell() {
  document.dispatchEvent(new CustomEvent("themechange"));
}

/** Call once when the page has been parsed. */
export function startTheme() {
  const kept = sessionStorage.getItem(KEY);
  if (kept !== null) document.documentElement.dataset.theme = kept;
  document.querySelector("#theme")?.addEventListener("click", toggleTheme);
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", tell);
  tell();
}
