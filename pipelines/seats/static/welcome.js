/**
 * Where people choose a page: who sits where, and each seat with what it is for. The token of the
 * address tells the role; the session's owner also finds addresses for other people here.
 *
 * @import { WelcomeText } from "./texts.js"
 */
import { make, one, setText } from "./dom.js";
import { startTheme } from "./theme.js";

/** The status of a page whose token is not of the session that runs. */
const REFUSED = 403;
const LOOK_MS = 3000;
/** Pages that show nothing in a session without tasks. */
const OF_TASKS = ["panel", "top"];

/**
 * In the order of a session. roles: whose place it is. end: "" for every end. watch: what a viewer
 * sees there; "" if there is nothing to watch.
 * @typedef {{page: string, end: string, roles: string[], name: string, what: string, keys: string, watch: string}} Place
 * @type {Place[]}
 */
const PLACES = [
  {
    page: "space",
    end: "space",
    roles: ["operator", "cosmonaut"],
    name: "Operator's seat",
    watch: "What the person in space sees, hears and feels.",
    what: "In space: see and hear the ground, steer the robot, and feel its forces.",
    keys: "Press on the picture and drag, or hold Space and use the arrow keys; Esc lets go; 1 to 9 select a camera.",
  },
  {
    page: "panel",
    end: "space",
    roles: ["cosmonaut"],
    name: "Mission control panel",
    watch: "The present task, step by step.",
    what: "In space: do the tasks that the ground selects, step by step.",
    keys: "Enter goes on; hold Space and use the arrow keys to move the handle; Esc lets go.",
  },
  {
    page: "k2cp",
    end: "space",
    roles: ["cosmonaut"],
    name: "Joystick and experiment (K2CP)",
    watch: "",
    what: "In space: look after the joystick and the systems, start and stop, write to the ground.",
    keys: "X halts the joystick.",
  },
  {
    page: "ground",
    end: "ground",
    roles: ["operator"],
    name: "Ground control",
    watch: "The person in space, all cameras, the robot and the radio link.",
    what: "On the ground: see and hear the person in space, all cameras, the robot and the radio link.",
    keys: "1 to 9 open a tab; hold T to talk; M mutes the loudspeaker.",
  },
  {
    page: "top",
    end: "ground",
    roles: ["experimenter"],
    name: "Tasks and robot (TOP-UI)",
    watch: "",
    what: "On the ground: select a task for the cosmonaut, follow its steps, look after the robot.",
    keys: "Tab and Enter reach every button.",
  },
  {
    page: "k2sv",
    end: "ground",
    roles: ["supervisor"],
    name: "All systems (K2SV)",
    watch: "Every system, every alarm, and the next contacts.",
    what: "On the ground: watch every system and every alarm, command the joystick, know the next contacts.",
    keys: "1 to 9 open a tab.",
  },
  {
    page: "systems",
    end: "ground",
    roles: ["systems"],
    name: "Maintenance",
    watch: "",
    what: "On the ground: watch contacts, bandwidth, processes and files, know which software runs.",
    keys: "1 to 9 open a tab.",
  },
  {
    page: "trainer",
    end: "",
    roles: ["trainer"],
    name: "Trainer",
    watch: "",
    what: "At each end: make signal, joystick, robot, tasks or cameras fail, and see what people do.",
    keys: "Tab and Enter reach every button.",
  },
];

/** By role: its name. @type {Record<string, string>} */
const ROLES = {
  operator: "the session's owner",
  cosmonaut: "the cosmonaut",
  experimenter: "the experimenter",
  supervisor: "the supervisor",
  systems: "the systems operator",
  trainer: "the trainer",
  viewer: "a viewer",
};

/** @type {WelcomeText} */
const welcome = JSON.parse(document.body.dataset.welcome ?? "{}");
const { role, seat, ports, tasks, trainer, people } = welcome;
const token = new URLSearchParams(location.search).get("token") ?? "";
const everywhere = role === "operator" || role === "viewer";

/** @param {string} end @param {string} page @param {string} [given] */
function address(end, page, given = token) {
  return `${location.protocol}//${location.hostname}:${ports[end] ?? location.port}/${page}?token=${given}`;
}

/** Whether the owner takes the trainer's seat there, by the trainer's own address. @param {string} page */
function mayTrain(page) {
  return page === "trainer" && trainer && role === "operator" && people.trainer !== undefined;
}

function showPlaces() {
  const watches = role === "viewer";
  const shown = PLACES.filter(({ page, end, roles, watch }) => {
    const there = end === "" ? roles.includes(role) || mayTrain(page) : end in ports && (everywhere || end === seat);
    return there && (tasks || !OF_TASKS.includes(page)) && !(watches && watch === "");
  });
  const items = shown.map(({ page, end, roles, name, what, keys, watch }) =>
    make(
      "li",
      {},
      make(
        "a",
        { href: address(end || seat, page, mayTrain(page) ? people.trainer : token), "data-page": page, "data-yours": roles.includes(role) },
        make("strong", {}, watches ? `Watch: ${name}` : name),
        make("span", {}, watches ? watch : what),
        make("span", { class: "small quiet" }, watches ? "" : keys),
      ),
    ),
  );
  one("#seats", HTMLUListElement).replaceChildren(...items);
  const where = everywhere ? "" : seat === "space" ? " in space" : " on the ground";
  const may = role === "viewer" ? "You see and hear everything, and can change nothing." : "Choose your seat.";
  setText(one("#you-are", HTMLElement), `You are ${ROLES[role] ?? role}${where}. ${may}`);
  // Who is alone acts for both ends.
  one("#alone", HTMLElement).hidden = role !== "operator" || !tasks || !("space" in ports && "ground" in ports);
  for (const group of document.querySelectorAll("svg [data-end]")) {
    const { end = "" } = /** @type {SVGElement} */ (group).dataset;
    group.toggleAttribute("data-yours", everywhere || end === seat);
  }
}

function showPeople() {
  const rows = Object.entries(people).flatMap(([who, given]) => {
    const place = PLACES.find(({ roles }) => roles.includes(who));
    // Who only watches may look everywhere.
    const to = address(who === "viewer" ? seat : place?.end || seat, "", given);
    return [make("dt", {}, ROLES[who] ?? who), make("dd", {}, make("a", { href: to, "data-role": who }, to))];
  });
  one("#others", HTMLDetailsElement).hidden = rows.length === 0;
  one("#others dl", HTMLDListElement).replaceChildren(...rows);
}

/** Says when the session of this address is over, or its server is gone. */
async function look() {
  const { status } = await fetch(location.href, { cache: "no-store" }).catch(() => ({ status: 0 }));
  const ended = status === REFUSED;
  const words = ended ? "This session has ended. Open the address that the new one prints." : "The session does not answer.";
  const word = one("#session-word", HTMLParagraphElement);
  word.dataset.level = "bad";
  setText(word, status === 200 ? "" : words);
  if (!ended) setTimeout(() => void look(), LOOK_MS);
}

startTheme();
showPlaces();
showPeople();
setTimeout(() => void look(), LOOK_MS);
