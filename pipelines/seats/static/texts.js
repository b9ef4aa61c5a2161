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
 * @property {[number, number][]} [lights_m] The LED panel's, in a session with tasks.
 */

/**
 * The first text of a connection.
 * @typedef {object} HelloText
 * @property {"hello"} kind
 * @property {"space" | "ground"} seat
 * @property {"operator" | "cosmonaut" | "experimenter" | "supervisor" | "systems" | "viewer"} role
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
 * @property {ApplicationText[]} applications
 * @property {PassText[]} passes
 * @property {boolean} tasks Whether the session has any.
 * @property {{name: string, text: string}[]} task_list In space: those that can be selected.
 */

/**
 * A parameter of telemetry. `low`, `high`: limits, null without.
 * @typedef {object} ParameterText
 * @property {string} name
 * @property {string} unit
 * @property {string} text
 * @property {number | null} low
 * @property {number | null} high
 */

/** @typedef {{name: string, parameters: string[], interval_s: number, on: boolean}} StructureText */
/** @typedef {{name: string, arguments: string[], text: string}} FunctionText */

/**
 * An application of telecommands and telemetry.
 * @typedef {object} ApplicationText
 * @property {string} name
 * @property {"space" | "ground"} end
 * @property {string} text
 * @property {ParameterText[]} parameters
 * @property {StructureText[]} structures
 * @property {FunctionText[]} functions
 */

/**
 * A pass ahead; `_s` from the acquisition of this session's own.
 * @typedef {{acquisition: string, acquisition_s: number, loss_s: number, peak_deg: number}} PassText
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

/**
 * A line of the chat. `state`: waiting, delivered or refused; received from the other end.
 * @typedef {object} ChatLine
 * @property {number} number
 * @property {number} at_us
 * @property {string} sender
 * @property {string} text
 * @property {"waiting" | "delivered" | "refused" | "received"} state
 * @property {string} [reason]
 * @property {number} [round_trip_ms]
 */

/** @typedef {{kind: "chat", lines: ChatLine[]}} ChatText The whole chat. */

/**
 * A telecommand of this seat, and what became of it.
 * @typedef {object} CommandLine
 * @property {number} number
 * @property {number} at_us
 * @property {string} who
 * @property {string} words
 * @property {string} stage
 * @property {boolean} [done]
 * @property {boolean} [ok]
 * @property {boolean} [verified]
 * @property {string} [reason]
 * @property {number} [round_trip_ms]
 * @property {number} [tries]
 */

/** @typedef {{kind: "commands", commands: CommandLine[]}} CommandsText */

/** @typedef {"good" | "warn" | "bad" | "none"} Level */

/**
 * @typedef {object} ValueText
 * @property {string} application
 * @property {string} name
 * @property {Figure} value
 * @property {Level} level The colour of its limit.
 * @property {number} at_us When it was heard here.
 */

/** @typedef {{kind: "values", values: ValueText[]}} ValuesText */

/**
 * @typedef {object} EventLine
 * @property {number} number
 * @property {number} at_us
 * @property {string} application
 * @property {string} name
 * @property {"info" | "low" | "medium" | "high"} severity
 * @property {Record<string, Figure>} values
 */

/** @typedef {{kind: "events", events: EventLine[]}} EventsText */

/** @typedef {{kind: "radio", level: Level, words: string}} RadioText */

/**
 * What the mission control panel shows; `_m` of the workspace.
 * @typedef {object} PanelText
 * @property {"panel"} kind
 * @property {string} mode
 * @property {string} task
 * @property {number} run
 * @property {string} text
 * @property {string} words
 * @property {[number, number]} start_m
 * @property {number} distance_m
 * @property {number} held_s
 * @property {[number, number]} handle_m
 * @property {boolean} dead_man
 */

/**
 * Where the experiment is: Elemop, state of the panel, newest steps, newest runs.
 * @typedef {object} ExperimentText
 * @property {"experiment"} kind
 * @property {string} phase
 * @property {string} task
 * @property {number} run
 * @property {string} elemop
 * @property {string} panel
 * @property {string} [reason]
 * @property {{name: string, text: string}[]} tasks
 * @property {{at_ns: number, run: number, task: string, step: string}[]} steps
 * @property {{task: string, run: number, result: string, reason: string, seconds: number | null}[]} runs
 * @property {boolean} planned A plan selects the tasks.
 */

/**
 * @typedef {object} RobotText
 * @property {"robot"} kind
 * @property {boolean} powered
 * @property {string} mode
 * @property {number} x_m
 * @property {number} y_m
 * @property {number} push_n
 * @property {[number, number] | null} goal_m
 * @property {string} fault
 * @property {number} faults
 * @property {number} refused
 * @property {number} handled
 * @property {boolean} halted
 * @property {number} [step_hz]
 */

/**
 * @typedef {HelloText | StateText | FiguresText | AnswerText | ChatText | CommandsText | ValuesText
 *   | EventsText | RadioText | PanelText | ExperimentText | RobotText} ServerText
 */

/**
 * What a page may ask for.
 * @typedef {{do: "joystick", event: "calibrate" | "start" | "halt" | "acknowledge" | "stop" | "resume"}
 *   | {do: "hand", action: "take" | "give" | "ask" | "refuse"}
 *   | {do: "session", action: "start" | "stop"}
 *   | {do: "record", action: "start" | "stop"}
 *   | {do: "input", name: string, on: boolean}
 *   | {do: "chat", text: string}
 *   | {do: "command", application: string, verb?: Verb, name?: string, arguments?: Figure[]}} Request
 */

/**
 * What a telecommand asks for: a function, a sign of life, a report.
 * @typedef {"call" | "ping" | "report" | "housekeeping_on" | "housekeeping_off"} Verb
 */

export {};
