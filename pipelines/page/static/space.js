/** The operator's seat. */
import "./camera_panel.js";
import "./loudspeaker_panel.js";
import "./microphone_panel.js";
import "./picture_view.js";
import "./status_tiles.js";
import { startSeat } from "./seat.js";

startSeat();
