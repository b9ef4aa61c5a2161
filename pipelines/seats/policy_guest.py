"""A policy at the seat that has the handle. A core.

It joins the seat as a page does, presses the dead-man button once, from where the robot is, and any
person takes the handle from it. After an interruption it lets go until a person hands over anew.
"""

from collections import Counter, deque
from collections.abc import Iterator, Sequence

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.returned import one_line
from pipelines.hand.hand_topics import DriverState, JoystickStatus
from pipelines.seats.holders import HandleAuthority
from telepresence.haptics.authority import AuthorityEvent
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.policy import Place, PolicyAxis, PolicyMessage
from telepresence.haptics.device.states import JoystickEvent, JoystickState

#: The robot rests for this long before the press, and has this long to wait for it or to follow.
_HOLD_NS, _PATIENCE_NS = 200 * NS_PER_MS, 5 * NS_PER_S
#: For so long the device goes on without us, and without the joystick's state; it tells that every
#: 100 ms. A program that says nothing for longer is gone.
_KEEPS_NS, _SILENT_NS, _GONE_NS = 500 * NS_PER_MS, NS_PER_S, 2 * NS_PER_S
#: The handle's greatest speed, in half ranges a second: about 0.3 m/s. Chosen.
_HALVES_S = 2.0
_MOST_STEP_NS = 50 * NS_PER_MS


#: Where pages do not move the joystick: the number of the person who does.
PERSON = 0


class PolicyGuest:
    """The policy that is there, if any. Call `poll` every 10 ms while `name` is not empty.

    numbers: of the seat's pages; a policy that comes takes the next one. device: of a joystick that
    no page moves; "" if one does. Its person has the handle while the dead-man button is pressed.
    name: of the policy. events: who drove, and why a policy let go. driven_ns: for how long a
    `person` and a `policy` had the handle.
    """

    def __init__(
        self,
        axes: Sequence[PolicyAxis],
        ownership: HandleAuthority,
        numbers: Iterator[int],
        *,
        device: str = "",
    ) -> None:
        self._axes, self._ownership, self._numbers = axes, ownership, numbers
        self._device = device
        if device:
            ownership.handle_joined(PERSON, f"the joystick {device}")
        self.name = ""
        #: It has the handle, then presses the dead-man button.
        self._turn = self._pressed = False
        self._wanted: Place = ()
        self.events: deque[AuthorityEvent] = deque(maxlen=50)
        self.driven_ns: Counter[str] = Counter()
        self._message = PolicyMessage("", 0, (), 0)
        self._status: JoystickStatus | None = None
        self._told_ns = self._gone_ns = self._polled_ns = self._sequence = 0
        #: Since when the robot rests, or is to follow. Then the joystick and it have answered.
        self._since_ns = 0
        self._held = self._follows = False
        #: At the press: where the robot was, and the handle in shares. Then where the handle is.
        self._from: Place = ()
        self._zero: list[float] = []
        self._shares: list[float] = []

    @property
    def who(self) -> str:
        """Who has the handle; "" for nobody."""
        return self._ownership.name(self._ownership.state.holder)

    @property
    def state(self) -> DriverState:
        return DriverState(
            who=self.who,
            policy="" if self._message.shadow else self.name,
            drives=self._pressed,
            axes=tuple(axis.name for axis in self._axes),
            wanted=self._wanted,
        )

    def handle_message(self, message: PolicyMessage, now_ns: int) -> None:
        """Take what a program says; of a second one nothing while the first is there."""
        if self.name and message.program != self._message.program:
            return
        if not self.name:
            name = one_line(message.name)[:40] or "policy"
            self.name, self._ownership.policy = name, next(self._numbers)
            self._ownership.handle_joined(self._ownership.policy, f"the policy {name}")
        if not message.fits(len(self._axes), now_ns):
            message = message._replace(places=(), fault=message.fault or "malformed action")
        self._gone_ns, self._message = now_ns + _GONE_NS, message

    def handle_status(self, status: JoystickStatus, now_ns: int) -> None:
        """The joystick has told its state; by a telecommand it hands over."""
        before, self._status, self._told_ns = self._status, status, now_ns
        if self._device and status.person:
            self._ownership.handle_take(PERSON)
        elif self._device:
            self._ownership.handle_give(PERSON)
        if before is not None and before.handed != status.handed:
            if status.handed[1] == JoystickEvent.PERSON.value:
                self._ownership.handle_give(self._ownership.policy)
            elif why := self.handle_let(None, now_ns):
                self._note(f"telecommand refused: {why}", now_ns)

    def handle_let(self, page: int | None, now_ns: int) -> str:
        """A person at `page` lets the policy drive; None: by a telecommand. Return why not."""
        why = self._hindrance(now_ns) if self.name else "none is there"
        return f"policy: {why}" if why else self._ownership.handle_let(page)

    def handle_back(self) -> str:
        """A person at a page, which moves no joystick, ends the policy's turn; return why not."""
        refusal = self._ownership.handle_give(self._ownership.policy)
        return f"the joystick {self._device} steers" if refusal else ""

    def settle(self, now_ns: int) -> None:
        """See whether the handle has changed hands."""
        owner = self._ownership
        holds = owner.policy is not None and owner.may_move(owner.policy)
        if holds and not self._turn:
            self._turn, self._since_ns = True, now_ns
            self._note(f"the policy {self.name} drives", now_ns)
        elif self._turn and not holds:
            self._end(f"{self.who or 'a person'} took the handle", now_ns)

    def poll(self, now_ns: int) -> tuple[int, PageInput] | None:
        """Return the policy's number and what its hand does, or None."""
        step_ns, self._polled_ns = now_ns - (self._polled_ns or now_ns), now_ns
        if self.who:
            self.driven_ns["policy" if self._turn else "person"] += step_ns
        message, status, number = self._message, self._status, self._ownership.policy
        self._wanted = message.place_at(now_ns)
        if self._turn and (why := self._hindrance(now_ns) or self._interruption(now_ns)):
            self._end(why, now_ns)
        if number is None or status is None or not self._turn:
            if number is not None and now_ns >= self._gone_ns:
                self._ownership.handle_gone(number)
                self.name, self._ownership.policy = "", None
            return None
        rests = min(message.seen_ns, self._told_ns) > self._since_ns + _HOLD_NS
        if self._pressed:
            self._move(_HALVES_S * min(step_ns, _MOST_STEP_NS) / NS_PER_S)
        elif rests and status.robot_waits and not status.dead_man:
            handle = {"x": status.x_m, "y": status.y_m}
            handle |= {axis.name: axis.position for axis in status.axes}
            self._pressed, self._since_ns, self._from = True, now_ns, message.seen
            self._zero = [_cut(handle.get(axis.name, 0.0) / axis.half) for axis in self._axes]
            self._shares = list(self._zero)
        shares = dict(zip((axis.name for axis in self._axes), self._shares, strict=False))
        x, y, self._sequence = shares.pop("x", 0.0), shares.pop("y", 0.0), self._sequence + 1
        more = tuple(shares.values())
        place = (self._pressed, x, y, 0, self._sequence, now_ns, message.picture_ns, more)
        return number, PageInput(*place, _KEEPS_NS)

    def _hindrance(self, now_ns: int) -> str:
        """Return why the policy may not have the handle now, or ""."""
        status = self._status
        if not self._message.place_at(now_ns):
            silent = self._message.places
            return "it is silent" if silent else self._message.fault or "it let go"
        if self._message.shadow:
            return "it only watches"
        if status is None or now_ns - self._told_ns > _SILENT_NS:
            return "the joystick is silent"
        if status.robot_stopped:
            return "the emergency stop"
        ready = status.state == JoystickState.APPLICATION
        return "" if ready else "the joystick is not in the application"

    def _interruption(self, now_ns: int) -> str:
        """Return what needs a person since the robot is to rest or to follow, or ""."""
        status = self._status
        if status is None or self._told_ns <= self._since_ns:
            return ""
        if self._held and not status.dead_man:
            # Our own processes were late, and the device let go: hold, and press from there.
            self._pressed, self._since_ns = False, now_ns
        elif self._follows and status.robot_waits:
            return "the robot was interrupted"
        self._held = self._pressed and (self._held or status.dead_man)
        self._follows = self._held and not status.robot_waits
        late = not self._follows and now_ns - self._since_ns > _PATIENCE_NS
        return "the robot does not follow" if late else ""

    def _move(self, most: float) -> None:
        """Move the handle by at most so many shares, to where the robot is wanted."""
        for at, (axis, place) in enumerate(zip(self._axes, self._wanted, strict=True)):
            # In rate mode the handle's deflection is the speed.
            base = self._message.seen[at] if axis.rate else self._from[at]
            turned = (1.0 if axis.scale > 0.0 else -1.0) if axis.rate else axis.scale
            share = (place - base) / (turned * axis.half) + (0.0 if axis.rate else self._zero[at])
            step = _cut(share) - self._shares[at]
            self._shares[at] += max(-most, min(most, step))

    def _end(self, why: str, now_ns: int) -> None:
        self._turn = self._pressed = self._held = self._follows = False
        self._note(f"the policy {self.name} lets go: {why}", now_ns)
        self._ownership.handle_give(self._ownership.policy)

    def _note(self, what: str, now_ns: int) -> None:
        self.events.append(AuthorityEvent(now_ns, what))


def _cut(share: float) -> float:
    return max(-1.0, min(1.0, share))
