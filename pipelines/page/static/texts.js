/**
 * The types of the JSON texts that a seat's server and its page exchange.
 *
 * Written by .ci/web/texts.py: change what the server packs, not this file. `_us`: the session's
 * monotonic clock. `_m`: metres of the workspace.
 */

/** @typedef {number | string | boolean | null} Figure */

/** @typedef {"good" | "warn" | "bad" | "none"} Level */

/** @typedef {"call" | "ping" | "report" | "housekeeping_on" | "housekeeping_off"} Verb */

/**
 * A stream that a page is sent.
 * @typedef {object} StreamText
 * @property {number} index
 * @property {string} name
 * @property {"video" | "voice"} kind
 * @property {"coded" | "sent" | "sound"} via
 * @property {number} cap_bps
 * @property {number} stale_after_ms
 * @property {number} [width]
 * @property {number} [height]
 * @property {number} [fps]
 */

/**
 * A camera that can be selected.
 * @typedef {object} CameraText
 * @property {string} name
 * @property {string[]} inputs
 */

/**
 * The small pictures of an input.
 * @typedef {object} PreviewText
 * @property {number} index
 * @property {string} input
 * @property {number} width
 * @property {number} height
 */

/**
 * An input that a page's own camera or microphone can take over.
 * @typedef {object} InputText
 * @property {number} index
 * @property {string} name
 * @property {"video" | "audio"} kind
 * @property {number} [width]
 * @property {number} [height]
 * @property {number} [fps]
 */

/**
 * The workspace of the joystick, from its middle.
 * @typedef {object} WorkspaceText
 * @property {number} half_width_m
 * @property {number} half_height_m
 */

/**
 * The robot's task board; its middle is (0, 0). lights_m: of the LED panel, with tasks.
 * @typedef {object} BoardText
 * @property {number} width_m
 * @property {number} height_m
 * @property {number} wall_x_m
 * @property {[number, number][]} leds_m
 * @property {[number, number][]} lights_m
 */

/**
 * A parameter, and from where on it is coloured.
 * @typedef {object} ParameterText
 * @property {string} name
 * @property {string} unit
 * @property {string} text
 * @property {number | null} low
 * @property {number | null} high
 */

/**
 * A housekeeping report. on: from the start.
 * @typedef {object} StructureText
 * @property {string} name
 * @property {string[]} parameters
 * @property {number} interval_s
 * @property {boolean} on
 */

/**
 * A function that a telecommand starts.
 * @typedef {object} FunctionText
 * @property {string} name
 * @property {string[]} arguments
 * @property {string} text
 */

/**
 * An application of the dictionary.
 * @typedef {object} ApplicationText
 * @property {string} name
 * @property {string} end
 * @property {string} text
 * @property {ParameterText[]} parameters
 * @property {StructureText[]} structures
 * @property {FunctionText[]} functions
 */

/**
 * A pass ahead. `_s`: from the acquisition of this session's own pass.
 * @typedef {object} PassText
 * @property {string} acquisition
 * @property {number} acquisition_s
 * @property {number} loss_s
 * @property {number} peak_deg
 */

/**
 * A task that can be selected. text: for the cosmonaut.
 * @typedef {object} TaskText
 * @property {string} name
 * @property {string} text
 */

/**
 * The first text of a connection. page: its number.
 * @typedef {object} HelloText
 * @property {"hello"} kind
 * @property {"ground" | "space"} seat
 * @property {string} setup
 * @property {string} session
 * @property {StreamText[]} streams
 * @property {CameraText[]} cameras
 * @property {PreviewText[]} previews
 * @property {InputText[]} inputs
 * @property {string} joystick
 * @property {WorkspaceText} workspace
 * @property {BoardText} board
 * @property {Record<string, number>} caps
 * @property {ApplicationText[]} applications
 * @property {PassText[]} passes
 * @property {boolean} tasks
 * @property {TaskText[]} task_list
 * @property {"operator" | "cosmonaut" | "experimenter" | "supervisor" | "systems" | "viewer"} role
 * @property {number} page
 * @property {number} now_us
 */

/**
 * The joystick's state in words.
 * @typedef {object} JoystickText
 * @property {string} state
 * @property {string} reason
 * @property {boolean} dead_man
 * @property {number} force_limit_n
 * @property {string} device
 */

/**
 * Who holds the handle, and who asks for it, by numbers of pages.
 * @typedef {object} HandText
 * @property {number | null} holder
 * @property {boolean} you
 * @property {number | null} wanted_by
 */

/**
 * The heartbeat, 10 times a second, and at each change.
 * @typedef {object} StateText
 * @property {"state"} kind
 * @property {number} now_us
 * @property {"connected" | "lost"} link
 * @property {boolean} signal
 * @property {string | null} camera
 * @property {JoystickText | null} joystick
 * @property {HandText} hand
 * @property {Record<string, number | null>} inputs
 */

/**
 * A direction of the link, counted since the session began. octets: by what they carried. drops:
 * packets, by level. lost: frames.
 * @typedef {object} LinkCounts
 * @property {Record<string, number>} octets
 * @property {Record<string, number>} drops
 * @property {number} lost
 * @property {number} slips
 */

/**
 * A process. cpu: share of a core over the last 2 s; None: not known yet.
 * @typedef {object} ProcessText
 * @property {string} name
 * @property {string | null} segment
 * @property {number | null} cpu
 * @property {number} restarts
 * @property {boolean} running
 * @property {string} error
 */

/**
 * One event. number: from 1 on. at_us: on the session's clock. what: `link`, `process`, `camera`,
 * `stale`, `joystick`, `input` or `session`.
 * @typedef {object} EventText
 * @property {number} number
 * @property {number} at_us
 * @property {string} what
 * @property {string} text
 */

/**
 * What a page gets twice a second. at_us: on the session's clock. seconds: since the session
 * began.
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
 * The answer to a request of this number. error: "" if it was carried out.
 * @typedef {object} AnswerText
 * @property {"answer"} kind
 * @property {number} request
 * @property {boolean} ok
 * @property {string} error
 * @property {number} [round_trip_ms]
 */

/**
 * A line of the chat. state: `waiting`, `delivered`, `refused`; `received` from the others.
 * @typedef {object} ChatLine
 * @property {number} number
 * @property {number} at_us
 * @property {string} sender
 * @property {string} text
 * @property {string} state
 * @property {string} [reason]
 * @property {number} [round_trip_ms]
 */

/**
 * The whole chat, as far as it is kept.
 * @typedef {object} ChatText
 * @property {"chat"} kind
 * @property {ChatLine[]} lines
 */

/**
 * A telecommand of this seat. stage, done, ok, verified: as in `CommandUpdate`.
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

/**
 * The telecommands of this seat.
 * @typedef {object} CommandsText
 * @property {"commands"} kind
 * @property {CommandLine[]} commands
 */

/**
 * A parameter's newest value. value: None if it is no number. at_us: when it was heard.
 * @typedef {object} ValueText
 * @property {string} application
 * @property {string} name
 * @property {Figure} value
 * @property {Level} level
 * @property {number} at_us
 */

/**
 * All parameters that were reported.
 * @typedef {object} ValuesText
 * @property {"values"} kind
 * @property {ValueText[]} values
 */

/**
 * An event of an application of either end.
 * @typedef {object} EventLine
 * @property {number} number
 * @property {number} at_us
 * @property {string} application
 * @property {string} name
 * @property {string} severity
 * @property {Record<string, Figure>} values
 */

/**
 * The newest events.
 * @typedef {object} EventsText
 * @property {"events"} kind
 * @property {EventLine[]} events
 */

/**
 * Whether both directions carry, in words.
 * @typedef {object} RadioText
 * @property {"radio"} kind
 * @property {Level} level
 * @property {string} words
 */

/**
 * The panel, as `telepresence.tasks.panel.PanelView` has it; handle_m: where the handle is.
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
 * A task that can be selected.
 * @typedef {object} TaskListed
 * @property {string} name
 * @property {string} text
 */

/**
 * A step of a run, at an instant of the session's clock.
 * @typedef {object} StepShown
 * @property {number} at_ns
 * @property {number} run
 * @property {string} task
 * @property {string} step
 */

/**
 * A run that is over. seconds: from its start; None if it never started.
 * @typedef {object} RunShown
 * @property {string} task
 * @property {number} run
 * @property {string} result
 * @property {string} reason
 * @property {number | null} seconds
 */

/**
 * The experiment: its phase, the present task ("" without), Elemop, and what the panel shows.
 * tasks: in the catalogue's order, by whose index telecommands name them. steps: the newest ones.
 * runs: the newest ones. planned: a plan selects the tasks.
 * @typedef {object} ExperimentText
 * @property {"experiment"} kind
 * @property {string} phase
 * @property {string} task
 * @property {number} run
 * @property {string} elemop
 * @property {string} panel
 * @property {TaskListed[]} tasks
 * @property {StepShown[]} steps
 * @property {RunShown[]} runs
 * @property {boolean} planned
 */

/**
 * The robot controller. life: of its process. handled: number of the newest order. x_m, y_m: of
 * the tip. push_n: the board's force. goal_m: where it rests after a move. fault: one line, "" for
 * none. error: its kind, a `telepresence.tasks.robot_control.Fault`. halted: the newest sample of
 * the joystick says that it is. commanded: number of the newest `RobotCommand`; None for none.
 * command_refusal: why that was refused, "" if it was carried out. step_hz: cycles of the
 * controller, in the last second.
 * @typedef {object} RobotText
 * @property {"robot"} kind
 * @property {number} life
 * @property {boolean} powered
 * @property {"position" | "torque" | "telepresence" | "impedance"} mode
 * @property {number} x_m
 * @property {number} y_m
 * @property {number} push_n
 * @property {[number, number] | null} goal_m
 * @property {string} fault
 * @property {number} faults
 * @property {number} refused
 * @property {number} handled
 * @property {boolean} halted
 * @property {string} error
 * @property {number | null} commanded
 * @property {string} command_refusal
 * @property {number} step_hz
 */

/** @typedef {HelloText
 *   | StateText
 *   | FiguresText
 *   | AnswerText
 *   | ChatText
 *   | CommandsText
 *   | ValuesText
 *   | EventsText
 *   | RadioText
 *   | PanelText
 *   | ExperimentText
 *   | RobotText} ServerText */

/**
 * What a page may ask for.
 * @typedef {{do: "select", camera: string}
 *   | {do: "joystick", event: "calibrate" | "start" | "halt" | "acknowledge" | "stop" | "resume"}
 *   | {do: "hand", action: "take" | "give" | "ask" | "refuse"}
 *   | {do: "session", action: "start" | "stop"}
 *   | {do: "record", action: "start" | "stop"}
 *   | {do: "command", application: string, verb?: Verb, name?: string, arguments?: (boolean | number | string)[]}
 *   | {do: "chat", text: string}
 *   | {do: "input", name: string, on: boolean}} Request
 */

export {};
