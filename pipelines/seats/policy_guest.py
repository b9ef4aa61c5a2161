"""A policy at the seat that has the handle: it joins the pages, and any of them takes it back."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence

from kontur_av.clock import NS_PER_S
from kontur_av.returned import one_line
from pipelines.hand.hand_topics import DriverState, JoystickStatus
from pipelines.seats.holders import HandleAuthority
from telepresence.haptics.authority import AuthorityEvent
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.policy import HeldState, PolicyAxis, PolicyHand, PolicyMessage
from telepresence.haptics.device.states import JoystickEvent, JoystickState

#: A program that says nothing for this long is gone.
_GONE_NS = 2 * NS_PER_S


class PolicyGuest:
    """The policy that is there, if any. A core; call `poll` every 10 ms while `present`.

    numbers: of the seat's pages; each policy that comes takes the next one.
    events: who drove, and why a policy's turn ended. driven_ns: by `person` and `policy`.
    turns: of policies. refused: messages of a second program while one is there.
    """

    def __init__(
        self, axes: Sequence[PolicyAxis], ownership: HandleAuthority, numbers: Iterator[int]
    ) -> None:
        self._hand = PolicyHand(axes)
        self._ownership, self._numbers = ownership, numbers
        self._number: int | None = None
        self._name, self._shadow = "", False
        self._gone_ns = 0
        self._handed: int | None = None
        self.turns = self.refused = 0
        self.driven_ns: Counter[str] = Counter()
        self._polled_ns: int | None = None
        self.events: deque[AuthorityEvent] = deque(maxlen=50)

    @property
    def present(self) -> bool:
        """Whether a program is there."""
        return self._number is not None

    @property
    def name(self) -> str:
        """The policy that may drive; "" for none."""
        return "" if self._shadow else self._name

    @property
    def who(self) -> str:
        """Who has the handle; "" for nobody."""
        return self._ownership.name(self._ownership.state.holder)

    @property
    def state(self) -> DriverState:
        hand = self._hand
        return DriverState(
            who=self.who,
            policy=self.name,
            drives=hand.turn,
            pressed=hand.pressed,
            ended=hand.ended,
            axes=tuple(axis.name for axis in hand.axes),
            wanted=hand.wanted,
        )

    def handle_message(self, message: PolicyMessage, now_ns: int) -> int | None:
        """Take what a program says; return the number of the policy, or None of a second one."""
        name = one_line(message.name)[:40] or "policy"
        if self._number is not None and name != self._name:
            self.refused += 1
            return None
        if self._number is None:
            self._number, self._name = next(self._numbers), name
            self._ownership.handle_joined(self._number, f"the policy {name}", yields=True)
        self._gone_ns, self._shadow = now_ns + _GONE_NS, message.shadow
        self._hand.handle_message(message, now_ns)
        if message.fault:
            self._note(message.fault, now_ns)
        return self._number

    def handle_status(self, status: JoystickStatus, now_ns: int) -> None:
        """The joystick has told its state; by a telecommand it may hand over."""
        by_name = {"x": status.x_m, "y": status.y_m}
        by_name |= {axis.name: axis.position for axis in status.axes}
        places = tuple(by_name.get(axis.name, 0.0) for axis in self._hand.axes)
        ready = status.state == JoystickState.APPLICATION
        stopped, waits = status.robot_stopped, status.robot_waits
        self._hand.handle_held(HeldState(places, ready, status.dead_man, waits, stopped), now_ns)
        handed, to = status.handed
        if self._handed not in (None, handed):
            if to == JoystickEvent.POLICY.value:
                if why := self.handle_let(None, now_ns):
                    self._note(f"telecommand refused: {why}", now_ns)
            elif self._number is not None:
                self._ownership.handle_give(self._number)
        self._handed = handed

    def handle_let(self, page: int | None, now_ns: int) -> str:
        """A person at `page` lets the policy drive; None: by a telecommand. Return why not."""
        if self._number is None:
            return "policy: none is there"
        why = self._hand.hindrance(now_ns)
        return f"policy: {why}" if why else self._ownership.handle_let(page, self._number)

    def settle(self, now_ns: int) -> None:
        """See whether the handle has changed hands."""
        hand, owner = self._hand, self._ownership
        holds = self._number is not None and owner.may_move(self._number)
        if holds and not hand.turn:
            self.turns += 1
            hand.begin(now_ns)
            self._note(f"the policy {self._name} drives", now_ns)
        elif hand.turn and not holds:
            who = owner.name(owner.state.holder)
            hand.end(f"{who} took the handle" if who else "a person took the handle back")
            self._note(f"the policy {self._name} no longer drives: {hand.ended}", now_ns)

    def poll(self, now_ns: int) -> tuple[int, PageInput] | None:
        """Return the policy's number and what its hand does, or None."""
        number, hand = self._number, self._hand
        if self.who:
            kind = "policy" if hand.turn else "person"
            self.driven_ns[kind] += now_ns - (self._polled_ns or now_ns)
        self._polled_ns = now_ns
        if number is None:
            return None
        turned = hand.turn
        hand_input = hand.poll(now_ns)
        if turned and not hand.turn:
            self._note(f"the policy {self._name} let go: {hand.ended}", now_ns)
            self._ownership.handle_give(number)
        if now_ns >= self._gone_ns and not hand.turn:
            self._ownership.handle_gone(number)
            self._number, self._name = None, ""
        return None if hand_input is None else (number, hand_input)

    def _note(self, what: str, now_ns: int) -> None:
        if not self.events or self.events[-1].what != what:
            self.events.append(AuthorityEvent(now_ns, what))
