/** The experimenter's page: tasks from selection to end, their steps, and the robot. */
import "./chat_panel.js";
import "./command_log.js";
import "./experiment_panel.js";
import "./page_links.js";
import "./radio_banner.js";
import "./record_control.js";
import "./robot_panel.js";
import "./run_table.js";
import "./status_tiles.js";
import "./step_list.js";
import "./stop_control.js";
import { startSeat } from "./seat.js";

startSeat();
