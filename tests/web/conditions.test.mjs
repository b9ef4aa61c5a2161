/** Over random histories of losses, faults and kills, what the pages of both ends say holds. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { ageTile, boardOf, experimentWords, follows, handTile, joystickWords, linkTile, panelShown, robotWords } = await load("conditions.js");
const { Telemetry, systemSays } = await load("telemetry.js");
const { PANEL_WORDS, PHASE_WORDS, commandText } = await load("mission_words.js");

/** The nightly tier asks for more, and for others. */
const HISTORIES = 200 * Number(process.env.KONTUR_TIMES ?? 1);
const FIRST_SEED = Number(process.env.KONTUR_SEED ?? 1);
const STEPS = 80;
const STEP_US = 500_000;
/** So long a report takes from one end to the other. */
const ON_THE_WAY_STEPS = 1;

/** Numbers below 1 from a seed (mulberry32). */
function randomOf(seed) {
  let at = seed;
  return () => {
    at = (at + 0x6d2b79f5) | 0;
    let t = Math.imul(at ^ (at >>> 15), 1 | at);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

const application = (name, end, interval_s, ...names) => ({
  name,
  end,
  parameters: names.map((one) => ({ name: one })),
  structures: [{ name: "state", parameters: names, interval_s, on: true }],
  functions: [],
});
const APPLICATIONS = [
  application("joystick", "space", 1, "state", "application"),
  application("space_gateway", "space", 10, "state"),
  application("panel", "space", 10, "mode"),
  application("ground_gateway", "ground", 10, "state"),
  application("robot", "ground", 10, "powered", "mode", "error_kind"),
  application("tasks", "ground", 10, "phase"),
];
const ROWS = APPLICATIONS.flatMap(({ name, end, parameters }) => parameters.map((one) => ({ name, end, parameter: one.name })));

/** What is so, at both ends. */
class World {
  now_us = 1_000_000;
  link = true;
  running = true;
  stopped = false;
  powered = false;
  mode = "position";
  fault = "";
  waiting = true;
  joystick = "application";
  experiment = "german experiment";
  test = "none";
  holder = null;
  dead_man = false;
  phase = "idle";
  panel = "wait_task";

  get follows() {
    const ready = this.link && this.running && !this.stopped && this.powered && this.fault === "";
    return ready && this.joystick === "application" && this.dead_man && !this.waiting;
  }

  /** Something happens. */
  change(random) {
    const pick = (...of) => of[Math.floor(random() * of.length)];
    const what = pick("link", "running", "stop", "power", "fault", "reset", "joystick", "press", "let go", "hold", "task", "test");
    if (what === "link") this.link = random() < 0.6;
    if (what === "running") this.running = random() < 0.7;
    if (what === "stop") this.stopped = random() < 0.4;
    if (what === "power") [this.powered, this.mode] = [random() < 0.7, pick("position", "telepresence")];
    if (what === "fault") this.fault = "force above 28 N";
    if (what === "reset") this.fault = "";
    if (what === "joystick") this.joystick = pick("application", "application", "halted", "calibrated", "recoverable error");
    if (what === "joystick") this.experiment = pick("german experiment", "russian experiment");
    if (what === "hold") this.holder = pick(null, 1, 2);
    if (what === "press") this.dead_man = this.holder !== null;
    if (what === "let go") this.dead_man = false;
    if (what === "task") [this.phase, this.panel] = pick(["idle", "wait_task"], ["running", "running"], ["offered", "hold"]);
    if (what === "test") this.test = pick("none", "running", "passed", "failed");
    // What else follows.
    if (this.fault !== "" || this.stopped) this.powered = false;
    if (!this.link || !this.running) [this.phase, this.panel] = ["idle", "no_contact"];
    else if (this.panel === "no_contact") this.panel = "wait_task";
    this.waiting = !this.dead_man || !this.powered || !this.link || this.joystick !== "application";
  }

  /** What a server says, which hears that `far` is stopped. */
  situation(far) {
    const said = (why, reason, next, advice) => ({ may: why === "follows" || why === "ready", level: why === "follows" || why === "ready" ? "good" : why === "stopped" ? "bad" : "warn", why, reason, next, advice });
    if (far.stopped) return said("stopped", "emergency stop", "release the stop", "Release it.");
    if (!this.running) return said("session stopped", "the session is stopped", "start the session", "Start it.");
    if (!this.link) return said("link lost", "the radio link is lost", "wait", "Wait.");
    if (this.test === "running") return said("functional test", "the joystick tests itself", "do the test", "Hold the button.");
    if (this.joystick !== "application") return said("joystick state", this.joystick, "joystick request", "Press Start.");
    if (!this.powered) return said("robot off", "the robot is off", this.panel === "wait_task" ? "panel" : "power on", "Wait for a task.");
    if (this.dead_man && !far.waiting) return said("follows", "the robot follows the hand", "steer", "");
    return this.dead_man ? said("new press", "it waits for a new press", "let go, then press", "Let go, then press.") : said("ready", "the robot may follow the hand", "press", "Press.");
  }

  values(end) {
    const lost = this.link && this.running ? "connected" : "lost";
    const error = this.fault === "" ? "none" : "force";
    const busy = this.joystick === "application" ? this.experiment : "none";
    const of = {
      space: { "joystick.state": this.joystick, "joystick.application": this.test === "running" ? "joystick test" : busy, "space_gateway.state": lost, "panel.mode": this.panel },
      ground: { "ground_gateway.state": lost, "robot.powered": this.powered, "robot.mode": this.mode, "robot.error_kind": error, "tasks.phase": this.phase },
    };
    return of[end];
  }
}

/** A page of an end: what its server tells it. */
class Page {
  alive = true;
  ended = false;
  stopped = false;
  state = null;
  robot = null;
  experiment = null;
  panel = null;
  panelHeard = "";
  #listeners = {};
  #past = [];

  constructor(seat) {
    this.hello = { seat, joystick: "page", applications: APPLICATIONS };
    this.telemetry = new Telemetry(this);
    this.tell("hello", this.hello);
  }

  on(name, listener) {
    this.#listeners[name] = listener;
  }

  tell(name, event) {
    this.#listeners[name]?.(event);
  }

  hear(world, random) {
    const { seat } = this.hello;
    const far = seat === "space" ? "ground" : "space";
    const through = world.link && world.running;
    this.#past.push({ stopped: world.stopped, waiting: world.waiting, values: world.values(far) });
    if (random() < 0.05) this.alive = !this.alive;
    if (random() < 0.002) [this.ended, this.alive] = [true, false];
    if (this.ended) this.alive = false;
    if (!this.alive) return;
    const heard = through ? (this.#past.at(-1 - ON_THE_WAY_STEPS) ?? this.#past[0]) : null;
    this.stopped = !world.running;
    // The processes of a session that was stopped leave what they said last.
    const told = world.running;
    const joystick = { state: world.joystick, experiment: world.experiment, test: world.test, test_reason: "", reason: "", dead_man: world.dead_man };
    const robot = seat === "ground" ? world : (heard ?? this.far ?? { stopped: false, waiting: true });
    this.far = { stopped: robot.stopped, waiting: robot.waiting };
    this.state = {
      now_us: world.now_us,
      link: through ? "connected" : "lost",
      signal: through,
      joystick: seat !== "space" ? null : told ? joystick : (this.state?.joystick ?? joystick),
      safety: { stopped: robot.stopped, by: "", frozen: false },
      situation: world.situation(this.far),
      hand: { holder: world.holder, you: seat === "space" && world.holder === 1, wanted_by: null, who: world.holder === null ? "" : "operator", asks: "" },
    };
    if (told && seat === "ground") {
      this.robot = { powered: world.powered, mode: world.mode, error: world.fault === "" ? "none" : "force", fault: world.fault };
      if (heard !== null) this.panelHeard = heard.values["panel.mode"];
      this.experiment = { phase: world.phase, panel: this.panelHeard };
    } else if (told) this.panel = { mode: world.panel, words: "" };
    if (heard === null || random() > 0.1) return;
    const values = Object.entries(heard.values).map(([key, value]) => {
      const [of, name] = key.split(".");
      return { application: of, name, value, level: "none", at_us: world.now_us };
    });
    this.tell("values", { values });
  }

  row({ name, parameter }, now_us) {
    return systemSays(this.telemetry, name, parameter, now_us);
  }
}

/** Checks all that a page says against what is so. */
function check(page, world) {
  const { seat } = page.hello;
  const [link, hand, robot] = [linkTile(page, false), handTile(page), robotWords(page)];
  const rows = ROWS.map((row) => ({ ...row, said: page.row(row, world.now_us) }));
  const carries = page.alive && world.link && world.running;
  if (!page.alive) {
    const levels = [link, hand, robot, ...rows.map(({ said }) => said)].map(({ level }) => level);
    assert.ok(!levels.includes("good"), "nothing is good without a server");
    return;
  }
  assert.equal(link.level === "good", carries);
  assert.equal(panelShown(page, { mode: world.panel, words: "" }).mode === "no_contact", !carries);
  for (const { name, end, parameter, said } of rows) {
    const truth = world.values(end)[`${name}.${parameter}`];
    const off = name === "robot" && parameter === "mode" && !world.powered;
    // What is near is said at once; what is far is never good beyond a lost link.
    if (end === seat && page.stopped) assert.ok(said.past && said.level === "none");
    else if (end === seat) {
      assert.equal(said.past, false);
      assert.equal(said.text, off ? "off" : String(truth === true ? "yes" : truth === false ? "no" : truth));
    } else if (!carries) assert.equal(said.past && said.level === "none", true);
  }
  if (seat === "ground" && !world.powered && world.running) assert.ok(rows.every(({ said }) => said.text !== "telepresence"));
  if (page.experiment !== null) {
    const { phase, panel, acts } = experimentWords(page, page.experiment);
    assert.equal(acts, world.running);
    if (world.running) assert.equal(phase, PHASE_WORDS[world.phase]);
    else assert.match(phase, /^Last known: /);
    // What the panel beyond a lost link shows, nobody here knows.
    if (!carries) assert.ok(!Object.values(PANEL_WORDS).includes(panel));
  }
  // Tile and line above the page agree, and say "steer" only where nothing is known against it.
  if (hand.value === "YOU STEER") assert.equal(robot.level, "good");
  const { situation, safety } = page.state;
  assert.ok(robot.words.includes(situation.advice), "a page repeats what its server says");
  if (!carries && !safety.stopped) assert.match(robot.words, /the session is stopped|link is lost/i);
  if (robot.level === "good") {
    assert.ok(carries && !safety.stopped && world.joystick === "application");
    if (seat === "ground" && follows(page)) assert.ok(world.follows);
  }
}

/** Names the seed in what fails. */
function checkSeed(seed, page, world) {
  try {
    check(page, world);
  } catch (error) {
    error.message = `seed ${seed}: ${error.message}`;
    throw error;
  }
}

test("over random histories no words of a page contradict the state", () => {
  let steered = 0;
  for (let seed = FIRST_SEED; seed < FIRST_SEED + HISTORIES; seed += 1) {
    const random = randomOf(seed);
    const world = new World();
    const pages = [new Page("space"), new Page("ground")];
    for (let step = 0; step < STEPS; step += 1) {
      world.now_us += STEP_US;
      world.change(random);
      for (const page of pages) {
        page.hear(world, random);
        if (page.state !== null) checkSeed(seed, page, world);
        if (handTile(page).value === "YOU STEER") steered += 1;
      }
    }
  }
  assert.ok(steered > 0, "a history in which a hand steers");
});

test("a functional test says where the handle is, and what it came to", () => {
  const joystick = { state: "calibrated", reason: "hold the button", test: "running", test_reason: "" };
  assert.match(joystickWords(joystick, true), /At the handle .*hold the button/);
  assert.doesNotMatch(joystickWords(joystick, false), /At the handle/);
  const failed = { ...joystick, reason: "", test: "failed", test_reason: "the button was not pressed" };
  assert.match(joystickWords(failed, true), /failed: the button was not pressed/);
});

test("a functional test is no lack of motion, and a frozen part of a picture is no good age", () => {
  const page = new Page("space");
  const world = Object.assign(new World(), { joystick: "calibrated", test: "running", holder: 1, dead_man: true });
  page.hear(world, () => 0.9);
  assert.deepEqual(handTile(page), { label: "Handle: the joystick tests itself", value: "TEST", level: "none" });
  assert.match(robotWords(page).words, /tests itself\. Hold the button/);
  const young = { ageMs: 120, stale: false };
  assert.equal(ageTile(page, young).level, "good");
  page.state.joystick = { ...page.state.joystick, state: "application", experiment: "russian experiment" };
  assert.deepEqual(ageTile(page, young), { label: "Picture: our robot's", value: "120 ms", level: "warn" });
  assert.equal(boardOf(page, { wall_x_m: 0.1, leds_m: [[0, 0]] }).wall_x_m, null);
  page.state.safety.frozen = true;
  assert.deepEqual(ageTile(page, young), { label: "Picture: a part is frozen", value: "120 ms", level: "bad" });
});

test("with the robot off the panel's own words stand; what must come before is said first", () => {
  const page = new Page("space");
  const world = Object.assign(new World(), { powered: false });
  page.hear(world, () => 0.9);
  const panel = { mode: "wait_task", words: "Wait for a task." };
  assert.deepEqual(panelShown(page, panel), panel);
  assert.doesNotMatch(robotWords(page).words, /press/i);
  page.hear(Object.assign(world, { joystick: "recoverable error" }), () => 0.9);
  assert.deepEqual(panelShown(page, panel), { mode: "wait_task", words: "Press Start." });
});

test("a telecommand names the task that it selects", () => {
  assert.equal(commandText("tasks select 1", ["aiming", "pursuit"]), "select the task pursuit");
  assert.equal(commandText("tasks select 7", ["aiming"]), "tasks select 7");
  assert.equal(commandText("robot power_on", []), "robot power on");
});
