/**
 * What every part of a page follows: the connection, the figures and the keys.
 *
 * A part is a custom element with a method `follow(seat)`.
 */
import { announce } from "./announcer.js";
import { Connection } from "./connection.js";
import { one } from "./dom.js";
import { FigureBinding } from "./figure_binding.js";
import { Keyboard, keepFocusOnClick } from "./keyboard.js";
import { startTheme, toggleTheme } from "./theme.js";
import { TipPrediction } from "./tip_prediction.js";

export class Seat {
  connection = new Connection();
  figures = new FigureBinding();
  keyboard = new Keyboard();
  /** Where the hand leads the robot's tip: `<board-overlay>` finds it. */
  prediction = new TipPrediction();
}

/** Starts the page: call it once all elements are defined. */
export function startSeat() {
  startTheme();
  keepFocusOnClick();
  const seat = new Seat();
  seat.figures.follow(seat.connection);
  for (const element of document.querySelectorAll("*")) {
    if ("follow" in element && typeof element.follow === "function") element.follow(seat);
  }
  // Elements may have made others that show figures.
  seat.figures.refresh();
  seat.keyboard.add({ keys: ["l"], what: "light or dark", down: toggleTheme });
  seat.keyboard.showIn(one("#keys", HTMLDialogElement), one("#show-keys", HTMLButtonElement));
  markLink(seat.connection);
  return seat;
}

/**
 * Keeps `body[data-link]`, lost also while the server is not heard, and `body[data-server]`, heard
 * or lost: without a server, all that the page shows is old.
 * @param {Connection} connection
 */
function markLink(connection) {
  const mark = () => {
    const { alive, state } = connection;
    const server = alive ? "heard" : "lost";
    if (document.body.dataset.server !== server) document.body.dataset.server = server;
    const link = alive && state !== null ? state.link : "lost";
    if (document.body.dataset.link === link) return;
    document.body.dataset.link = link;
    announce(link === "connected" ? "The link is connected." : "The link is lost.");
  };
  connection.on("state", mark);
  connection.on("heard", mark);
  connection.on("lost", mark);
}
