"""One end of the haptic exchange at 1 kHz. There is no queue: the newest sample wins."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from telepresence.haptics.deadband import Deadband, command_deadband, feedback_deadband
from telepresence.haptics.figures import HapticLinkFigures
from telepresence.haptics.sample import (
    FLAG_HOLDING,
    SEQUENCE_MODULUS,
    Command,
    Feedback,
    pack_command,
    pack_feedback,
    read_command,
    read_feedback,
)
from telepresence.haptics.schedule import PeriodicSchedule

__all__ = [
    "HapticLink",
    "PeerFound",
    "PeerLost",
    "PeerRestarted",
    "PeriodicSchedule",
    "joystick_link",
    "robot_link",
]

Out = TypeVar("Out")
In = TypeVar("In")

#: Without a sample for this long, the peer counts as silent: 20 slots.
MAX_AGE_NS = 20 * NS_PER_MS

#: Up to this many numbers behind the newest, late and repeated samples are told apart.
_WINDOW = 64
_WINDOW_MASK = (1 << _WINDOW) - 1

#: How far a number may run ahead of the time that passed, because paths deliver in bursts.
_SLACK = 1000

#: After this many consecutive samples outside every plausible delay, assume that the peer restarted
#: (RFC 3550 appendix A.1 asks for two; a third costs 1 ms and avoids false alarms).
_RESTART_RUN = 3

#: Stamps kept for a latency meter; beyond that the oldest are dropped.
_STAMPS_DEPTH = 8192


@dataclass(frozen=True, slots=True)
class PeerFound:
    """Samples arrive, for the first time or again; noticed at `now_ns`."""

    now_ns: int


@dataclass(frozen=True, slots=True)
class PeerLost:
    """No sample since `last_ns`; noticed at `now_ns`."""

    now_ns: int
    last_ns: int


@dataclass(frozen=True, slots=True)
class PeerRestarted:
    """The peer's sequence numbers began again; noticed at `now_ns`."""

    now_ns: int


HapticEvent = PeerFound | PeerLost | PeerRestarted


class HapticLink(Generic[Out, In]):
    """Sends one kind of sample and receives the other; see `joystick_link` and `robot_link`.

    In each cycle: call `handle_datagram` for every datagram received, pass `latest` to the
    controller, pass its answer to `handle_local`, then send what `poll_transmit` returns.

    deadband: leaves out samples whose difference the peer would not feel. A sample left out has no
    sequence number, so it does not count as lost.

    Counters:
    sent: samples sent.
    received: samples that were the newest when they arrived.
    late: samples older than the newest; not used.
    repeated: samples seen before, or older than the first.
    garbage: datagrams that are no valid sample.
    restarts: restarts of the peer.
    lost: sequence numbers not received so far; a late arrival reduces it.

    peer_holds: the newest sample says that the peer receives nothing from this end.
    """

    def __init__(
        self,
        pack: Callable[[int, Out, bool], bytes],
        unpack: Callable[[bytes], tuple[int, int, In]],
        *,
        max_age_ns: int = MAX_AGE_NS,
        deadband: Deadband | None = None,
    ) -> None:
        self.max_age_ns = max_age_ns
        self.deadband = deadband
        self.sent = 0
        self.received = 0
        self.late = 0
        self.repeated = 0
        self.garbage = 0
        self.restarts = 0
        self.lost = 0
        self.peer_holds = False
        self._pack: Callable[[int, Out, bool], bytes] = pack
        self._unpack: Callable[[bytes], tuple[int, int, In]] = unpack
        self._local: Out | None = None
        self._newest: In | None = None
        self._newest_ns = 0
        self._newest_sequence = 0
        self._seen = 0
        self._strange_sequence = -1
        self._strange_run = 0
        self._hearing = False
        self._events: deque[HapticEvent] = deque(maxlen=64)
        # Each kept object would take memory that no cache holds, so keep few: numbers sent follow
        # from `sent`; what was received is stored flat as sequence number, instant, ...
        self._sent_ns: deque[int] = deque(maxlen=_STAMPS_DEPTH)
        self._received_stamps: deque[int] = deque(maxlen=2 * _STAMPS_DEPTH)

    def handle_local(self, value: Out, now_ns: int) -> None:
        """Set the value to send next; it replaces one that was not sent yet."""
        self._local = value

    def handle_datagram(self, data: bytes, now_ns: int) -> None:
        """A datagram arrived. Garbage is counted; this never raises."""
        try:
            sequence, flags, value = self._unpack(data)
        except ProtocolError:
            self.garbage += 1
            return
        due = (self._newest_sequence + 1) % SEQUENCE_MODULUS
        if sequence == due and self._newest is not None:
            self._newest_sequence = sequence
            if self._seen != _WINDOW_MASK:
                self._seen = (self._seen << 1 | 1) & _WINDOW_MASK
            self._strange_run = 0
            accepted = True
        else:
            accepted = self._accept(sequence, now_ns)
        if accepted:
            self.received += 1
            self.peer_holds = bool(flags & FLAG_HOLDING)
            self._newest = value
            self._newest_ns = now_ns
            stamps = self._received_stamps
            stamps.append(sequence)
            stamps.append(now_ns)
            if not self._hearing:
                self._hearing = True
                self._events.append(PeerFound(now_ns))

    def latest(self, now_ns: int) -> In | None:
        """The newest sample, or None if there is none or it is older than `max_age_ns`."""
        if self._newest is None or now_ns - self._newest_ns > self.max_age_ns:
            return None
        return self._newest

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the 12 octets to send now, or None.

        None: there is nothing new since the last call, or nothing that the peer would feel.
        """
        if self._hearing and now_ns - self._newest_ns > self.max_age_ns:
            self._hearing = False
            self._events.append(PeerLost(now_ns, self._newest_ns))
        local = self._local
        if local is None:
            return None
        deadband = self.deadband
        if deadband is not None:
            local = deadband.handle_sample(local, not self._hearing, now_ns)
            if local is None:
                self._local = None
                return None
        sequence = self.sent % SEQUENCE_MODULUS
        data = self._pack(sequence, local, not self._hearing)
        self._local = None
        self.sent += 1
        self._sent_ns.append(now_ns)
        return data

    def poll_timeout(self) -> int | None:
        """When to call `poll_transmit` even without a value to send, or None."""
        return self._newest_ns + self.max_age_ns + 1 if self._hearing else None

    def next_event(self) -> HapticEvent | None:
        """The oldest event that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def take_sent_stamps(self) -> list[tuple[int, int]]:
        """Take (sequence, instant in ns) of the samples sent since the last call."""
        first = self.sent - len(self._sent_ns)
        taken = [
            (sequence % SEQUENCE_MODULUS, instant_ns)
            for sequence, instant_ns in enumerate(self._sent_ns, first)
        ]
        self._sent_ns.clear()
        return taken

    def take_received_stamps(self) -> list[tuple[int, int]]:
        """Take (sequence, instant in ns) of the samples received since the last call.

        Only samples that were the newest on arrival have a stamp.
        """
        flat = iter(self._received_stamps)
        taken = list(zip(flat, flat, strict=True))
        self._received_stamps.clear()
        return taken

    def report(self) -> HapticLinkFigures:
        """Return the counters."""
        return HapticLinkFigures(
            sent=self.sent,
            received=self.received,
            lost=self.lost,
            late=self.late,
            repeated=self.repeated,
            garbage=self.garbage,
            restarts=self.restarts,
            left_out=None if self.deadband is None else self.deadband.left_out,
        )

    def _accept(self, sequence: int, now_ns: int) -> bool:
        """Whether to use a sample whose number is not the next one."""
        if self._newest is None:
            self._begin(sequence)
            return True
        ahead = (sequence - self._newest_sequence) % SEQUENCE_MODULUS
        if ahead == 0:
            self.repeated += 1
            return False
        if ahead > SEQUENCE_MODULUS - _WINDOW:
            self._count_late(SEQUENCE_MODULUS - ahead)
            return False
        # The peer sends at most one sample a millisecond, so time bounds how far it can be ahead.
        if ahead <= (now_ns - self._newest_ns) // NS_PER_MS + _SLACK:
            self.lost += ahead - 1
            self._newest_sequence = sequence
            self._seen = ((self._seen << ahead) | 1) & _WINDOW_MASK if ahead < _WINDOW else 1
            self._strange_run = 0
            return True
        return self._probe(sequence, now_ns)

    def _begin(self, sequence: int) -> None:
        self._newest_sequence = sequence
        # Nothing before the first sample is missing, so all of it counts as seen.
        self._seen = _WINDOW_MASK
        self._strange_run = 0

    def _count_late(self, behind: int) -> None:
        bit = 1 << behind
        if self._seen & bit:
            self.repeated += 1
        else:
            self._seen |= bit
            self.late += 1
            self.lost -= 1

    def _probe(self, sequence: int, now_ns: int) -> bool:
        follows = sequence == (self._strange_sequence + 1) % SEQUENCE_MODULUS
        self._strange_run = self._strange_run + 1 if follows and self._strange_run else 1
        self._strange_sequence = sequence
        if self._strange_run < _RESTART_RUN:
            self.late += 1
            return False
        self._begin(sequence)
        self.restarts += 1
        self._events.append(PeerRestarted(now_ns))
        return True


def joystick_link(
    *, max_age_ns: int = MAX_AGE_NS, deadband: bool = False
) -> HapticLink[Command, Feedback]:
    """Return the joystick's end: it sends commands and receives feedback."""
    band = command_deadband() if deadband else None
    return HapticLink(pack_command, read_feedback, max_age_ns=max_age_ns, deadband=band)


def robot_link(
    *, max_age_ns: int = MAX_AGE_NS, deadband: bool = False
) -> HapticLink[Feedback, Command]:
    """Return the robot's end: it sends feedback and receives commands."""
    band = feedback_deadband() if deadband else None
    return HapticLink(pack_feedback, read_command, max_age_ns=max_age_ns, deadband=band)
