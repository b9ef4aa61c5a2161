/**
 * The types of the JSON texts that a seat's server and its page exchange.
 *
 * Names are those on the wire. `_us`: the session's monotonic clock. `_m`: metres of the workspace.
 */

/**
 * A stream that the page is sent. `via`: as it was decoded, as it was sent, or sound.
 * @typedef {object} StreamText
 * @property {number} index
 * @property {string} name
 * @property {"video" | "voice"} kind
 * @property {"coded" | "sent" | "sound"} via
 * @property {number} [width]
 * @property {number} [height]
 * @property {number} [fps]
 * @property {number} [cap_bps]
 * @property {number} [stale_after_ms]
 */

/**
 * @typedef {object} CameraText
 * @property {string} name
 * @property {string[]} inputs
 */

/**
 * @typedef {object} PreviewText
 * @property {number} index
 * @property {string} input
 * @property {number} width
 * @property {number} height
 */

/**
 * An input that the seat's own camera or microphone can take over.
 * @typedef {object} InputText
 * @property {number} index
 * @property {string} name
 * @property {"video" | "audio"} kind
 * @property {number} [width]
 * @property {number} [height]
 * @property {number} [fps]
 */

/**
 * @typedef {object} BoardText
 * @property {number} width_m
 * @property {number} height_m
 * @property {number} wall_x_m
 * @property {[number, number][]} leds_m
 */

/**
 * The first text of a connection.
 * @typedef {object} HelloText
 * @property {"hello"} kind
 * @property {"space" | "ground"} seat
 * @property {"operator" | "viewer"} role
 * @property {number} page
 * @property {number} now_us
 * @property {string} setup
 * @property {string} session
 * @property {StreamText[]} streams
 * @property {CameraText[]} cameras
 * @property {PreviewText[]} [previews]
 * @property {InputText[]} inputs
 * @property {string} joystick
 * @property {{half_width_m: number, half_height_m: number}} workspace
 * @property {BoardText} board
 * @property {Record<string, unknown>} [caps]
 */

/**
 * @typedef {object} JoystickText
 * @property {string} state
 * @property {string} reason
 * @property {boolean} dead_man
 * @property {number} force_limit_n
 * @property {string} [device]
 */

/**
 * Sent ten times a second; it is also the heartbeat.
 * @typedef {object} StateText
 * @property {"state"} kind
 * @property {number} now_us
 * @property {"connected" | "lost"} link
 * @property {boolean} signal
 * @property {string | null} camera
 * @property {JoystickText | null} joystick
 * @property {{holder: number | null, you: boolean, wanted_by: number | null}} hand
 * @property {Record<string, number | null>} inputs
 */

/** @typedef {number | string | boolean | null} Figure */

/**
 * @typedef {object} LinkCounts
 * @property {Record<string, number>} octets By what they carried, since the start.
 * @property {Record<string, number>} drops Packets, by level.
 * @property {number} lost
 * @property {number} slips
 */

/**
 * @typedef {object} ProcessText
 * @property {string} name
 * @property {string | null} segment
 * @property {number | null} cpu Share of a core over the last 2 s.
 * @property {number} restarts
 * @property {boolean} running
 * @property {string | null} error
 */

/**
 * @typedef {object} EventText
 * @property {number} number
 * @property {number} at_us
 * @property {string} what
 * @property {string} text
 */

/**
 * Sent every 500 ms.
 * @typedef {object} FiguresText
 * @property {"figures"} kind
 * @property {number} at_us
 * @property {number} seconds
 * @property {"running" | "stopped"} state
 * @property {Record<string, Figure>} figures
 * @property {Record<string, LinkCounts>} link
 * @property {ProcessText[]} processes
 * @property {EventText[]} events
 */

/**
 * The answer to the request of this number.
 * @typedef {object} AnswerText
 * @property {"answer"} kind
 * @property {number} request
 * @property {boolean} ok
 * @property {string} error
 * @property {number} [round_trip_ms]
 */

/** @typedef {HelloText | StateText | FiguresText | AnswerText} ServerText */

/**
 * What a page may ask for.
 * @typedef {{do: "select", camera: string}
 *   | {do: "joystick", event: "calibrate" | "start" | "halt" | "acknowledge" | "stop" | "resume"}
 *   | {do: "hand", action: "take" | "give" | "ask" | "refuse"}
 *   | {do: "session", action: "start" | "stop"}
 *   | {do: "record", action: "start" | "stop"}
 *   | {do: "input", name: string, on: boolean}} Request
 */

export {};
