/** The mission control panel: what the cosmonaut has to do, the picture, and the handle. */
import "./board_overlay.js";
import "./focus_frame.js";
import "./force_dial.js";
import "./hand_panel.js";
import "./page_links.js";
import "./panel_status.js";
import "./panel_tasks.js";
import "./panel_text.js";
import "./picture_view.js";
import "./status_tiles.js";
import "./stop_control.js";
import "./task_widget.js";
import { startSeat } from "./seat.js";

startSeat();
