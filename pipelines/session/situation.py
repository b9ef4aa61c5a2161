"""The situation: whether the hand may move the robot now, why not, and what to do next. A core.

`situation` answers from all that an end of a session knows, for one role; `at_terminal` for a
command line on the machine of one end or both. Pages, telemetry and commands repeat its sentences.
Doing what an advice says changes the state or the sentence, so that who follows only the sentences
comes to steer.
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import Literal, NamedTuple

import msgspec

from pipelines.session.access import PEOPLE, Role, refusal
from pipelines.session.setup.segments import Segment
from telepresence.haptics.envelope import Hold
from telepresence.haptics.sample import Drive


class Why(StrEnum):
    """What keeps the hand from moving the robot; `FOLLOWS` and `READY`: nothing does."""

    FOLLOWS = "follows"
    READY = "ready"
    STOPPED = "stopped"
    SESSION = "session stopped"
    LINK = "link lost"
    JOYSTICK_SILENT = "joystick silent"
    TEST = "functional test"
    JOYSTICK = "joystick state"
    ROBOT_SILENT = "robot silent"
    FAULT = "robot fault"
    OFF = "robot off"
    MODE = "robot mode"
    PARTNER = "partner's robot"
    PICTURE = "picture too old"
    AGE = "commands too old"
    NO_COMMAND = "no command"
    PRESS = "new press"


class Next(StrEnum):
    """What to do next: by oneself, by another person ("ask"), or nothing but to wait."""

    STEER = "steer"
    PRESS = "press"
    LET_GO = "let go, then press"
    TAKE = "ask for the handle"
    RELEASE = "release the stop"
    START = "start the session"
    TEST = "do the test"
    JOYSTICK = "joystick request"
    RESET = "reset the robot"
    POWER = "power on"
    MODE = "power off, set mode"
    PANEL = "panel"
    SELECT = "select a task"
    ASK = "ask"
    WAIT = "wait"
    RESTART = "restart"


#: The device of a joystick whose hand is simulated.
SIMULATED = "simulated"


class Terminal(msgspec.Struct, frozen=True):
    """A command line, which may do what people of both ends may. session: to be named, or ""."""

    session: str = ""

    def lines(self, *commands: str) -> str:
        """The commands to give, one after the other."""
        named = f" --session {self.session}" if self.session else ""
        return ", then ".join(f"`kontur-av {command}{named}`" for command in commands)


class Known(msgspec.Struct, frozen=True, kw_only=True):
    """What an end knows, as the server of its seat does.

    orders: this seat starts the session, and releases the stop itself. runs: the session does.
    answered: the robot says that it is stopped. by: who ordered the stop, or "".
    joystick: its state in words; None: nothing is heard of it. says: why it is in it, or what a
    person should do. request: that leads on from there; "": it goes on by itself. testing: by the
    functional test. held: the dead-man button is. taken_up: that is so for longer than the robot
    needs to answer. russian: it drives the partner's robot.
    device: "page", `SIMULATED`, or the name of another joystick. holder: who else has the handle.
    drive: of the robot. telepresence: its mode for the next power on, where that is known.
    fault: of the robot. barred: why a press does not count now. waits: for a new press. cause: why.
    partner: the partner's robot has the joystick, not ours.
    panel: mode of the panel in space, phase of the experiment on the ground; None without tasks.
    panel_words: what the panel says. offered: a task that can be selected; "": none, or unknown.
    terminal: what is said is read at one; None: at a page.
    """

    seat: Segment
    role: Role
    orders: bool = True
    runs: bool = True
    connected: bool = True
    stopped: bool = False
    answered: bool = True
    by: str = ""
    joystick: str | None = "application"
    says: str = ""
    request: str = ""
    testing: bool = False
    held: bool = False
    taken_up: bool = True
    russian: bool = False
    device: str = "page"
    holder: str = ""
    drive: Drive = "hand"
    telepresence: bool = True
    fault: str = ""
    barred: Hold = Hold.NONE
    waits: bool = True
    cause: str = ""
    partner: bool = False
    panel: str | None = None
    panel_words: str = ""
    offered: str = ""
    terminal: Terminal | None = None

    def may(self, deed: str) -> bool:
        """Whether the role may do this at its page."""
        return self.terminal is not None or not refusal(self.role, self.seat, deed)


class Situation(NamedTuple):
    """reason: why, as a part of a sentence. advice: what to do next, in whole sentences."""

    why: Why
    reason: str
    next: Next
    advice: str

    @property
    def words(self) -> str:
        """Reason and advice, for a terminal."""
        return f"{self.reason}. {self.advice}".rstrip()

    @property
    def may(self) -> bool:
        """Whether the hand may move the robot: it does, or a press of the button begins it."""
        return self.why in (Why.FOLLOWS, Why.READY)

    @property
    def level(self) -> Literal["good", "warn", "bad"]:
        """How it is coloured."""
        return "good" if self.may else "bad" if self.why is Why.STOPPED else "warn"


def situation(known: Known) -> Situation:
    """Return what holds, by the first of its causes that must end before the others can."""
    return _common(known) or (_at_robot(known) if known.seat is Segment.GROUND else _at_hand(known))


def at_end(known: Known, terminal: Terminal) -> Situation:
    """Return what holds for a terminal, from one end."""
    return situation(msgspec.structs.replace(known, terminal=terminal))


#: What the robot's end knows first.
_ROBOTS = (Why.STOPPED, Why.ROBOT_SILENT, Why.FAULT, Why.OFF, Why.MODE)


def at_terminal(ends: Iterable[Known], terminal: Terminal) -> Situation | None:
    """Return what holds for a terminal, from the ends that run on its machine; None: none does."""
    told = {end.seat: at_end(end, terminal) for end in ends}
    return of_both(told.get(Segment.SPACE), told.get(Segment.GROUND))


def of_both(space: Situation | None, ground: Situation | None) -> Situation | None:
    """Return what holds of what both ends say; None: that end does not run here."""
    if space is None or ground is None:
        return space or ground
    if ground.why is Why.PARTNER:
        return space
    robots = ground.why in _ROBOTS or space.why in _ROBOTS
    return ground if robots or (space.may and not ground.may) else space


def _common(known: Known) -> Situation | None:
    """What stops both ends."""
    if known.stopped:
        by = f" by {known.by}" if known.by else ""
        holds = "the robot is off" if known.answered else "the robot has not answered"
        reason = f"emergency stop{by}: {holds}"
        if known.seat is Segment.SPACE and not known.orders and not known.connected:
            return Situation(Why.STOPPED, reason, Next.WAIT, _LINK_COMES)
        return _deed(known, Why.STOPPED, reason, Next.RELEASE)
    if not known.runs:
        reason = "the session is stopped"
        if not known.orders:
            return Situation(
                Why.SESSION, reason, Next.ASK, "Wait: the ground starts the session again."
            )
        return _deed(known, Why.SESSION, reason, Next.START)
    if not known.connected:
        return Situation(Why.LINK, "the radio link is lost", Next.WAIT, _LINK_COMES)
    return None


_LINK_COMES = "Wait: the link comes back by itself, with the signal."
_PRESSES = "The simulated hand presses by itself."
_AGAIN = "Wait: its process is started again by itself."
_ASK_GROUND = "Ask the ground, in the chat, to switch the robot on."


def _at_hand(known: Known) -> Situation:
    """Where the handle is: joystick first, then robot, then press."""
    state = known.joystick
    if state is None:
        return Situation(
            Why.JOYSTICK_SILENT,
            "nothing is heard of the joystick",
            Next.WAIT,
            _AGAIN,
        )
    if known.testing:
        return _ask_or_do(
            known,
            "hand",
            Situation(
                Why.TEST,
                "the joystick tests itself",
                Next.TEST,
                f"{_sentence(known.says or 'wait')} The robot does not follow meanwhile.",
            ),
            "do what the test asks for",
        )
    if state != "application":
        return _by_joystick(known, state)
    if not known.drive:
        return Situation(
            Why.ROBOT_SILENT,
            "nothing is heard of the robot",
            Next.WAIT,
            _AGAIN,
        )
    if known.drive != "hand":
        if known.russian:
            return Situation(
                Why.OFF,
                "the partner's robot follows no hand",
                Next.ASK,
                "Wait: the partner switches it on.",
            )
        why, reason = _not_led(known)
        if known.panel is None:
            if known.terminal is None:
                return Situation(why, reason, Next.ASK, _ASK_GROUND)
            # Nobody here knows whether it has a fault; without one, a reset changes nothing.
            first = ("reset_error",) if why is Why.OFF else ("power_off", "set_mode telepresence")
            return _by_robot(known, Situation(why, reason, Next.POWER, ""), "", *first, "power_on")
        # The task switches it on; until then the panel says what is to be done.
        return Situation(why, reason, Next.PANEL, _sentence(known.panel_words or "wait for a task"))
    robot = "the partner's robot" if known.russian else "the robot"
    if known.held and not known.waits:
        return Situation(Why.FOLLOWS, f"{robot} follows the hand", Next.STEER, "")
    if known.barred is not Hold.NONE:
        return _by_bar(known)
    if known.held and not known.holder:
        if not known.taken_up:
            return Situation(
                Why.READY, f"{robot} may follow the hand", Next.WAIT, "Keep it pressed."
            )
        cause = f"{robot} waits for a new press" + _because(known)
        if known.device == SIMULATED:
            return Situation(Why.PRESS, cause, Next.WAIT, _PRESSES)
        return _deed(known, Why.PRESS, cause, Next.LET_GO)
    return _ready(known, f"{robot} may follow the hand")


def _ready(known: Known, reason: str) -> Situation:
    if known.device == SIMULATED:
        return Situation(Why.READY, reason, Next.WAIT, _PRESSES)
    if not known.may("hand"):
        return Situation(Why.READY, reason, Next.ASK, "The cosmonaut moves it.")
    if known.device != "page":
        advice = f"Press the dead-man button of the joystick {known.device}, and move it."
        return Situation(Why.READY, reason, Next.PRESS, advice)
    if known.holder:
        advice = f"{known.holder[:1].upper()}{known.holder[1:]} has the handle: press “Ask for it”."
        return Situation(Why.READY, reason, Next.TAKE, advice)
    advice = "Press on the map or the picture and drag; or hold Space and use the arrow keys."
    if known.terminal is not None:
        advice = f"At the cosmonaut's page: {advice[0].lower()}{advice[1:]}"
    return Situation(Why.READY, reason, Next.PRESS, advice)


#: By request of the joystick: the button on the pages.
_BUTTONS = {
    "calibrate": "Calibrate",
    "start": "Start",
    "resume": "Resume",
    "acknowledge": "Acknowledge",
}


def _by_joystick(known: Known, state: str) -> Situation:
    why = f": {known.says}" if known.says else ""
    reason = f"the joystick is in the state {state}{why}"
    if state == "fatal error":
        return Situation(
            Why.JOYSTICK, reason, Next.RESTART, "Mend the joystick, then start the session again."
        )
    if not known.request:
        return Situation(
            Why.JOYSTICK, reason, Next.WAIT, "Wait: the joystick goes on by itself after that."
        )
    button = _BUTTONS[known.request]
    return _ask_or_do(
        known,
        f"joystick.{known.request}",
        Situation(Why.JOYSTICK, reason, Next.JOYSTICK, f"Press “{button}” at Joystick."),
        f"press “{button}” at Joystick",
        f"tc joystick {known.request}",
    )


#: Why a press does not count, in the present.
_BARS = {
    Hold.PICTURE: (Why.PICTURE, "the operator's picture is too old"),
    Hold.AGE: (Why.AGE, "the commands come too late"),
    Hold.NO_COMMAND: (Why.NO_COMMAND, "no command comes from the joystick"),
    Hold.INACTIVE: (Why.JOYSTICK, "the joystick is not in the application"),
}


def _by_bar(known: Known) -> Situation:
    why, reason = _BARS.get(known.barred, (Why.PRESS, known.barred.value))
    advice = {
        Why.PICTURE: "Wait for a fresh picture, or select another camera.",
        Why.JOYSTICK: "Wait: the person at the joystick brings it there.",
    }.get(why, "Wait until that is over.")
    return Situation(why, reason, Next.WAIT, advice)


def _at_robot(known: Known) -> Situation:
    """On the ground: the robot first, then what comes from the joystick."""
    if known.partner:
        return Situation(
            Why.PARTNER,
            "the partner's robot has the joystick",
            Next.ASK,
            "Wait: the cosmonaut chooses the experiment.",
        )
    if not known.drive:
        return Situation(
            Why.ROBOT_SILENT,
            "nothing is heard of the robot",
            Next.WAIT,
            _AGAIN,
        )
    if known.fault:
        return _deed(known, Why.FAULT, f"the robot has a fault: {known.fault}", Next.RESET)
    if known.drive != "hand":
        return _off_at_robot(known)
    if not known.waits and known.cause == "":
        return Situation(Why.FOLLOWS, "the robot follows the hand", Next.STEER, "")
    if known.barred is not Hold.NONE:
        return _by_bar(known)
    return Situation(
        Why.READY,
        "the robot may follow the hand" + _because(known),
        Next.ASK,
        "The person in space moves it: press, and move.",
    )


#: By phase of the experiment: what comes next, where nothing is to be done here.
_PHASES = {
    "preparing": "Wait: robot, camera and LEDs are prepared.",
    "offered": "Wait: the cosmonaut reads the task, and starts it.",
    "running": "Wait: the task switches the robot over.",
    "ending": "Wait: the task ends.",
}


def _off_at_robot(known: Known) -> Situation:
    why, reason = _not_led(known)
    if known.panel is not None:
        if known.panel in _PHASES:
            return Situation(why, reason, Next.WAIT, _PHASES[known.panel])
        return _deed(known, why, reason, Next.SELECT)
    off = why is Why.OFF
    if off and known.telepresence:
        return _deed(known, why, reason, Next.POWER)
    first = "" if off else "switch the robot off, "
    then = f"{first}choose the mode telepresence, then switch it on"
    told = Situation(why, reason, Next.MODE, f"At Robot, {then}.")
    return _by_robot(
        known, told, then, *(() if off else ("power_off",)), "set_mode telepresence", "power_on"
    )


def _by_robot(known: Known, told: Situation, others: str, *functions: str) -> Situation:
    """As `_ask_or_do`, by telecommands to the robot."""
    commands = [f"tc robot {function}" for function in functions]
    return _ask_or_do(known, "robot.set_mode", told, others, *commands)


def _not_led(known: Known) -> tuple[Why, str]:
    if known.drive == "off":
        return Why.OFF, "the robot is off"
    return Why.MODE, "the robot moves in a mode of its own"


def _because(known: Known) -> str:
    return f" ({known.cause})" if known.cause and known.cause != Hold.RELEASED else ""


class _Deed(NamedTuple):
    """Its right, the advice, what others are asked for, and the command that does it, if any."""

    right: str
    advice: str
    others: str
    command: str = ""


_DEEDS = {
    Next.RELEASE: _Deed(
        "robot.release_stop",
        "Press “Release the stop” when nobody is in danger.",
        "release the stop",
        "stop --release",
    ),
    Next.START: _Deed("session", "Press “Start session”.", "start the session"),
    Next.LET_GO: _Deed(
        "hand",
        "Let the dead-man button go, then press it.",
        "let the button go, then press it",
    ),
    Next.RESET: _Deed(
        "robot.reset_error",
        "Press “Reset error” at Robot.",
        "reset the robot",
        "tc robot reset_error",
    ),
    Next.SELECT: _Deed(
        "tasks.select",
        "Select a task: it switches the robot on.",
        "select a task",
        "task select",
    ),
    Next.POWER: _Deed(
        "robot.power_on", "Press “Power on” at Robot.", "switch the robot on", "tc robot power_on"
    ),
}


def _deed(known: Known, why: Why, reason: str, to_do: Next) -> Situation:
    deed = _DEEDS[to_do]
    command = deed.command
    if to_do is Next.SELECT:
        command = f"{command} {known.offered}" if known.offered else "task list"
    told = Situation(why, reason, to_do, deed.advice)
    return _ask_or_do(known, deed.right, told, deed.others, *([command] if command else []))


def _ask_or_do(known: Known, deed: str, told: Situation, others: str, *commands: str) -> Situation:
    """Advise a deed, at a terminal by its commands, or whom of either end to ask for it."""
    if known.terminal is not None and commands:
        danger = ", when nobody is in danger" if told.next is Next.RELEASE else ""
        return told._replace(advice=f"Give {known.terminal.lines(*commands)}{danger}.")
    if known.may(deed):
        return told
    who = [role.words for end in Segment for role in PEOPLE[end] if not refusal(role, end, deed)]
    return told._replace(next=Next.ASK, advice=f"Ask the {' or the '.join(who)}: {others}.")


def _sentence(words: str) -> str:
    words = words.rstrip(".")
    return f"{words[:1].upper()}{words[1:]}."
