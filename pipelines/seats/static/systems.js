/** The systems operator's page: contacts, processes, files in transfer, and the software of both ends. */
import "./alarm_list.js";
import "./chat_panel.js";
import "./command_log.js";
import "./contact_band.js";
import "./event_list.js";
import "./figure_table.js";
import "./link_octets.js";
import "./link_table.js";
import "./milestone_list.js";
import "./page_links.js";
import "./pass_list.js";
import "./process_control.js";
import "./process_grid.js";
import "./radio_banner.js";
import "./record_control.js";
import "./relay_table.js";
import "./report_log.js";
import "./software_table.js";
import "./status_tiles.js";
import "./stop_control.js";
import "./tab_group.js";
import "./transfer_table.js";
import "./upkeep_panel.js";
import { startSeat } from "./seat.js";

startSeat();
