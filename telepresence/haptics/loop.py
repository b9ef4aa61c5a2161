"""One end of the haptic exchange at 1 kHz. There is no queue: the newest sample wins."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.metrics import metrics_of
from telepresence.haptics.axes import AxisTotals
from telepresence.haptics.deadband import Deadband, command_deadband, feedback_deadband
from telepresence.haptics.echo import EchoProbe
from telepresence.haptics.haptic_metrics import SamplesReceived, SamplesSent
from telepresence.haptics.sample import (
    FLAG_ECHOES,
    FLAG_HOLDING,
    SAMPLE_OCTETS,
    SEQUENCE_MODULUS,
    UNKNOWN_AGE_MS,
    Command,
    Echo,
    Feedback,
    is_echo,
    is_greeting,
    pack_command,
    pack_echo,
    pack_feedback,
    pack_greeting,
    read_command,
    read_echo,
    read_feedback,
    read_greeting,
)
from telepresence.haptics.session import JoystickSession, RobotSession

Out = TypeVar("Out", bound=Command | Feedback)
In = TypeVar("In", bound=Command | Feedback)

#: Without a sample for this long, the peer counts as silent: 20 slots.
MAX_AGE_NS = 20 * NS_PER_MS

#: A peer that hears nothing for this much longer has met a burst of losses: jitter and single
#: losses make shorter gaps.
_GAP_NS = 20 * NS_PER_MS
_NEVER_NS = 1 << 63

#: Up to this many numbers behind the newest, late and repeated samples are told apart.
_WINDOW = 64
_WINDOW_MASK = (1 << _WINDOW) - 1

#: How far a number may run ahead of the time that passed, because paths deliver in bursts.
_SLACK = 1000
#: Numbers out of that range that follow each other for this long, with none in it, are the peer's
#: present ones: this end, or its path, has stalled.
_REANCHOR_NS = 50 * NS_PER_MS

#: Skips the NamedTuple's own `__new__`, which is one more Python call a thousand times a second.
_tuple = tuple.__new__

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
    """A session began with a new start of the peer; noticed at `now_ns`."""

    now_ns: int


HapticEvent = PeerFound | PeerLost | PeerRestarted


class HapticLink(Generic[Out, In]):
    """Sends one kind of sample and receives the other; see `joystick_link` and `robot_link`.

    In each cycle: call `handle_datagram` for every datagram received, pass `latest` to the
    controller, pass its answer to `handle_local`, then send what `poll_transmit` returns.

    Samples are sent and used only in a session (`session.py`). Until one has begun, a greeting goes
    in the place of each sample.

    session: this end of the session.
    deadband: leaves out samples whose difference the peer would not feel. A sample left out has no
    sequence number, so it does not count as lost. Neither has a greeting.
    more: the number of axes behind x and y.

    The counters are those of `SamplesSent` and `SamplesReceived`.

    newest_sequence: number of the newest sample received. hearing: samples of the peer arrive.
    peer_holds: the newest sample says that the peer receives nothing from this end.
    told_age_ms: of a joystick: how old its commands are at the robot, as the robot says; None
    before it has.
    """

    def __init__(
        self,
        pack: Callable[[int, Out, bool, int, int], bytes],
        unpack: Callable[[bytes], tuple[int, int, int, In]],
        session: JoystickSession | RobotSession,
        *,
        max_age_ns: int = MAX_AGE_NS,
        deadband: Deadband | None = None,
        more: int = 0,
    ) -> None:
        self.max_age_ns = max_age_ns
        self.deadband = deadband
        self.session = session
        self.sent = 0
        self.received = 0
        self.late = 0
        self.repeated = 0
        self.strays = 0
        self.greetings = 0
        self.echoes = 0
        self.garbage = 0
        self.sessions = 0
        self.lost = 0
        self.peer_holds = False
        self._pack: Callable[[int, Out, bool, int, int], bytes] = pack
        self._unpack: Callable[[bytes], tuple[int, int, int, In]] = unpack
        self._robot = isinstance(session, RobotSession)
        self._probe = EchoProbe()
        #: Of a robot: the joystick returns echoes.
        self._echoes = False
        #: Of a joystick: the probe to return.
        self._echo: int | None = None
        self.told_age_ms: int | None = None
        self._axes = AxisTotals(more, robot=self._robot) if more else None
        # Energies in µJ. Sent: of all sessions, and what of it was sent in earlier ones. Received:
        # the most of all sessions, and what of it came in earlier ones.
        self._granted_uj = self._granted_before_uj = 0
        self._heard_uj = self._heard_before_uj = 0
        self._sending = 0
        self._local: Out | None = None
        self._newest: In | None = None
        self._newest_ns = 0
        self._held_ns = _NEVER_NS
        self.newest_sequence = 0
        self._seen = 0
        #: The newest number out of range, and since when such numbers follow each other.
        self._strange = 0
        self._strange_ns = 0
        self.hearing = False
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
        axes, more = self._axes, None
        try:
            if axes is not None:
                if len(data) == SAMPLE_OCTETS + axes.octets:
                    more = axes.read(data[SAMPLE_OCTETS:])
                    data = data[:SAMPLE_OCTETS]
                else:
                    data = b""
            if is_greeting(data):
                self.session.handle_greeting(read_greeting(data, feedback=not self._robot))
                self.greetings += 1
                self._echoes = self._robot and data[2] & FLAG_ECHOES != 0
                return
            if is_echo(data):
                self._handle_echo(*read_echo(data, feedback=not self._robot), now_ns)
                return
            number, sequence, flags, value = self._unpack(data)
        except ProtocolError:
            self.garbage += 1
            return
        if number != self.session.receiving and not self._begin(number, sequence, now_ns):
            self.strays += 1
            return
        due = (self.newest_sequence + 1) % SEQUENCE_MODULUS
        if sequence == due:
            self.newest_sequence = sequence
            if self._seen != _WINDOW_MASK:
                self._seen = (self._seen << 1 | 1) & _WINDOW_MASK
            accepted = True
        else:
            accepted = self._accept(sequence, now_ns)
        self.session.strays = 0
        if accepted:
            self.received += 1
            holds = bool(flags & FLAG_HOLDING)
            if holds and not self.peer_holds:
                # A peer that is heard for the first time, or again, may have missed nothing.
                self._held_ns = now_ns if self.hearing else _NEVER_NS
            if holds and self.deadband is not None and now_ns - self._held_ns >= _GAP_NS:
                self.deadband.handle_gap(now_ns)
            self.peer_holds = holds
            heard_uj = self._heard_before_uj + value.energy_uj
            if heard_uj > self._heard_uj:
                self._heard_uj = heard_uj
            if axes is None or more is None:
                self._newest = _tuple(type(value), (value[0], value[1], heard_uj, *value[3:]))
            else:
                rest = (heard_uj, *value[3:-1], axes.take(more))
                self._newest = _tuple(type(value), (value[0], value[1], *rest))
            self._newest_ns = now_ns
            stamps = self._received_stamps
            stamps.append(sequence)
            stamps.append(now_ns)
            if not self.hearing:
                self.hearing = True
                self._events.append(PeerFound(now_ns))

    def begin_anew(self, *, for_partner: bool) -> None:
        """Of a joystick: leave this robot, and ask another for a session."""
        assert isinstance(self.session, JoystickSession)
        self.session.begin_anew(for_partner=for_partner)
        self.forget_peer()
        # Sequence numbers of one robot mean nothing to the other.
        self._received_stamps.clear()
        # The next session may have the same number, and each joule is granted in one only.
        self._sending = 0

    def forget_peer(self) -> None:
        """The peer talks to another: its numbers begin anew when it comes back."""
        self._newest = self._echo = self.told_age_ms = None
        self.hearing = self.peer_holds = False

    def latest(self, now_ns: int) -> In | None:
        """The newest sample, or None if there is none or it is older than `max_age_ns`."""
        if self._newest is None or now_ns - self._newest_ns > self.max_age_ns:
            return None
        return self._newest

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the octets to send now, a sample or a greeting, or None.

        None: there is nothing new since the last call, or nothing that the peer would feel.
        """
        if self.hearing and now_ns - self._newest_ns > self.max_age_ns:
            self.hearing = False
            self._events.append(PeerLost(now_ns, self._newest_ns))
        local = self._local
        if local is None:
            return None
        session = self.session
        here_uj = self._granted_uj - self._granted_before_uj
        there_uj = self._heard_uj - self._heard_before_uj
        axes = self._axes
        most_uj = max(here_uj, there_uj) if axes is None else max(here_uj, there_uj, axes.most_uj)
        greeting = session.poll_greeting(most_uj, now_ns)
        if greeting is not None:
            self._local = None
            data = pack_greeting(greeting, feedback=self._robot, holding=not self.hearing)
            return data if axes is None else data + bytes(axes.octets)
        if session.sending != self._sending:
            # Each joule is granted in one session only.
            self._sending = session.sending
            self._granted_before_uj = self._granted_uj
            if axes is not None:
                axes.handle_sending()
        echo = self._poll_echo(now_ns)
        if echo is not None:
            self._local = None
            data = pack_echo(echo, self._sending, feedback=self._robot, holding=not self.hearing)
            return data if axes is None else data + bytes(axes.octets)
        deadband = self.deadband
        if deadband is not None:
            local = deadband.handle_sample(local, not self.hearing, now_ns)
            if local is None:
                self._local = None
                return None
        sequence = self.sent % SEQUENCE_MODULUS
        self._granted_uj = local.energy_uj
        data = self._pack(sequence, local, not self.hearing, self._sending, self._granted_before_uj)
        if axes is not None:
            data += axes.pack(local[-1])
        self._local = None
        self.sent += 1
        self._sent_ns.append(now_ns)
        return data

    def command_age_ns(self, now_ns: int) -> int | None:
        """Of a robot: how old the newest command is at most, since the hand.

        None: the joystick returns no echoes.
        """
        return self._probe.age_ns(now_ns) if self._echoes else None

    def poll_timeout(self) -> int | None:
        """When to call `poll_transmit` even without a value to send, or None."""
        return self._newest_ns + self.max_age_ns + 1 if self.hearing else None

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
        """Take the same of the samples received that were the newest on arrival."""
        flat = iter(self._received_stamps)
        taken = list(zip(flat, flat, strict=True))
        self._received_stamps.clear()
        return taken

    def sent_metrics(self) -> SamplesSent:
        """Return the counters of what this end sends."""
        left_out = None if self.deadband is None else self.deadband.left_out
        return SamplesSent(sent=self.sent, left_out=left_out)

    def received_metrics(self) -> SamplesReceived:
        """Return the counters of what comes to this end."""
        return metrics_of(SamplesReceived, self)

    @property
    def restarts(self) -> int:
        return self.session.restarts

    def _handle_echo(self, session: int, echo: Echo, now_ns: int) -> None:
        if session not in (self.session.receiving, self.session.sending):
            self.strays += 1
            return
        self.echoes += 1
        if self._robot:
            self._probe.handle_answer(echo.number, now_ns)
        else:
            self._echo = echo.number
            self.told_age_ms = None if echo.age_ms == UNKNOWN_AGE_MS else echo.age_ms

    def _poll_echo(self, now_ns: int) -> Echo | None:
        if self._robot:
            return self._probe.poll_transmit(now_ns) if self._echoes else None
        number, self._echo = self._echo, None
        return None if number is None else Echo(number)

    def _accept(self, sequence: int, now_ns: int) -> bool:
        """Whether to use a sample whose number is not the next one."""
        ahead = (sequence - self.newest_sequence) % SEQUENCE_MODULUS
        if ahead == 0:
            self.repeated += 1
            return False
        if ahead > SEQUENCE_MODULUS - _WINDOW:
            self._count_late(SEQUENCE_MODULUS - ahead)
            return False
        if ahead > self._furthest(now_ns):
            if not self._is_anchor(sequence, now_ns):
                self.late += 1
                return False
            self.newest_sequence = sequence
            self._seen = _WINDOW_MASK
            return True
        self.lost += ahead - 1
        self.newest_sequence = sequence
        self._seen = ((self._seen << ahead) | 1) & _WINDOW_MASK if ahead < _WINDOW else 1
        return True

    def _begin(self, number: int, sequence: int, now_ns: int) -> bool:
        """Whether session `number` begins with this sample."""
        restarts = self.restarts
        if not self.session.handle_change(number):
            return False
        self.sessions += 1
        self._heard_before_uj = self._heard_uj
        if self._axes is not None:
            self._axes.handle_receiving()
        ahead = (sequence - self.newest_sequence) % SEQUENCE_MODULUS
        restarted = self.restarts != restarts
        if restarted:
            self._events.append(PeerRestarted(now_ns))
        if self._newest is None or restarted or not 0 < ahead <= self._furthest(now_ns):
            # Numbers begin anew. Nothing before the first sample is missing: it counts as seen.
            self.newest_sequence = sequence - 1
            self._seen = _WINDOW_MASK
        return True

    def _is_anchor(self, sequence: int, now_ns: int) -> bool:
        """Whether numbers out of range have followed each other for `_REANCHOR_NS`."""
        step = (sequence - self._strange) % SEQUENCE_MODULUS
        if step >= SEQUENCE_MODULUS - _WINDOW and self._newest_ns < self._strange_ns:
            # Overtaken on the way: the newest of them counts.
            return False
        if not 0 < step <= _WINDOW or self._newest_ns >= self._strange_ns:
            self._strange_ns = now_ns
        self._strange = sequence
        return now_ns - self._strange_ns >= _REANCHOR_NS

    def _furthest(self, now_ns: int) -> int:
        """How far a number can be ahead: the peer sends at most one sample a millisecond."""
        return (now_ns - self._newest_ns) // NS_PER_MS + _SLACK

    def _count_late(self, behind: int) -> None:
        bit = 1 << behind
        if self._seen & bit:
            self.repeated += 1
        else:
            self._seen |= bit
            self.late += 1
            self.lost -= 1


def joystick_link(
    *, boot_id: int = 1, max_age_ns: int = MAX_AGE_NS, deadband: bool = False, more: int = 0
) -> HapticLink[Command, Feedback]:
    """Return the joystick's end: it sends commands and receives feedback.

    more: the number of axes behind x and y.
    """
    band = command_deadband() if deadband else None
    session = JoystickSession(boot_id)
    return HapticLink(
        pack_command, read_feedback, session, max_age_ns=max_age_ns, deadband=band, more=more
    )


def robot_link(
    *, boot_id: int = 1, max_age_ns: int = MAX_AGE_NS, deadband: bool = False, more: int = 0
) -> HapticLink[Feedback, Command]:
    """Return the robot's end: it sends feedback and receives commands."""
    band = feedback_deadband() if deadband else None
    session = RobotSession(boot_id)
    return HapticLink(
        pack_feedback, read_command, session, max_age_ns=max_age_ns, deadband=band, more=more
    )
