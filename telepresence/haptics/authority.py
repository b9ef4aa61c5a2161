"""Who drives what: the robot's haptic port one joystick, and the joystick one robot; never two.

Stelzer et al. 2017, section 7: a gateway application lets the partner institute steer the robot in
the place of the ISS. Here that is one explicit state at the robot; docs/webrtc.md has its rules. In
each cycle: ask `takes` for each datagram, then call `handle_robot`.

In the partner institute's experiments the data goes directly between space and its own task board.
The first greeting for the other robot ends the present ownership: our robot comes to rest before
the partner's is reached, or vice versa (`PartnerBoard`).

A partner is not trusted. Only datagrams of a feedback's size and direction are passed on, at most
one a cycle; the joystick's link and its controller judge the rest.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.metrics import Newest
from telepresence.haptics.axes import may_be_sample
from telepresence.haptics.sample import (
    FLAG_FEEDBACK,
    SAMPLE_OCTETS,
    is_greeting,
    read_command,
    read_feedback,
    read_greeting,
)

#: The tip rests for this long before the port changes hands.
REST_NS = 300 * NS_PER_MS
#: Slower than this it rests.
REST_SPEED_M_S = 0.005
#: How many events are kept.
_DEPTH = 200


class Authority(Enum):
    """Who can drive the robot."""

    OPERATOR = "operator"
    PARTNER = "partner"


@dataclass(frozen=True, slots=True)
class AuthorityEvent:
    """Something that happened, in words, at `at_ns`."""

    at_ns: int
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class AuthorityMetrics:
    """Who drives the robot, where a partner may, too (docs/webrtc.md)."""

    #: `operator` or `partner`; null: nobody.
    authority: Newest[Authority] | None
    #: Who was to drive.
    wanted: Authority
    #: Changes of the authority, the start included.
    turns: int
    #: Datagrams of a sender that did not drive, by sender.
    refused: Mapping[str, int]
    #: The newest 200.
    events: tuple[AuthorityEvent, ...]
    #: Malformed datagrams of the partner's robot, dropped.
    garbage: int = 0


class ControlAuthority:
    """The state of one robot's port.

    authority: whose datagrams are taken; None: nobody's.

    authority, wanted: at the start. A robot that starts again begins with None and the one that
    it had.
    """

    def __init__(
        self,
        authority: Authority | None = Authority.OPERATOR,
        *,
        wanted: Authority = Authority.OPERATOR,
    ) -> None:
        self.authority = authority
        self.wanted = wanted
        self._rest_ns: int | None = None
        self._turns = 0
        self._refused = dict.fromkeys(Authority, 0)
        self.garbage = 0
        self._events: deque[AuthorityEvent] = deque(maxlen=_DEPTH)

    def handle_order(self, wanted: Authority, now_ns: int) -> None:
        """An operator wants `wanted` to drive. To order the same again changes nothing."""
        if wanted is self.wanted:
            return
        self.wanted = wanted
        if self.authority is not None:
            self.authority = None
            self._rest_ns = None
        self._note(f"handing over to {wanted.value}", now_ns)

    def takes(self, source: Authority) -> bool:
        """Return whether to take a datagram of `source`; one that is not taken is counted."""
        if source is self.authority:
            return True
        self._refused[source] += 1
        return False

    def handle_robot(self, speed_m_s: float, now_ns: int) -> bool:
        """The tip moves at this speed; return whether the port has just changed hands."""
        if self.authority is not None:
            return False
        if self._rest_ns is None or speed_m_s > REST_SPEED_M_S:
            self._rest_ns = now_ns
        if now_ns - self._rest_ns < REST_NS:
            return False
        self.authority = self.wanted
        self._turns += 1
        self._note(f"{self.authority.value} drives", now_ns)
        return True

    def report(self) -> AuthorityMetrics:
        """Return the state, the counts and the newest events."""
        return AuthorityMetrics(
            authority=self.authority,
            wanted=self.wanted,
            turns=self._turns,
            refused={authority.value: count for authority, count in self._refused.items()},
            events=tuple(self._events),
            garbage=self.garbage,
        )

    def _note(self, what: str, now_ns: int) -> None:
        self._events.append(AuthorityEvent(now_ns, what))


#: Without a sample for this long, the partner's robot is not there.
_SILENT_NS = 500 * NS_PER_MS


class PartnerSeen(NamedTuple):
    """The partner's robot while the joystick drives it.

    x_m, y_m: where the joystick wants it; its samples do not say where it is. fx_n, fy_n: the force
    of its surroundings. age_ns: of its newest sample.
    """

    x_m: float
    y_m: float
    fx_n: float
    fy_n: float
    contact: bool
    dead_man: bool
    age_ns: int


class PartnerBoard:
    """Call `handle_joystick` and `handle_partner` for each datagram, then the two `poll_`.

    ownership: of the joystick's port. `OPERATOR`: it drives our robot; `PARTNER`: it drives
    the partner's. `RobotSide` says when our robot rests.
    """

    def __init__(self, ownership: ControlAuthority) -> None:
        self.ownership = ownership
        self._heard_ns: int | None = None
        self._to_partner: bytes | None = None
        self._to_joystick: bytes | None = None
        #: The newest samples of both, while the partner's robot is driven.
        self._wanted = self._felt = b""

    @property
    def left_out(self) -> bool:
        """Whether our robot must be off: it is not certain that the joystick asks for it."""
        return self.ownership.authority is not Authority.OPERATOR

    def handle_joystick(self, data: bytes, now_ns: int) -> bool:
        """A datagram of the joystick in space came; return whether it is for our robot."""
        ownership = self.ownership
        # Behind these octets are zeros, one axis after the other.
        if is_greeting(head := data[:SAMPLE_OCTETS]):
            try:
                partner = read_greeting(head, feedback=False).partner
            except ProtocolError:
                # Our link counts it.
                return not self.left_out
            ownership.handle_order(Authority.PARTNER if partner else Authority.OPERATOR, now_ns)
        if ownership.authority is Authority.PARTNER:
            self._to_partner = data
            if not is_greeting(head):
                self._wanted = head
            return False
        self._wanted = self._felt = b""
        return ownership.takes(Authority.OPERATOR)

    def handle_partner(self, data: bytes, now_ns: int) -> None:
        """A datagram of the partner's robot came. Garbage is counted; this never raises."""
        if not may_be_sample(data) or not data[2] & FLAG_FEEDBACK:
            self.ownership.garbage += 1
            return
        self._heard_ns = now_ns
        if self.ownership.authority is Authority.PARTNER:
            self._to_joystick = data
            # What is behind these octets is of the axes behind x and y.
            if not is_greeting(head := data[:SAMPLE_OCTETS]):
                self._felt = head

    def is_there(self, now_ns: int) -> bool:
        """Whether the partner's robot is heard."""
        return self._heard_ns is not None and now_ns - self._heard_ns <= _SILENT_NS

    def seen(self, now_ns: int) -> PartnerSeen | None:
        """What samples say of the partner's robot; None while it is not driven or not heard."""
        if self.state(now_ns) != "driven" or self._heard_ns is None:
            return None
        try:
            *_, wanted = read_command(self._wanted)
            *_, felt = read_feedback(self._felt)
        except ProtocolError:
            return None
        return PartnerSeen(
            x_m=wanted.x_m,
            y_m=wanted.y_m,
            fx_n=felt.fx_n,
            fy_n=felt.fy_n,
            contact=felt.contact,
            dead_man=wanted.dead_man,
            age_ns=now_ns - self._heard_ns,
        )

    def state(self, now_ns: int) -> str:
        """The partner's robot in a word, as telemetry has it."""
        if not self.is_there(now_ns):
            return "absent"
        return "driven" if self.ownership.authority is Authority.PARTNER else "ready"

    def poll_partner(self, *, stopped: bool) -> bytes | None:
        """Return the newest datagram for the partner's robot, or None; None while stopped here."""
        data, self._to_partner = self._to_partner, None
        return None if stopped else data

    def poll_joystick(self) -> bytes | None:
        """Return the newest datagram of the partner's robot for the joystick, or None."""
        data, self._to_joystick = self._to_joystick, None
        return data
