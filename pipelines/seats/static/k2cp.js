/** The control program on the crew's laptop: joystick, systems, session and chat. */
import "./chat_panel.js";
import "./command_log.js";
import "./contact_panel.js";
import "./joystick_panel.js";
import "./page_links.js";
import "./parameter_table.js";
import "./radio_banner.js";
import "./report_log.js";
import "./session_control.js";
import "./status_tiles.js";
import "./stop_control.js";
import "./systems_panel.js";
import { startSeat } from "./seat.js";

startSeat();
