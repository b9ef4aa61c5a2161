/** The operator's seat. */
import "./board_overlay.js";
import "./camera_buttons.js";
import "./camera_panel.js";
import "./contact_panel.js";
import "./focus_frame.js";
import "./force_dial.js";
import "./hand_panel.js";
import "./headset_seat.js";
import "./joystick_panel.js";
import "./loudspeaker_panel.js";
import "./microphone_panel.js";
import "./page_links.js";
import "./panel_status.js";
import "./picture_view.js";
import "./senses_panel.js";
import "./status_tiles.js";
import "./stop_control.js";
import "./task_widget.js";
import { startSeat } from "./seat.js";

startSeat();
