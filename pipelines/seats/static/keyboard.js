/**
 * The page's keyboard shortcuts: one table, which the dialog behind "?" shows.
 *
 * A shortcut never acts while a person types, while Ctrl, Alt or Meta is held, or while a dialog
 * is open. Space and Enter belong to the control that has the focus.
 */

/**
 * keys: values of `KeyboardEvent.code` (a place on the keyboard, for what is held) or of
 * `KeyboardEvent.key` (a letter or sign). shown: what the table shows; `keys` without it.
 * down: at the press, not at its repeats; it is given the key. up: at the release, and when the
 * page loses the focus.
 * @typedef {object} Shortcut
 * @property {string[]} keys
 * @property {string} [shown]
 * @property {string} what
 * @property {(key: string) => void} [down]
 * @property {() => void} [up]
 */

const CONTROLS = "a, button, input, select, summary, textarea, [contenteditable]";
const TYPING = 'input:not([type="range"], [type="checkbox"]), select, textarea, [contenteditable]';

export class Keyboard {
  /** @type {Shortcut[]} */
  #shortcuts = [];
  /** By code: what is held. @type {Map<string, Shortcut>} */
  #held = new Map();

  constructor() {
    addEventListener("keydown", (event) => this.#handleDown(event));
    addEventListener("keyup", (event) => this.#handleUp(event.code));
    addEventListener("blur", () => this.#releaseAll());
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.#releaseAll();
    });
  }

  /** @param {Shortcut[]} shortcuts */
  add(...shortcuts) {
    this.#shortcuts.push(...shortcuts);
  }

  /** Fills the dialog and lets "?" and the button open it. @param {HTMLDialogElement} dialog @param {HTMLElement} button */
  showIn(dialog, button) {
    const show = () => {
      const table = document.createElement("table");
      const body = table.createTBody();
      for (const { keys, shown, what } of this.#shortcuts) {
        const row = body.insertRow();
        const head = document.createElement("th");
        head.scope = "row";
        for (const key of (shown ?? keys.join(" ")).split(" ")) {
          const cap = document.createElement("kbd");
          cap.textContent = key.length === 1 ? key.toUpperCase() : key;
          head.append(cap, " ");
        }
        row.append(head);
        row.insertCell().textContent = what;
      }
      dialog.querySelector("table")?.remove();
      dialog.querySelector("h2")?.after(table);
      this.#releaseAll();
      dialog.showModal();
    };
    button.addEventListener("click", show);
    this.add({ keys: ["?"], what: "show these keys", down: show });
  }

  /** @param {KeyboardEvent} event */
  #handleDown(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (document.querySelector("dialog[open]") !== null) return;
    const target = event.target instanceof Element ? event.target : document.body;
    if (target.closest(TYPING) !== null) return;
    const own = event.key === " " || event.key === "Enter";
    if (own && target.closest(CONTROLS) !== null) return;
    if (event.key.startsWith("Arrow") && target.closest('input[type="range"]') !== null) return;
    const shortcut = this.#shortcuts.find(
      ({ keys }) => keys.includes(event.code) || keys.includes(event.key.toLowerCase()),
    );
    if (shortcut === undefined) return;
    event.preventDefault();
    if (event.repeat || this.#held.has(event.code)) return;
    if (shortcut.up !== undefined) this.#held.set(event.code, shortcut);
    shortcut.down?.(event.key);
  }

  /** @param {string} code */
  #handleUp(code) {
    const shortcut = this.#held.get(code);
    this.#held.delete(code);
    shortcut?.up?.();
  }

  #releaseAll() {
    for (const code of [...this.#held.keys()]) this.#handleUp(code);
  }
}

/** A pointer's click leaves the focus where it was, so that Space stays the hand's. */
export function keepFocusOnClick() {
  addEventListener("mousedown", (event) => {
    if (event.target instanceof Element && event.target.closest("button") !== null) {
      event.preventDefault();
    }
  });
}
