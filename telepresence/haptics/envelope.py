"""The safety envelope at the robot: whether it may follow the operator's hand now, and how fast.

docs/safety.md has the rules S1 to S9, and what a new press is.

In each cycle: call `admit`, give the controller what it returns, and `speed_m_s` as its limit.
"""

from collections import deque
from dataclasses import dataclass, fields
from enum import StrEnum

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.metrics import Newest
from telepresence.haptics.authority import AuthorityEvent
from telepresence.haptics.echo import ANY_AGE_NS
from telepresence.haptics.sample import STATE_APPLICATION, Command

#: Who stopped it, by a sample; and where nobody knows.
JOYSTICK, SOMEBODY = "the joystick's end", "somebody"
#: Nearer than this to the hand (m), the robot has caught up.
_CAUGHT_UP_M = 0.002


@dataclass(frozen=True, kw_only=True, slots=True)
class SafetyLimits:
    """Limits of a setup; the defaults are chosen. ValueError for limits that cannot work.

    command_max_age_s: the robot holds still when the newest command is older.
    hand_max_age_s: a command this long after the hand gave it moves nothing. The radio's delay,
    there and back, comes on top.
    resume_within_s: a drop-out of the commands up to this resumes by itself.
    approach_m_s: how fast the robot then catches up with the hand.
    picture_max_age_s: the operator's picture is then too old. The radio's delay and the stream's
    `stale_after_ms` come on top.
    slow_m_s: speed while it is too old.
    picture_hold_s: after so long with such a picture the robot needs a new press.
    speed_m_s, force_n, half_width_m, half_height_m: in any case, of reference, motors and
    workspace.
    """

    command_max_age_s: float = 0.02
    hand_max_age_s: float = 0.5
    resume_within_s: float = 0.3
    approach_m_s: float = 0.1
    picture_max_age_s: float = 0.5
    slow_m_s: float = 0.03
    picture_hold_s: float = 1.0
    speed_m_s: float = 0.5
    force_n: float = 30.0
    half_width_m: float = 0.15
    half_height_m: float = 0.10

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            # Compared this way round, so that NaN is refused, too.
            if not 0.0 < value < 1000.0:
                raise ValueError(f"safety.{each.name} is {value:g}: take more than 0")
        if self.resume_within_s < self.command_max_age_s:
            raise ValueError(
                f"safety.resume_within_s is {self.resume_within_s:g}: take at least "
                f"command_max_age_s, {self.command_max_age_s:g}"
            )
        for name in ("approach_m_s", "slow_m_s"):
            if getattr(self, name) > self.speed_m_s:
                raise ValueError(
                    f"safety.{name} is {getattr(self, name):g}: take at most speed_m_s, "
                    f"{self.speed_m_s:g}"
                )


class Hold(StrEnum):
    """Why the robot holds still; empty: it follows the hand. A comment says what the operator does.

    docs/troubleshooting.md shows these comments.
    """

    NONE = ""
    #: Release the stop, switch the robot on, then press anew.
    STOPPED = "emergency stop"
    #: Press the dead-man button, and keep it pressed.
    RELEASED = "the dead-man button is released"
    #: Wait: the link brings no command. After a longer gap press anew.
    NO_COMMAND = "no command"
    #: Let the dead-man button go, and press it anew.
    STARTED = "the robot has started"
    #: Let the dead-man button go, and press it anew.
    JOYSTICK_STARTED = "the joystick has started"
    #: Wait for contact, then press anew.
    LOST = "the commands were missing"
    #: Start the joystick, and read the cause of its state in the panel Joystick; then press anew.
    INACTIVE = "the joystick was not in the application"
    #: Wait until the robot is handed to you, then press anew.
    OWNER = "another owner"
    #: Switch the robot on, then press anew.
    OFF = "the robot was off"
    #: Look where the new camera looks, then press anew.
    CAMERA = "another camera"
    #: Wait until the picture is no more STALE, then press anew.
    PICTURE = "the operator's picture was too old"
    #: Wait until the path is faster, then press anew.
    AGE = "the commands were too old"


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyMetrics:
    """The safety envelope at the robot (docs/safety.md)."""

    #: Why the robot holds still now; empty: it follows the hand.
    hold: Newest[Hold] = Hold.NONE
    #: Since when: session time in the report, else this machine's clock.
    since_s: Newest[float] = 0.0
    #: Whether it waits for a new press of the dead-man button.
    waiting: Newest[bool] = False
    #: The robot's place less the hand's at the newest press.
    offset_mm: Newest[tuple[float, float]] = (0.0, 0.0)
    #: How old the commands are at most that the robot gets, since the hand.
    command_age_ms: Newest[float | None] = None
    #: New presses with which motion began.
    presses: int = 0
    #: Drop-outs after which motion resumed by itself.
    resumed: int = 0
    #: Emergency stops.
    stops: int = 0
    #: Stops, releases, and what the robot refused: the newest 200 since its process began.
    events: Newest[tuple[AuthorityEvent, ...]] = ()


class SafetyEnvelope:
    """The state of one robot's envelope. It starts without a press, so nothing moves at first.

    stopped: an emergency stop of an earlier start holds; then `handle_stop` says who ordered it.

    hold, since_ns: why the robot holds still, and since when.
    waiting: a new press is missing. barred: why a press would not count now; NONE: it would.
    offset_m: the robot's place less the hand's, taken at the newest press.
    speed_m_s: the limit of the reference's speed now.
    blind: the caller sets it while it knows that what the operator sees is too old, such as half of
    a merged picture; the commands say the rest.
    command_age_ns: how old the newest command is at most, since the hand; for the caller to set.
    None: nobody knows, as of a joystick that returns no echoes.
    delay_ns: of the radio, there and back.
    """

    def __init__(
        self,
        limits: SafetyLimits | None = None,
        *,
        stopped: bool = False,
        now_ns: int = 0,
        delay_ns: int = 0,
    ) -> None:
        self.limits = limits = limits or SafetyLimits()
        self._resume_ns = round(limits.resume_within_s * NS_PER_S)
        self._picture_hold_ns = round(limits.picture_hold_s * NS_PER_S)
        self._hand_max_ns = round(limits.hand_max_age_s * NS_PER_S) + delay_ns
        self.command_age_ns: int | None = None
        self.stopped, self._by = stopped, ""
        self._events: deque[AuthorityEvent] = deque(maxlen=200)
        self.blind = False
        self.hold = Hold.STARTED
        self.barred = Hold.NO_COMMAND
        self.since_ns = now_ns
        self.offset_m = (0.0, 0.0)
        self.speed_m_s = limits.speed_m_s
        self.presses = self.resumed = self.stops = 0
        #: Why a new press is needed; NONE: it has come.
        self._cause = Hold.STARTED
        #: The button was seen released since, so the next press counts.
        self._released = False
        self._heard_ns = now_ns
        self._off = False
        #: The newest command has the emergency stop's bit.
        self._asserted = False
        self._silent = True
        self._approaching = False
        #: Since when the operator's picture has been too old.
        self._blind_ns: int | None = None

    @property
    def stopped_by(self) -> str:
        """Who orders the stop that holds it; a joystick's, also after a release elsewhere."""
        return self._by or SOMEBODY if self.stopped else JOYSTICK if self._asserted else ""

    @property
    def waiting(self) -> bool:
        """Whether nothing moves before a new press."""
        return self._cause is not _NONE

    def require_press(self, cause: Hold) -> None:
        """Something interrupted: hold still until a new press. The first cause is kept."""
        if self._cause in (_NONE, Hold.RELEASED):
            self._cause = cause
        self._released = False

    def handle_off(self, command: Command | None, now_ns: int) -> None:
        """The robot is off, or follows a mode of its own, in this cycle.

        A press that comes meanwhile counts once it is on.
        """
        if not self._off:
            self._off = True
            self.require_press(Hold.OFF)
        self._may_follow(command, now_ns)
        self._silent = command is None
        self.barred = Hold.STOPPED if self.stopped else Hold.OFF
        self._set_hold(self.barred, now_ns)

    def handle_stop(self, now_ns: int, by: str = "") -> None:
        """Stop the robot, and latch."""
        if not self.stopped:
            self.stopped = True
            self.stops += 1
            self._set_hold(Hold.STOPPED, now_ns)
        if not self._by:
            self._by = by or SOMEBODY
            self.add_event(f"emergency stop by {self._by}", now_ns)
        self._cause, self._released = Hold.STOPPED, False

    def handle_stop_released(self, now_ns: int, by: str = "") -> str:
        """Release the emergency stop; return "", or why not. Motion needs a new press.

        A joystick that still orders a stop is followed no more either, until it releases its own.
        """
        if not self.stopped:
            return "no emergency stop holds the robot"
        self.add_event(f"{by or SOMEBODY} released the emergency stop by {self._by}", now_ns)
        self.stopped, self._by = False, ""
        self._cause, self._released = Hold.STOPPED, False
        return ""

    def add_event(self, what: str, now_ns: int) -> None:
        self._events.append(AuthorityEvent(now_ns, what))

    def admit(self, command: Command | None, x_m: float, y_m: float, now_ns: int) -> Command | None:
        """Return the command that the controller may follow.

        command: the newest, or None if none is fresh. x_m, y_m: the controller's reference.
        """
        self._off = False
        if not self._may_follow(command, now_ns):
            self._silent = command is None
            otherwise = Hold.NO_COMMAND if command is None else Hold.RELEASED
            self._set_hold(self._waits_for(otherwise), now_ns)
            return None if command is None else command._replace(dead_man=False)
        assert command is not None
        hand_x, hand_y = command[0], command[1]
        if self._cause is not _NONE:
            self._cause = _NONE
            self._approaching = False
            self.offset_m = (x_m - hand_x, y_m - hand_y)
            self.presses += 1
        elif self._silent:
            self._approaching = True
            self.resumed += 1
        self._silent = False
        offset_x, offset_y = self.offset_m
        to_x, to_y = hand_x + offset_x, hand_y + offset_y
        limits = self.limits
        speed_m_s = limits.speed_m_s
        if self._approaching:
            if abs(to_x - x_m) < _CAUGHT_UP_M and abs(to_y - y_m) < _CAUGHT_UP_M:
                self._approaching = False
            else:
                speed_m_s = limits.approach_m_s
        if self._blind_ns is not None and speed_m_s > limits.slow_m_s:
            speed_m_s = limits.slow_m_s
        self.speed_m_s = speed_m_s
        if self.hold is not _NONE:
            self._set_hold(_NONE, now_ns)
        return _tuple(Command, (to_x, to_y, *command[2:]))

    def report(self) -> SafetyMetrics:
        """Return what holds the robot, why, since when, and the counts."""
        x_m, y_m = self.offset_m
        age_ns = self.command_age_ns
        return SafetyMetrics(
            hold=self.hold,
            since_s=round(self.since_ns / NS_PER_S, 3),
            waiting=self.waiting,
            offset_mm=(round(x_m * 1e3, 1), round(y_m * 1e3, 1)),
            command_age_ms=None if age_ns in (None, ANY_AGE_NS) else round(age_ns / NS_PER_MS, 1),
            presses=self.presses,
            resumed=self.resumed,
            stops=self.stops,
            events=tuple(self._events),
        )

    def _may_follow(self, command: Command | None, now_ns: int) -> bool:
        """Take a cycle's command; return whether the hand may lead now."""
        if now_ns - self._heard_ns > self._resume_ns:
            # Also if this process was stopped itself, and the newest command came just now.
            self.require_press(Hold.LOST)
        if command is None:
            self.barred = Hold.NO_COMMAND
            return False
        self._heard_ns = now_ns
        self.barred = Hold.STOPPED if self.stopped else _NONE
        _, _, _, pressed, state, _, _, halted, stop, blind, _ = command
        if stop and not self._asserted:
            self.handle_stop(now_ns, JOYSTICK)
        # It is released here and there; until then its hand leads nothing.
        self._asserted = stop
        if stop:
            self._released, self.barred = False, Hold.STOPPED
            return False
        if state != STATE_APPLICATION or halted:
            self.require_press(Hold.INACTIVE)
            self.barred = Hold.INACTIVE
            return False
        age_ns = self.command_age_ns
        if age_ns is not None and age_ns > self._hand_max_ns:
            self.barred = Hold.AGE
            if self._cause in (_NONE, Hold.RELEASED, Hold.AGE):
                self.require_press(Hold.AGE)
            elif not pressed:
                # A press after a gap counts once its age is known.
                self._released = True
            return False
        if blind or self.blind or self._blind_ns is not None:
            self._handle_picture(blind or self.blind, now_ns)
        if not pressed:
            self._released = True
            if self._cause is _NONE:
                self._cause = Hold.RELEASED
            return False
        return not self.stopped and (self._cause is _NONE or self._released)

    def _handle_picture(self, blind: bool, now_ns: int) -> None:
        if not blind:
            self._blind_ns = None
        elif self._blind_ns is None:
            self._blind_ns = now_ns
        elif now_ns - self._blind_ns >= self._picture_hold_ns:
            self.require_press(Hold.PICTURE)
            self.barred = Hold.PICTURE

    def _waits_for(self, otherwise: Hold) -> Hold:
        if self.stopped:
            return Hold.STOPPED
        return otherwise if self._cause is _NONE else self._cause

    def _set_hold(self, hold: Hold, now_ns: int) -> None:
        if hold is not self.hold:
            self.hold, self.since_ns = hold, now_ns


_NONE = Hold.NONE
#: Skips `Command.__new__`, which is one more Python call a thousand times a second.
_tuple = tuple.__new__
