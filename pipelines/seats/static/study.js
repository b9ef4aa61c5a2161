/**
 * The page of a study: it says what to do, and its field moves the handle by mouse, finger or keys.
 *
 * @import { StudyFrame, StudyShown } from "./texts.js"
 */
import { make, one, setText } from "./dom.js";
import { HandControl } from "./hand_control.js";
import { steerByKeys } from "./key_hand.js";
import { Keyboard, keepFocusOnClick } from "./keyboard.js";
import { steerByPointer } from "./pointer_hand.js";
import { StudyField } from "./study_field.js";
import { StudyLink } from "./study_link.js";
import { startTheme } from "./theme.js";

const link = new StudyLink();
const field = new StudyField();
const control = new HandControl(link);
const surface = one("#field", HTMLElement);
const hint = one("#hint", HTMLElement);
const [go, other] = [one("#go", HTMLButtonElement), one("#other", HTMLButtonElement)];
/** @type {StudyShown | null} */
let shown = null;
/** Until when the main button waits. */
let untilMs = 0;

/** @param {string} words */
function warn(words) {
  setText(hint, words);
  hint.hidden = words === "";
}

/** Enables the main button once it may be pressed, and says how long that is. */
function showButtons() {
  if (shown === null) return;
  const seconds = Math.ceil((untilMs - performance.now()) / 1000);
  go.hidden = shown.main === "";
  go.disabled = seconds > 0;
  setText(go, seconds > 0 ? `${shown.main} in ${seconds} s` : shown.main);
  other.hidden = shown.other === "";
  setText(other, shown.other);
  if (seconds > 0) setTimeout(showButtons, 250);
}

link.on("shown", (/** @type {StudyShown} */ screen) => {
  shown = screen;
  untilMs = performance.now() + 1000 * screen.wait_s;
  document.body.dataset.server = "heard";
  document.body.dataset.phase = screen.phase;
  setText(one("#title", HTMLElement), screen.title);
  one("#words", HTMLElement).replaceChildren(...screen.words.map((words) => make("p", {}, words)));
  setText(one("#trial", HTMLElement), `${screen.trial} of ${screen.trials} trials`);
  one("#through", HTMLProgressElement).value = screen.trial / screen.trials;
  surface.toggleAttribute("data-idle", screen.phase !== "start" && screen.phase !== "trial");
  warn("");
  field.fit(screen);
  showButtons();
});
link.on("frame", (/** @type {StudyFrame} */ frame) => field.show(frame));
link.on("lost", (/** @type {string} */ why) => {
  document.body.dataset.server = "lost";
  warn(why);
  go.disabled = true;
});
control.addEventListener("change", () => {
  if (control.refusal !== "") warn(control.refusal);
});
go.addEventListener("click", () => {
  if (shown !== null) link.press(shown.screen, false);
});
other.addEventListener("click", () => {
  if (shown !== null) link.press(shown.screen, true);
});

const keyboard = new Keyboard();
surface.append(field.canvas);
steerByPointer(surface, control, () => field.halfPixels());
steerByKeys(keyboard, control, () => ({ x: shown?.half_width_m ?? 1, y: shown?.half_height_m ?? 1 }));
keyboard.showIn(one("#keys", HTMLDialogElement), one("#show-keys", HTMLButtonElement));
startTheme();
keepFocusOnClick();
link.open();
