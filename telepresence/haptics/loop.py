"""One end of the haptic exchange at 1 kHz. There is no queue: the newest sample wins."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Generic, TypeVar

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from telepresence.haptics.axes import AXIS_OCTETS, pack_axes, split_axes
from telepresence.haptics.deadband import Deadband, command_deadband, feedback_deadband
from telepresence.haptics.echo import EchoProbe, EchoReturn
from telepresence.haptics.haptic_metrics import SamplesReceived, SamplesSent
from telepresence.haptics.pacing import FEEDBACK_HZ, SamplePace, lasts_ns
from telepresence.haptics.sample import (
    FLAG_ECHOES,
    FLAG_GREETING,
    FLAG_HOLDING,
    FORCE_N,
    POSITION_M,
    SAMPLE_OCTETS,
    SEQUENCE_MODULUS,
    Command,
    Feedback,
    is_echo,
    pack_command,
    pack_echo,
    pack_feedback,
    pack_greeting,
    read_command,
    read_echo,
    read_feedback,
    read_greeting,
)
from telepresence.haptics.sample_window import SampleWindow
from telepresence.haptics.session import JoystickSession, RobotSession

Out = TypeVar("Out", bound=Command | Feedback)
In = TypeVar("In", bound=Command | Feedback)

#: Without a sample for this long, the peer counts as silent: 20 slots.
MAX_AGE_NS = 20 * NS_PER_MS

#: A peer that hears nothing for this much longer has met a burst of losses: jitter and single
#: losses make shorter gaps.
_GAP_NS = 20 * NS_PER_MS
_NEVER_NS = 1 << 63

#: Skips the NamedTuple's own `__new__`, which is one more Python call a thousand times a second.
_tuple = tuple.__new__

#: Stamps kept for a latency meter; beyond that the oldest are dropped.
_STAMPS_DEPTH = 8192


class _Totals:
    """Energies of a port in µJ, and what of them belongs to earlier sessions.

    x and y have one port together, each axis behind them has its own.
    granted_uj: as it was sent. heard_uj: the most that was received.
    """

    __slots__ = ("granted_before_uj", "granted_uj", "heard_before_uj", "heard_uj")

    def __init__(self) -> None:
        self.granted_uj = self.granted_before_uj = 0
        self.heard_uj = self.heard_before_uj = 0

    def most_uj(self) -> int:
        """The larger of both in the present session."""
        here_uj = self.granted_uj - self.granted_before_uj
        there_uj = self.heard_uj - self.heard_before_uj
        return here_uj if here_uj > there_uj else there_uj

    def take_uj(self, energy_uj: int) -> int:
        """Return the energy of all sessions heard; energy_uj: of the present one, in a sample."""
        heard_uj = self.heard_before_uj + energy_uj
        if heard_uj > self.heard_uj:
            self.heard_uj = heard_uj
        return self.heard_uj


class HapticLink(Generic[Out, In]):
    """Sends one kind of sample and receives the other; see `joystick_link` and `robot_link`.

    In each cycle: call `handle_datagram` for every datagram received, pass `latest` to the
    controller, pass its answer to `handle_local`, then send what `poll_transmit` returns.

    Samples are sent and used only in a session (`session.py`). Until one has begun, a greeting goes
    in the place of each sample.

    session: this end of the session.
    deadband: leaves out samples whose difference the peer would not feel, or all but those of a
    rate. A sample left out has no sequence number, so it does not count as lost. Neither has a
    greeting.
    more: the number of axes behind x and y.

    counts: of what came. numbers: of the samples received. hearing: samples of the peer arrive.
    peer_holds: the newest sample says that the peer receives nothing from this end.
    """

    def __init__(
        self,
        pack: Callable[[int, Out, bool, int, int], bytes],
        unpack: Callable[[bytes, int], tuple[int, int, int, In]],
        session: JoystickSession | RobotSession,
        *,
        max_age_ns: int = MAX_AGE_NS,
        deadband: Deadband | SamplePace | None = None,
        more: int = 0,
    ) -> None:
        self.max_age_ns = max_age_ns
        self.deadband = deadband
        self.session = session
        self.sent = 0
        self.counts = SamplesReceived()
        self.numbers = SampleWindow(self.counts)
        self.hearing = self.peer_holds = False
        self._pack: Callable[[int, Out, bool, int, int], bytes] = pack
        self._unpack: Callable[[bytes, int], tuple[int, int, int, In]] = unpack
        self._robot = isinstance(session, RobotSession)
        #: A robot's probe of the age of its commands, and a joystick's answer.
        self.probe = EchoProbe() if self._robot else None
        self._echo = self.probe or EchoReturn()
        self.more = more
        self._totals = _Totals()
        #: Of the axes behind x and y.
        self._axes = [_Totals() for _ in range(more)]
        counts_of = (FORCE_N, POSITION_M) if self._robot else (POSITION_M, FORCE_N)
        self._sends, self._hears = counts_of
        #: The session of the last sample sent.
        self._sending = 0
        self._local: Out | None = None
        self._newest: In | None = None
        self._held_ns = _NEVER_NS
        # Each kept object would take memory that no cache holds, so keep few: numbers sent follow
        # from `sent`; what was received is stored flat as sequence number, instant, ...
        self._sent_ns: deque[int] = deque(maxlen=_STAMPS_DEPTH)
        self._received_stamps: deque[int] = deque(maxlen=2 * _STAMPS_DEPTH)

    def handle_local(self, value: Out, now_ns: int) -> None:
        """Set the value to send next; it replaces one that was not sent yet."""
        self._local = value

    def handle_datagram(self, data: bytes, now_ns: int) -> None:
        """A datagram arrived. Garbage is counted; this never raises."""
        axes, counts, totals = self._axes, self.counts, self._totals
        try:
            if axes:
                data, more = split_axes(data, self.more, self._hears)
            if len(data) == SAMPLE_OCTETS and data[2] & FLAG_GREETING:
                self._handle_greeting(data, now_ns)
                return
            number, sequence, flags, value = self._unpack(data, totals.heard_before_uj)
        except ProtocolError:
            counts.garbage += 1
            return
        session, numbers = self.session, self.numbers
        if number != session.receiving:
            if not self._begin(number, sequence, now_ns):
                counts.strays += 1
                return
            *_, value = self._unpack(data, totals.heard_before_uj)
        session.strays = 0
        if not numbers.takes(sequence, now_ns):
            return
        counts.received += 1
        holds = flags & FLAG_HOLDING != 0
        if holds:
            self._handle_holding(now_ns)
        self.peer_holds = holds
        if value[2] > totals.heard_uj:
            totals.heard_uj = value[2]
        if axes:
            taken = zip(axes, more, strict=True)
            mores = tuple([(one[0], each.take_uj(one[1]), one[2]) for each, one in taken])
            value = _tuple(type(value), (*value[:-1], mores))
        self._newest = value
        stamps = self._received_stamps
        stamps.append(sequence)
        stamps.append(now_ns)
        self.hearing = True

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
        self._newest = None
        self.hearing = self.peer_holds = False
        if isinstance(self._echo, EchoReturn):
            self._echo = EchoReturn()

    def latest(self, now_ns: int) -> In | None:
        """The newest sample, or None if there is none or it is older than `max_age_ns`."""
        if self._newest is None or now_ns - self.numbers.newest_ns > self.max_age_ns:
            return None
        return self._newest

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the octets to send now, a sample or a greeting, or None.

        None: there is nothing new since the last call, or nothing that the peer would feel.
        """
        if self.hearing and now_ns - self.numbers.newest_ns > self.max_age_ns:
            self.hearing = False
        local, self._local = self._local, None
        band = self.deadband
        if local is None or (band is not None and band.rests(now_ns)):
            return None
        axes, totals, holding = self._axes, self._totals, not self.hearing
        if (instead := self._poll_greeting(now_ns, holding)) is not None:
            if band is not None:
                band.handle_other(now_ns)
            return instead + bytes(AXIS_OCTETS * self.more) if axes else instead
        if band is not None:
            local = band.handle_sample(local, holding, now_ns)
            if local is None:
                return None
        totals.granted_uj = local.energy_uj
        data = self._pack(self.sent, local, holding, self._sending, totals.granted_before_uj)
        if axes:
            for each, (_, granted_uj, _) in zip(axes, local[-1], strict=True):
                each.granted_uj = granted_uj
            data += pack_axes(local[-1], [each.granted_before_uj for each in axes], self._sends)
        self.sent += 1
        self._sent_ns.append(now_ns)
        return data

    @property
    def told_age_ms(self) -> int | None:
        """Of a joystick: how old its commands are at the robot, as the robot says; None before."""
        return self._echo.told_age_ms if isinstance(self._echo, EchoReturn) else None

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
        band = self.deadband
        left_out = band.left_out if isinstance(band, Deadband) else None
        return SamplesSent(sent=self.sent, left_out=left_out)

    def received_metrics(self) -> SamplesReceived:
        """Return the counters of what comes to this end."""
        return replace(self.counts, restarts=self.session.restarts)

    def _handle_greeting(self, data: bytes, now_ns: int) -> None:
        """Take what came in the place of a sample; ProtocolError for garbage."""
        session, feedback = self.session, not self._robot
        if is_echo(data):
            number, echo = read_echo(data, feedback=feedback)
            if number in (session.receiving, session.sending):
                self.counts.echoes += 1
                self._echo.handle_echo(echo, now_ns)
            else:
                self.counts.strays += 1
            return
        session.handle_greeting(read_greeting(data, feedback=feedback))
        self.counts.greetings += 1
        if self.probe is not None:
            self.probe.answered = data[2] & FLAG_ECHOES != 0

    def _poll_greeting(self, now_ns: int, holding: bool) -> bytes | None:
        """Return what goes in the place of a sample, or None."""
        session, totals, axes = self.session, self._totals, self._axes
        # The joystick watches them for both ends.
        most_uj = 0 if self._robot else totals.most_uj()
        if axes:
            # Their records have a bit less.
            most_uj = max(most_uj, *(2 * each.most_uj() for each in axes))
        greeting = session.poll_greeting(most_uj, now_ns)
        if greeting is not None:
            return pack_greeting(greeting, feedback=self._robot, holding=holding)
        if session.sending != self._sending:
            # Each joule is granted in one session only.
            self._sending = session.sending
            for each in (totals, *axes):
                each.granted_before_uj = each.granted_uj
        echo = self._echo.poll_transmit(now_ns)
        if echo is None:
            return None
        return pack_echo(echo, self._sending, feedback=self._robot, holding=holding)

    def _handle_holding(self, now_ns: int) -> None:
        """The peer hears nothing: leave nothing out, if it has met a burst of losses."""
        if not self.peer_holds:
            # A peer that is heard for the first time, or again, may have missed nothing.
            self._held_ns = now_ns if self.hearing else _NEVER_NS
        if self.deadband is not None and now_ns - self._held_ns >= _GAP_NS:
            self.deadband.handle_gap(now_ns)

    def _begin(self, number: int, sequence: int, now_ns: int) -> bool:
        """Whether session `number` begins with this sample."""
        restarts = self.session.restarts
        if not self.session.handle_change(number):
            return False
        self.counts.sessions += 1
        for each in (self._totals, *self._axes):
            each.heard_before_uj = each.heard_uj
        restarted = self.session.restarts != restarts
        if restarted or self._newest is None or not self.numbers.continue_with(sequence, now_ns):
            self.numbers.begin_with(sequence)
        return True


def joystick_link(
    *,
    boot_id: int = 1,
    max_age_ns: int = MAX_AGE_NS,
    deadband: bool = False,
    command_hz: int | None = None,
    more: int = 0,
) -> HapticLink[Command, Feedback]:
    """Return the joystick's end: it sends commands and receives feedback.

    command_hz: the rate of commands without force feedback; None: a sample each cycle.
    more: the number of axes behind x and y.
    """
    band = (
        command_deadband() if deadband else None if command_hz is None else SamplePace(command_hz)
    )
    if command_hz is not None:
        max_age_ns = max(max_age_ns, lasts_ns(FEEDBACK_HZ))
    session = JoystickSession(boot_id)
    return HapticLink(
        pack_command, read_feedback, session, max_age_ns=max_age_ns, deadband=band, more=more
    )


def robot_link(
    *,
    boot_id: int = 1,
    max_age_ns: int = MAX_AGE_NS,
    deadband: bool = False,
    command_hz: int | None = None,
    more: int = 0,
) -> HapticLink[Feedback, Command]:
    """Return the robot's end: it sends feedback and receives commands."""
    band = (
        feedback_deadband() if deadband else None if command_hz is None else SamplePace(FEEDBACK_HZ)
    )
    if command_hz is not None:
        max_age_ns = max(max_age_ns, lasts_ns(command_hz))
    session = RobotSession(boot_id)
    return HapticLink(
        pack_feedback, read_command, session, max_age_ns=max_age_ns, deadband=band, more=more
    )
