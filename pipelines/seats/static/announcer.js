/** Says what changed to people who use a screen reader, politely and never twice in a row. */

/** @type {HTMLElement | null} */
let region = null;

/** @param {string} text */
export function announce(text) {
  if (region === null) {
    region = document.createElement("div");
    region.className = "only-spoken";
    region.setAttribute("role", "status");
    region.setAttribute("aria-live", "polite");
    document.body.append(region);
  }
  if (region.textContent !== text) region.textContent = text;
}
