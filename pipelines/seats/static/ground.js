/** Ground control. */
import "./camera_panel.js";
import "./contact_band.js";
import "./event_list.js";
import "./figure_table.js";
import "./focus_frame.js";
import "./haptic_charts.js";
import "./link_octets.js";
import "./link_table.js";
import "./loudspeaker_panel.js";
import "./microphone_panel.js";
import "./page_links.js";
import "./partner_panel.js";
import "./picture_view.js";
import "./preview_strip.js";
import "./process_grid.js";
import "./record_control.js";
import "./robot_map.js";
import "./session_control.js";
import "./status_tiles.js";
import "./stop_control.js";
import "./stream_table.js";
import "./tab_group.js";
import { startSeat } from "./seat.js";

startSeat();
