/** The trainer's page: faults to practise with, and what comes of them. */
import "./event_list.js";
import "./exercise_panel.js";
import "./page_links.js";
import "./radio_banner.js";
import "./status_tiles.js";
import "./systems_panel.js";
import { startSeat } from "./seat.js";

startSeat();
