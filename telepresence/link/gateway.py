"""The gateway of one segment: sender, outgoing radio path, receiver and supervision.

A shell that binds sockets needs six lines for each wake-up:

1. For every datagram on a flow's port: `handle_datagram(flow name, data, now_ns)`.
2. For every datagram on the haptic port: `handle_haptic(data, now_ns)`.
3. For every datagram on the radio's port: `handle_radio(frame, now_ns)`.
4. Once a slot, on absolute deadlines: `handle_slot(now_ns)`.
5. Until None: send `poll_transmit(now_ns)` to the radio's peer.
6. Until None: pass `next_event()` to the haptic endpoint or to the flow's local consumer.

Between slots, `poll_timeout()` says when the next frame leaves the radio path.

The gateway connects its parts. Events of supervision flush the sender's queues and the receiver's
incomplete packets, and start and stop delivery. They also say when headers must begin anew.

A `BacklogReporter` says what a gateway reports to senders of video and files, and when.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.clock_exchange import ClockExchange, ReportClock, is_clock
from telepresence.link.flows import Flow, FlowKind, HapticReceived, Level, LinkEvent, PacketReceived
from telepresence.link.link_metrics import GatewayMetrics
from telepresence.link.path.following import ALL, PARTS, Allowed
from telepresence.link.profile import LinkProfile
from telepresence.link.queues import QueueLimits
from telepresence.link.radio import RadioPath
from telepresence.link.receiver import LinkReceiver, UnknownFrame
from telepresence.link.repair.ends import EndRepair
from telepresence.link.sender import LinkSender
from telepresence.link.supervision.message import Configuration, SupervisionTiming
from telepresence.link.supervision.record import (
    ApplicationReset,
    PeerDeaf,
    PeerDoubted,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
)
from telepresence.link.supervision.supervisor import Encounter, Supervisor

#: Largest age of a packet while the peer may not hear it. It keeps old packets from being sent
#: after a loss of signal. A picture of three periods (1200 octets) takes up to 115 ms beside voice
#: on the uplink; it shall get through, because the peer may hear it although it is not heard.
LOST_TIMEOUT_NS = 120 * NS_PER_MS
#: Events within this time after the peer was found belong to the same contact.
SAME_CONTACT_NS = 100 * NS_PER_MS
#: Shift from the life number to its first frame count, so that two starts begin far apart.
BOOT_SHIFT = 8
#: After this long without a frame, no old header context is valid: the frame count may have gone
#: through its whole range.
FORGET_NS = 900 * NS_PER_S
#: Number of latest slots in which those without a sample are counted: one second of them.
COUNTED_SLOTS = 1000


class Gateway:
    """Sender, radio path, receiver and supervision of one segment; see the module for the run loop.

    transmit, receive: profiles of the way out and of the way in.
    transmit_flows, receive_flows: flow tables; at the peer they are exchanged.
    master: whether this end configures the other; exactly one of the two does.
    boot_id: 1 to 65535, a new one at each start of the gateway.
    secret: seed of the numbers by which the peer proves that it is there (`Supervisor`).
    now_ns: the instant at which it starts; its local check has passed by then.
    radio: path of the outgoing frames; by default they leave at once.
    limits: queue limits by level, where they differ from the defaults.
    timing: waits of the supervision, where they differ from the defaults.
    told_offset_ns: the clock that is told to a peer on another machine, minus that of `now_ns`
        (`ClockExchange`); None: both ends have one clock.

    clock: compares the clocks of both ends; None if they have one.
    """

    def __init__(
        self,
        *,
        transmit: LinkProfile,
        transmit_flows: Sequence[Flow],
        receive: LinkProfile,
        receive_flows: Sequence[Flow],
        master: bool,
        boot_id: int,
        now_ns: int,
        radio: RadioPath | None = None,
        limits: Mapping[Level, QueueLimits] | None = None,
        timing: SupervisionTiming | None = None,
        secret: int = 0,
        told_offset_ns: int | None = None,
    ) -> None:
        # A start that continued the counts of another one would seem to be its stream.
        self.sender = LinkSender(
            transmit, transmit_flows, limits=limits, first_count=boot_id << BOOT_SHIFT
        )
        self.receiver = LinkReceiver(receive, receive_flows)
        self.receiver.cautious = True
        self.repair = EndRepair(self.sender, self.receiver)
        #: What of the profile the path to another machine carries.
        self.allowed = ALL
        self.radio = RadioPath() if radio is None else radio
        self.supervisor = Supervisor(
            master=master,
            configuration=Configuration(
                transmit=transmit,
                transmit_flows=self.sender.flows,
                receive=receive,
                receive_flows=self.receiver.flows,
            ),
            boot_id=boot_id,
            now_ns=now_ns,
            timing=timing,
            secret=secret,
        )
        self.clock = None
        if told_offset_ns is not None:
            self.clock = ClockExchange(
                version=self.supervisor.configuration.version,
                master=master,
                boot_id=boot_id,
                told_offset_ns=told_offset_ns,
                now_ns=now_ns,
            )
        self._reports = None if self.clock is None else ReportClock(self.clock)
        #: A radio that frames pass after they have come to this machine, if there is one.
        self.radio_in: RadioPath | None = None
        #: How often the peer was found, or found to hear this end again. It may not understand what
        #: refers to anything before the latest time.
        self.contacts = 0
        self._contact_ns: int | None = None
        self._samples_sent = 0
        #: For each of the latest slots, in a ring, whether it had no sample.
        self._free = bytearray(COUNTED_SLOTS)
        self._slot = 0
        #: Number of slots without a sample among the latest `COUNTED_SLOTS`; 0 at the start.
        self.free_slots = 0
        #: Frames with the instants at which they were sent and received, oldest first. A user
        #: sets these to lists; None: they are not kept.
        self.frames_sent: list[tuple[int, bytes]] | None = None
        self.frames_received: list[tuple[int, bytes]] | None = None
        # The peer has not been heard yet.
        self.sender.set_timeout(LOST_TIMEOUT_NS)
        self.handle_local_check(None, now_ns)

    def handle_local_check(self, fault: str | None, now_ns: int) -> None:
        """None: this end works. A line: what does not; then nothing is delivered."""
        self.supervisor.handle_local_check(fault, now_ns)
        self._follow_supervision()

    def handle_datagram(self, flow: str, data: bytes, now_ns: int) -> bool:
        """Send a local UDP payload to the other segment; return False, and count it, if refused."""
        if not self.sender.handle_packet(flow, data, now_ns):
            return False
        self.supervisor.handle_application_sent(now_ns)
        return True

    def handle_haptic(self, data: bytes, now_ns: int) -> bool:
        """Send a local sample to the other segment; return False, and count it, if invalid."""
        return self.sender.handle_haptic(data, now_ns)

    def handle_radio(self, frame: bytes, now_ns: int) -> None:
        """Take a frame from the other segment."""
        if self.frames_received is not None:
            self.frames_received.append((now_ns, frame))
        receiver, supervisor = self.receiver, self.supervisor
        if not receiver.handle_frame(frame, now_ns):
            unknown = receiver.unknown
            if unknown is None or not self._meet(unknown, now_ns):
                return
        was_silent = not supervisor.signal
        supervisor.handle_frame(now_ns)
        if was_silent:
            self._follow_supervision()

    def handle_path(self, allowed: Allowed) -> None:
        """So much of the profile goes over the path to another machine now."""
        if allowed != self.allowed:
            self.allowed = allowed
            self.repair.set_saving(not allowed.idle)

    def handle_slot(self, now_ns: int, due_ns: int | None = None) -> None:
        """A slot begins: send exactly one frame.

        due_ns: the slot's instant, at which the frame enters the radio path; by default now. So a
        frame leaves a path whose delay is whole slots within a slot, not in a wake-up of its own.
        """
        due_ns = now_ns if due_ns is None else due_ns
        supervisor, sender = self.supervisor, self.sender
        message = None
        if now_ns >= supervisor.next_ns:
            supervisor.loss = self.repair.measure(now_ns)
            message = supervisor.poll_transmit(now_ns)
            self._follow_supervision()
        clock = self.clock
        if (
            clock is not None
            and message is None
            and supervisor.peer_hears
            and now_ns >= clock.next_ns
        ):
            # It leaves this machine after the radio's simulated delay.
            message = clock.poll_transmit(now_ns, self.radio.arrival_ns(due_ns))
        frame = sender.poll_transmit(now_ns, message)
        slot = self._slot
        self._slot = slot + 1 if slot + 1 < COUNTED_SLOTS else 0
        if sender.haptic_sent != self._samples_sent:
            self._samples_sent = sender.haptic_sent
            supervisor.handle_application_sent(now_ns)
            if self._free[slot]:
                self._free[slot] = 0
                self.free_slots -= 1
        elif not self._free[slot]:
            self._free[slot] = 1
            self.free_slots += 1
        if self.frames_sent is not None:
            self.frames_sent.append((now_ns, frame))
        self.radio.handle_frame(frame, due_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next frame that reaches the other segment by now, or None. Call until None."""
        return self.radio.poll_transmit(now_ns)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` returns the next frame; None without one."""
        return self.radio.poll_timeout()

    def next_event(self) -> LinkEvent | None:
        """The next sample or packet from the other segment, or None. Call until None."""
        receiver, supervisor = self.receiver, self.supervisor
        events = receiver.events
        while events:
            event = events.popleft()
            if isinstance(event, HapticReceived):
                supervisor.handle_application(event.now_ns)
                return event
            if isinstance(event, PacketReceived):
                supervisor.handle_application(event.now_ns)
                reports = self._reports
                if reports is None or event.flow.kind is not FlowKind.RTCP:
                    return event
                reports.handle_report(event)
            elif not self._is_of_clock(event.message, event.now_ns):
                supervisor.handle_message(event.message, event.now_ns)
                self.repair.handle_loss(supervisor.peer_loss, event.now_ns)
                self._follow_supervision()
        return None if self._reports is None else self._reports.next_event()

    def _is_of_clock(self, message: bytes, now_ns: int) -> bool:
        """Take a message CLOCK of the peer; False for all others, which supervision judges."""
        clock, reports = self.clock, self._reports
        if clock is None or reports is None or not is_clock(message):
            return False
        came_ns = now_ns if self.radio_in is None else now_ns - self.radio_in.delay_ns
        taken = clock.handle_message(message, came_ns, heard=self.supervisor.peer_hears)
        reports.handle_time(now_ns)
        return taken

    def _meet(self, unknown: UnknownFrame, now_ns: int) -> bool:
        """Take a frame of another stream; return whether it is the peer's from now on."""
        message, frames, lasts_ns = unknown
        if message is not None and is_clock(message):
            # It says nothing about who sends it.
            message = None
        found = self.supervisor.handle_unknown_sender(
            message, now_ns, frames=frames, lasts_ns=lasts_ns
        )
        self._follow_supervision()
        if found is Encounter.IGNORE:
            return False
        return self.receiver.follow_unknown_sender(new_boot_id=found is Encounter.RESTART)

    def _follow_supervision(self) -> None:
        sender, receiver, supervisor = self.sender, self.receiver, self.supervisor
        while (event := supervisor.next_event()) is not None:
            if isinstance(event, SignalLost):
                sender.flush(event.now_ns)
                sender.set_timeout(LOST_TIMEOUT_NS)
                receiver.handle_signal_lost(event.now_ns)
            elif isinstance(event, SignalAcquired):
                self._count_contact(event.now_ns)
                if event.gap_ns > FORGET_NS:
                    receiver.forget_contexts()
            elif isinstance(event, PeerDeaf):
                sender.flush(event.now_ns)
                sender.set_timeout(LOST_TIMEOUT_NS)
            elif isinstance(event, PeerHears):
                self._count_contact(event.now_ns)
                sender.set_timeout(None)
                sender.restart_contexts()
            elif isinstance(event, PeerDoubted):
                receiver.leave()
            elif isinstance(event, PeerMet):
                sender.restart_contexts()
                receiver.forget_contexts()
                if self.clock is not None:
                    self.clock.handle_peer(event.boot_id, event.now_ns)
            elif isinstance(event, ApplicationReset):
                sender.flush(event.now_ns)
                sender.restart_contexts()
                receiver.handle_signal_lost(event.now_ns)
                receiver.forget_contexts()
        receiver.deliver = supervisor.delivering
        self.repair.set(supervisor.repair)

    @property
    def freed_bps(self) -> int:
        """The capacity that the last second's slots without a sample left to media, in bit/s."""
        profile = self.sender.profile
        bits = self.free_slots * profile.insert_octets * 8
        return bits * NS_PER_S // (COUNTED_SLOTS * profile.slot_ns)

    def _count_contact(self, now_ns: int) -> None:
        # Both directions usually return together, but are noticed one after the other.
        if self._contact_ns is None or now_ns - self._contact_ns > SAME_CONTACT_NS:
            self.contacts += 1
            self._contact_ns = now_ns

    def report(self, now_ns: int) -> GatewayMetrics:
        """Return the counts of this end until `now_ns`."""
        return GatewayMetrics(
            transmit=self.sender.report(now_ns, self.repair.report()),
            receive=self.receiver.report(),
            radio=self.radio.report(),
            supervision=self.supervisor.report(now_ns),
            clock=None if self.clock is None else self.clock.report(now_ns),
        )


#: Shortest interval between two reports, because each one costs both processes time.
REPORT_NS = 4 * NS_PER_MS
#: An unchanged state is reported again, for a process that was started after the last change.
REPEAT_NS = 500 * NS_PER_MS
#: `Backlog.freed_bps` is rounded down to a multiple of this, so that not every slot is a change.
FREED_STEP_BPS = 1_000


class Backlog(NamedTuple):
    """The state of a gateway's way out, for the senders of video and of files.

    waiting_octets: video that waits for a slot, and what is left of packets that are being sent.
    contacts: how often the peer was found, or found again (`Gateway.contacts`).
    peer_heard: whether the peer is heard now.
    freed_bps: capacity left by slots without a haptic sample (`Gateway.freed_bps`).
    maintenance_octets: what waits on the lowest level.
    leave_out: one picture of so many is to be left out, for repair or a slow path; 0: none.
    cap_parts: what the path to another machine carries of the caps of video, in parts of `PARTS`;
        0: no video.
    """

    waiting_octets: int
    contacts: int
    peer_heard: bool
    freed_bps: int
    maintenance_octets: int = 0
    leave_out: int = 0
    cap_parts: int = PARTS


class BacklogReporter:
    """Decides when to report: a change after `REPORT_NS` at the soonest, all every `REPEAT_NS`."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._supervisor = gateway.supervisor
        self._video = gateway.sender.queue(Level.VIDEO)
        self._maintenance = gateway.sender.queue(Level.MAINTENANCE)
        self._seen: tuple[int, int, bool, int, int, int, int] | None = None
        self._reported: Backlog | None = None
        self._due_ns = self._repeat_ns = 0

    def poll_transmit(self, now_ns: int) -> Backlog | None:
        """Return the report to send now, or None. Call once a slot, at the slot's instant."""
        if now_ns < self._due_ns:
            return None
        gateway = self._gateway
        waiting_octets = self._video.octets + gateway.sender.begun_octets(Level.VIDEO)
        left_octets = self._maintenance.octets
        signal, free_slots = self._supervisor.signal, gateway.free_slots
        path = gateway.allowed
        rates = [every for every in (gateway.repair.leave_out, path.leave_out) if every]
        reduced = min(rates, default=0), path.cap_parts
        seen = waiting_octets, gateway.contacts, signal, free_slots, left_octets, *reduced
        again = now_ns >= self._repeat_ns
        if seen == self._seen and not again:
            return None
        self._seen = seen
        freed_bps = gateway.freed_bps
        backlog = Backlog(*seen[:3], freed_bps - freed_bps % FREED_STEP_BPS, *seen[4:])
        if backlog == self._reported and not again:
            return None
        self._reported = backlog
        self._due_ns, self._repeat_ns = now_ns + REPORT_NS, now_ns + REPEAT_NS
        return backlog
