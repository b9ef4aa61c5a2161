"""Who drives the robot's haptic port: the joystick in space, or a partner's; never both.

Stelzer et al. 2017, section 7: a gateway application lets the partner institute steer the robot in
the place of the ISS. Here that is one explicit state at the robot; docs/rtc.md has its rules.

In each cycle: ask `takes` for each datagram, then call `handle_robot`.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from kontur_av.clock import NS_PER_MS
from kontur_av.figures import Newest

#: The tip rests for this long before the port changes hands.
REST_NS = 300 * NS_PER_MS
#: Slower than this it rests.
REST_SPEED_M_S = 0.005
#: How many events are kept.
_DEPTH = 200


class Owner(Enum):
    """Who can drive the robot."""

    ISS = "iss"
    PARTNER = "partner"


@dataclass(frozen=True, slots=True)
class OwnerEvent:
    """Something that happened, in words, at `at_ns`."""

    at_ns: int
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnershipFigures:
    """Who drives the robot, where a partner may, too (docs/rtc.md)."""

    #: `iss` or `partner`; null: nobody.
    owner: Newest[Owner] | None
    #: Who was to drive.
    wanted: Owner
    #: Changes of the owner, the start included.
    turns: int
    #: Datagrams of a sender that did not drive, by sender.
    refused: Mapping[str, int]
    #: The newest 200.
    events: tuple[OwnerEvent, ...]
    #: Malformed datagrams of the partner's robot, dropped.
    garbage: int = 0


class HapticOwnership:
    """The state of one robot's port.

    owner: whose datagrams are taken; None: nobody's.

    owner, wanted: at the start. A robot that was started again begins with None and the owner that
    it had.
    """

    def __init__(self, owner: Owner | None = Owner.ISS, *, wanted: Owner = Owner.ISS) -> None:
        self.owner = owner
        self.wanted = wanted
        self._rest_ns: int | None = None
        self._turns = 0
        self._refused = dict.fromkeys(Owner, 0)
        self.garbage = 0
        self._events: deque[OwnerEvent] = deque(maxlen=_DEPTH)

    def handle_order(self, wanted: Owner, now_ns: int) -> None:
        """An operator wants `wanted` to drive. To order the same again changes nothing."""
        if wanted is self.wanted:
            return
        self.wanted = wanted
        if self.owner is not None:
            self.owner = None
            self._rest_ns = None
        self._note(f"handing over to {wanted.value}", now_ns)

    def takes(self, source: Owner) -> bool:
        """Return whether to take a datagram of `source`; one that is not taken is counted."""
        if source is self.owner:
            return True
        self._refused[source] += 1
        return False

    def handle_robot(self, speed_m_s: float, now_ns: int) -> bool:
        """The tip moves at this speed; return whether the port has just changed hands."""
        if self.owner is not None:
            return False
        if self._rest_ns is None or speed_m_s > REST_SPEED_M_S:
            self._rest_ns = now_ns
        if now_ns - self._rest_ns < REST_NS:
            return False
        self.owner = self.wanted
        self._turns += 1
        self._note(f"{self.owner.value} drives", now_ns)
        return True

    def report(self) -> OwnershipFigures:
        """Return the state, the counts and the newest events."""
        return OwnershipFigures(
            owner=self.owner,
            wanted=self.wanted,
            turns=self._turns,
            refused={owner.value: count for owner, count in self._refused.items()},
            events=tuple(self._events),
            garbage=self.garbage,
        )

    def _note(self, what: str, now_ns: int) -> None:
        self._events.append(OwnerEvent(now_ns, what))
