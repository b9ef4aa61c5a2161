/** The design tokens of style.css as a canvas needs them: read once a theme, not once a line. */
import { token as readToken } from "./theme.js";

/** @type {Map<string, string>} */
const read = new Map();
let generation = 0;

/** The value of a token. @param {string} name For example "--accent". */
export function token(name) {
  let value = read.get(name);
  if (value === undefined) {
    value = readToken(name);
    read.set(name, value);
  }
  return value;
}

/** Grows with each change of theme: what was drawn with a smaller one has old colours. */
export const tokenGeneration = () => generation;

document.addEventListener("themechange", () => {
  read.clear();
  generation += 1;
});
