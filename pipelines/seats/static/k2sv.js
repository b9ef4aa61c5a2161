/** The supervisor's page: the state of every system, and what the systems operator looks after. */
import "./alarm_list.js";
import "./chat_panel.js";
import "./command_log.js";
import "./contact_band.js";
import "./event_list.js";
import "./figure_table.js";
import "./link_octets.js";
import "./link_table.js";
import "./page_links.js";
import "./parameter_table.js";
import "./pass_list.js";
import "./process_grid.js";
import "./radio_banner.js";
import "./record_control.js";
import "./relay_table.js";
import "./report_log.js";
import "./session_control.js";
import "./status_tiles.js";
import "./stop_control.js";
import "./systems_panel.js";
import "./tab_group.js";
import "./telecommand_panel.js";
import { startSeat } from "./seat.js";

startSeat();
