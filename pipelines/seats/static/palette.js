/** The colours of style.css for canvases that draw often: read once a theme, not once a line. */
import { colour } from "./theme.js";

/** @type {Map<string, string>} */
const read = new Map();
let themes = 0;

/** The colour of a design token. @param {string} name For example "--accent". */
export function paint(name) {
  let value = read.get(name);
  if (value === undefined) {
    value = colour(name);
    read.set(name, value);
  }
  return value;
}

/** Grows with each change of theme: what was drawn with a smaller one has old colours. */
export const themeNumber = () => themes;

document.addEventListener("themechange", () => {
  read.clear();
  themes += 1;
});
