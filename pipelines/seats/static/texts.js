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
 * @typedef {{index: number, name: string, kind: "video" | "voice", via: "coded" | "sent" |
 *   "sound", cap_bps: number, stale_after_ms: number, width?: number, height?: number, fps?:
 *   number}} StreamText
 */

/**
 * A camera that can be selected. layout: of one that is composed of two; else "".
 * @typedef {{name: string, inputs: string[], layout: string}} CameraText
 */

/**
 * The small pictures of an input.
 * @typedef {{index: number, input: string, width: number, height: number}} PreviewText
 */

/**
 * An input that a page's own camera or microphone can take over.
 * @typedef {{index: number, name: string, kind: "video" | "audio", width?: number, height?:
 *   number, fps?: number}} InputText
 */

/**
 * The workspace of the joystick, from its middle.
 * @typedef {{half_width_m: number, half_height_m: number}} WorkspaceText
 */

/**
 * A chart of the pages. factor turns a value into `unit`; at least ±least of that is shown.
 * column: of the rows that a page gets.
 * @typedef {{title: string, unit: string, factor: number, least: number, column: number}}
 *   HapticChart
 */

/**
 * What stands in the robot's workspace: a place, or an obstacle with its half sizes.
 * @typedef {{name: string, x_m: number, y_m: number, half_width_m: number, half_height_m: number}}
 *   MarkText
 */

/**
 * The robot's workspace, with its middle at (0, 0), and the task board in it, if there is one.
 * wall_x_m: null without the board. marks: what the robot or the setup names. With tasks,
 * lights_m: of the LED panel; paths_m: by goal, the way that is to be followed; spring_m: where
 * the spring begins.
 * @typedef {{width_m: number, height_m: number, wall_x_m: number | null, marks: MarkText[],
 *   leds_m: [number, number][], lights_m: [number, number][], paths_m: Record<string, [number,
 *   number][]>, spring_m: [number, number]}} BoardText
 */

/**
 * A parameter, from where on it is coloured, and the texts that it may have.
 * @typedef {{name: string, unit: string, text: string, low: number | null, high: number | null,
 *   choices: string[]}} ParameterText
 */

/**
 * A housekeeping report. on: from the start.
 * @typedef {{name: string, parameters: string[], interval_s: number, on: boolean}} StructureText
 */

/**
 * A function that a telecommand starts.
 * @typedef {{name: string, arguments: string[], text: string}} FunctionText
 */

/**
 * An application of the dictionary.
 * @typedef {{name: string, end: string, text: string, parameters: ParameterText[], structures:
 *   StructureText[], functions: FunctionText[]}} ApplicationText
 */

/**
 * A pass ahead. `_s`: from the acquisition of this session's own pass.
 * @typedef {{acquisition: string, acquisition_s: number, loss_s: number, peak_deg: number}}
 *   PassText
 */

/**
 * A task. text: for the cosmonaut. lacks: why it cannot be done here; "" if it can.
 * @typedef {{name: string, text: string, lacks: string}} TaskText
 */

/**
 * An exercise that a trainer can give here. seconds: how long, by default. camera: or "".
 * @typedef {{name: string, text: string, seconds: number, camera: string}} ExerciseText
 */

/**
 * What moves an axis on a browser's standard gamepad: an axis, or two buttons, up and down. -1
 * stands for none.
 * @typedef {{name: string, axis: number, up: number, down: number, scale: number, dead_zone:
 *   number, rate: boolean}} PadAxis
 */

/**
 * The mapping of a browser's standard gamepad. dead_man: any of these buttons will do.
 * @typedef {{axes: PadAxis[], dead_man: number[], stop: number, hand_over: number, panel:
 *   number[]}} PadControls
 */

/**
 * The first text of a connection. page: its number. name: who sits there.
 * @typedef {{kind: "hello", seat: "ground" | "space", setup: string, session: string, streams:
 *   StreamText[], cameras: CameraText[], previews: PreviewText[], inputs: InputText[], joystick:
 *   string, workspace: WorkspaceText, charts: HapticChart[], board: BoardText, caps:
 *   Record<string, number>, applications: ApplicationText[], passes: PassText[], tasks: boolean,
 *   task_list: TaskText[], views: Record<string, number[]>, exercises: ExerciseText[], pad:
 *   PadControls | null, role: "operator" | "cosmonaut" | "experimenter" | "supervisor" | "systems"
 *   | "trainer" | "viewer", page: number, name: string, now_us: number}} HelloText
 */

/**
 * An axis of the joystick behind x and y: m and N, or rad and N m. unit: of the position.
 * @typedef {{name: string, position: number, half_range: number, force: number, force_limit:
 *   number, unit: string}} AxisText
 */

/**
 * The joystick's state in words. allowed: requests that it would take now. axes: those behind x
 * and y. request: which leads on; "": none does. test, test_reason: what became of the newest
 * functional test. experiment: of the present or the next application. partner: whether a
 * partner's robot is there; null: there can be none. command_age_ms: how old the commands are that
 * the robot gets, at most, to 50 ms. presses_n: how hard the robot presses, as the joystick knows.
 * @typedef {{state: string, allowed: string[], reason: string, dead_man: boolean, force_limit_n:
 *   number, device: string, axes: AxisText[], test: string, test_reason: string, experiment:
 *   string, partner: boolean | null, command_age_ms: number | null, presses_n: number, request:
 *   string}} JoystickText
 */

/**
 * The emergency stop, as this end knows it. stopped: it is ordered. by: who ordered it, "" if that
 * is not known here. frozen: a part of the operator's picture is.
 * @typedef {{stopped: boolean, by: string, frozen: boolean}} SafetyText
 */

/**
 * Whether the hand may move the robot, as `pipelines.session.situation` has it. why, next: names
 * of the cause, and of what is to be done; the others are their words.
 * @typedef {{may: boolean, level: Level, why: string, reason: string, next: string, advice:
 *   string}} SituationText
 */

/**
 * Who holds the handle, and who asks for it, by numbers of pages. who, asks: their names; "" for
 * nobody, and at the other end. policy: one that may drive.
 * @typedef {{holder: number | null, you: boolean, wanted_by: number | null, who: string, asks:
 *   string, policy: string}} HandText
 */

/**
 * The heartbeat, 10 times a second, and at each change.
 * @typedef {{kind: "state", now_us: number, link: "connected" | "lost", signal: boolean, camera:
 *   string | null, joystick: JoystickText | null, safety: SafetyText, situation: SituationText,
 *   hand: HandText, inputs: Record<string, number | null>}} StateText
 */

/**
 * A process as its launcher knows it; once the session is over, as it was at its end. segment:
 * null for both. state: `running`, `stopped` by a telecommand, `down` until it is started again,
 * or `absent`. restarts: after ends that nobody asked for. error: why its newest start that failed
 * ended. trouble: why it does not do its work; "" if it does. cpu_s: of all its starts. cpu: share
 * of a core over the last 2 s; null: not known yet. age_ms: of its newest figures; 0 if it does
 * not run. slips, cycles: as in `LoopMetrics`.
 * @typedef {{name: string, segment: string | null, state: "absent" | "running" | "stopped" |
 *   "down", restarts: number, error: string, trouble: string, cpu_s: number, cpu: number | null,
 *   age_ms: number, slips: number, cycles: number}} ProcessText
 */

/**
 * One event. number: from 1 on. at_us: on the session's clock. what: `link`, `process`, `camera`,
 * `stale`, `joystick`, `input`, `session`, `upkeep` or `milestone`.
 * @typedef {{number: number, at_us: number, what: string, text: string}} EventText
 */

/**
 * What the launcher tells each process that follows the session, once a second. at_us: on the
 * session's clock. seconds: since the session began. figures: by name; empty if nobody asks for
 * them. processes: one of each of this machine. events: those that the receiver was not told yet.
 * problems: what is wrong now, a line each. report: the report so far, for monitoring systems
 * alone.
 * @typedef {{kind: "figures", at_us: number, seconds: number, state: "running" | "stopped",
 *   figures: Record<string, Figure>, processes: ProcessText[], events: EventText[], problems:
 *   string[], report: unknown}} FiguresText
 */

/**
 * The answer to a request of this number. error: "" if it was carried out.
 * @typedef {{kind: "answer", request: number, ok: boolean, error: string, round_trip_ms?: number}}
 *   AnswerText
 */

/**
 * A line of the chat. state: `waiting`, `delivered`, `refused`; `received` from the others.
 * @typedef {{number: number, at_us: number, sender: string, text: string, state: string, reason?:
 *   string, round_trip_ms?: number}} ChatLine
 */

/**
 * The whole chat, as far as it is kept.
 * @typedef {{kind: "chat", lines: ChatLine[]}} ChatText
 */

/**
 * A telecommand of this seat. stage, done, ok, verified: as in `CommandUpdate`.
 * @typedef {{number: number, at_us: number, who: string, words: string, stage: string, done?:
 *   boolean, ok?: boolean, verified?: boolean, reason?: string, round_trip_ms?: number, tries?:
 *   number}} CommandLine
 */

/**
 * The telecommands of this seat.
 * @typedef {{kind: "commands", commands: CommandLine[]}} CommandsText
 */

/**
 * A parameter's newest value. value: None for NaN. at_us: when it was heard.
 * @typedef {{application: string, name: string, value: Figure, level: Level, at_us: number}}
 *   ValueText
 */

/**
 * All parameters that were reported.
 * @typedef {{kind: "values", values: ValueText[]}} ValuesText
 */

/**
 * An event of an application of either end.
 * @typedef {{number: number, at_us: number, application: string, name: string, severity: string,
 *   values: Record<string, Figure>}} EventLine
 */

/**
 * The newest events.
 * @typedef {{kind: "events", events: EventLine[]}} EventsText
 */

/**
 * Whether both directions carry, in words.
 * @typedef {{kind: "radio", level: Level, words: string}} RadioText
 */

/**
 * The panel, as `telepresence.tasks.panel.PanelView` has it; handle_m: where the handle is.
 * @typedef {{kind: "panel", mode: string, task: string, run: number, text: string, words: string,
 *   start_m: [number, number], held_s: number, handle_m: [number, number], dead_man: boolean,
 *   hold_s: number, left_s: number | null, goal: string, target_m: [number, number] | null, step:
 *   number, steps: number, percent: number, force_n: number}} PanelText
 */

/**
 * A task. lacks: why it cannot be selected here; "" if it can.
 * @typedef {{name: string, text: string, lacks: string}} TaskListed
 */

/**
 * A step of a run, at an instant of the session's clock.
 * @typedef {{at_ns: number, run: number, task: string, step: string}} StepShown
 */

/**
 * A run that is over. seconds: from its start; None if it never started. score: in words.
 * @typedef {{task: string, run: number, result: string, reason: string, seconds: number | null,
 *   score: string}} RunShown
 */

/**
 * The experiment: its phase, the present task ("" without), Elemop, and what the panel shows.
 * tasks: in the catalogue's order, by whose index telecommands name them. steps: the newest ones.
 * runs: the newest ones. planned: a plan selects the tasks.
 * @typedef {{kind: "experiment", phase: string, task: string, run: number, elemop: string, panel:
 *   string, tasks: TaskListed[], steps: StepShown[], runs: RunShown[], planned: boolean}}
 *   ExperimentText
 */

/**
 * The robot controller. boot_id: of its process. handled: number of the newest order. x_m, y_m: of
 * the tip. push_n: the board's force. goal_m: where it rests after a move. fault: one line, "" for
 * none. error: its kind, a `telepresence.tasks.robot_control.Fault`. halted: the newest sample of
 * the joystick says that it is. commanded: number of the newest `RobotCommand`; None for none.
 * command_refusal: why that was refused, "" if it was carried out. step_hz: cycles of the
 * controller, in the last second. hold: why it follows no hand, in words, "" if it does. waiting:
 * for a new press. stopped: an emergency stop holds. barred: why a new press would not count now;
 * "": it would. blind: the operator's picture is frozen in part. stopped_by: who orders the stop;
 * a joystick's order stays after a release here. offset_mm: the robot's place less the hand's.
 * holds: its hand holds a ball. joints: of each the angle in rad and the torque in N m, as far as
 * the robot says them. axes: of each behind x and y its name, place and force of its surroundings:
 * m and N, or rad and N m. partner: of the partner's robot, "none", "absent", "ready" or "driven".
 * partner_seen: while it is driven: the place (x, y) that the joystick wants (m), its force (N),
 * whether it touches something, and the age (ms) of its newest sample. fields: of a cycle, by
 * their parameters.
 * @typedef {{kind: "robot", boot_id: number, powered: boolean, mode: "position" | "torque" |
 *   "telepresence" | "impedance", x_m: number, y_m: number, push_n: number, goal_m: [number,
 *   number] | null, fault: string, faults: number, refused: number, handled: number, halted:
 *   boolean, error: string, commanded: number | null, command_refusal: string, step_hz: number,
 *   hold: string, waiting: boolean, stopped: boolean, offset_mm: [number, number], holds: boolean,
 *   joints: [number, number][], partner: string, stopped_by: string, axes: [string, number,
 *   number][], barred: string, blind: boolean, partner_seen: [number, number, number, boolean,
 *   number] | null, fields: Record<string, number>}} RobotText
 */

/**
 * What lasts, until when on the session's clock; an instant in the past: it is over. los_ns: no
 * frame gets through, either way. joystick_ns, robot_ns: joystick or robot has a fault. tasks_ns:
 * each task fails. cameras_ns: by input, until when it gives no pictures.
 * @typedef {{kind: "exercises", los_ns: number, joystick_ns: number, robot_ns: number, tasks_ns:
 *   number, cameras_ns: Record<string, number>}} ExercisesText
 */

/**
 * A file on its way. end: which asked for it. size: None if it is not known.
 * @typedef {{end: string, number: number, what: string, state: string, octets: number, size:
 *   number | null, rate_bps: number, name: string}} TransferText
 */

/**
 * What a keeper of versions or copies has told. end: where it runs. inbox: its folder. written:
 * when it was told, UTC. The others are those of `InboxTold`.
 * @typedef {{end: string, inbox: string, written: string, runs: string, why: string, states:
 *   Record<string, string>, waiting: string[], busy: boolean, answers: string[]}} SoftwareText
 */

/**
 * What the systems operator is shown. files: whether the session carries any.
 * @typedef {{kind: "upkeep", files: boolean, transfers: TransferText[], software: SoftwareText[]}}
 *   UpkeepText
 */

/**
 * What the page where people choose a page must know; it stands in that page itself. seat: the end
 * that serves it. ports: by end, of those on this machine. tasks: whether the session has any.
 * trainer: whether it has one. people: by role, its token, for the owner to hand out; none for
 * others.
 * @typedef {{role: "operator" | "cosmonaut" | "experimenter" | "supervisor" | "systems" |
 *   "trainer" | "viewer", seat: "ground" | "space", ports: Record<string, number>, tasks: boolean,
 *   trainer: boolean, people: Record<string, string>}} WelcomeText
 */

/**
 * What a page of the study says. screen: its number, which a press names. main, other: words of
 * the buttons; "" for none. wait_s: until they can be pressed. trial: the number of those that are
 * finished, of `trials`. half_width_m, half_height_m: the field.
 * @typedef {{kind: "study", screen: number, phase: "consent" | "return" | "read" | "start" |
 *   "trial" | "break" | "done", title: string, words: string[], main: string, other: string,
 *   wait_s: number, trial: number, trials: number, half_width_m: number, half_height_m: number}}
 *   StudyShown
 */

/**
 * Where dot and target are. starting: the target is the start. rest: how long the dot has rested
 * there, 0 to 1.
 * @typedef {{kind: "frame", x_m: number, y_m: number, target_x_m: number, target_y_m: number,
 *   radius_m: number, starting: boolean, rest: number}} StudyFrame
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
 *   | RobotText
 *   | ExercisesText
 *   | UpkeepText} ServerText */

/**
 * What a page may ask for.
 * @typedef {{do: "joystick", event: "calibrate" | "start" | "halt" | "acknowledge" | "stop" | "resume"}
 *   | {do: "hand", action: "take" | "give" | "ask" | "refuse" | "policy"}
 *   | {do: "session", action: "start" | "stop"}
 *   | {do: "stop", action: "stop" | "release"}
 *   | {do: "record", action: "start" | "stop"}
 *   | {do: "exercise", exercise: string, seconds?: number, camera?: string}
 *   | {do: "command", application: string, verb?: Verb, name?: string, arguments?: (boolean | number | string)[]}
 *   | {do: "fetch", inbox: string}
 *   | {do: "chat", text: string}
 *   | {do: "input", name: string, on: boolean}} Request
 */

export {};
