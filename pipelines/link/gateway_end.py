"""One end of the link, live and simulated: gateway, slots, radio and figures. A core."""

from kontur_av.clock import NS_PER_MS
from pipelines.link.link_metrics import WayInMetrics
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import ClockRow, LoopMetrics
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import Setup, VideoStream
from pipelines.session.topology.table import Topology
from pipelines.session.training import Exercises
from telepresence.link.gateway import Gateway
from telepresence.link.link_metrics import GatewayMetrics, PeerMetrics
from telepresence.link.path.following import PARTS, PathNeeds
from telepresence.link.slots import GatewaySlots
from telepresence.link.supervision.local_check import LocalCheck, self_test
from telepresence.link.supervision.message import SupervisionTiming

#: The time for an answer, without the radio's delay there and back.
_TURNAROUND_NS = 200 * NS_PER_MS


class GatewayEnd:
    """Call `handle_frame` for each frame of the peer, and run `slots` as `GatewaySlots` says.

    After either, take `next_event` until it is None, and send `poll_transmit` until it is None.
    Call `handle_time` at `poll_timeout`.

    boot_id: 1 to 65535; another value tells the peer that this end has restarted.
    secret: a random number, by which the peer's answers are known; nobody else may know it.
    seed, epoch_ns: the seed and the start of the radio; the same at both ends.
    first_ns: the first slot.
    told_offset_ns: as of `Gateway`, for a peer on another machine.
    radio_both_ways: the radio of the way in is here, too; otherwise the peer has it.
    """

    def __init__(
        self,
        topology: Topology,
        segment: Segment,
        probe: Probe,
        *,
        boot_id: int,
        secret: int,
        seed: int,
        epoch_ns: int,
        now_ns: int,
        first_ns: int,
        told_offset_ns: int | None = None,
        radio_both_ways: bool = False,
    ) -> None:
        setup = topology.setup
        out, back = segment.transmits, segment.peer.transmits
        transmit, receive = topology.link(out).profile, topology.link(back).profile
        self.gateway = gateway = Gateway(
            transmit=transmit,
            transmit_flows=topology.flows(out),
            receive=receive,
            receive_flows=topology.flows(back),
            master=segment is Segment.GROUND,
            boot_id=boot_id,
            secret=secret,
            now_ns=now_ns,
            radio=setup.radio_path(transmit, seed=seed, epoch_ns=epoch_ns),
            timing=_timing(setup),
            told_offset_ns=told_offset_ns,
        )
        fault = self_test(transmit, topology.flows(out)) or self_test(receive, topology.flows(back))
        self._check = LocalCheck(fault, now_ns)
        gateway.handle_local_check(fault, now_ns)
        self.slots = GatewaySlots(gateway, first_ns=first_ns)
        self._radio_in = None
        if radio_both_ways:
            self._radio_in = setup.radio_path(receive, seed=seed, epoch_ns=epoch_ns)
            gateway.radio_in = self._radio_in
        self._probe = probe
        self.next_event = gateway.next_event
        self.poll_transmit = gateway.radio.poll_transmit

    def handle_frame(self, frame: bytes, now_ns: int) -> None:
        if self._radio_in is None:
            self.gateway.handle_radio(frame, now_ns)
        else:
            self._radio_in.handle_frame(frame, now_ns)

    def handle_time(self, now_ns: int) -> bool:
        """Take the frames that leave the radio of the way in; return whether that radio is here."""
        if self._radio_in is None:
            return False
        while (frame := self._radio_in.poll_transmit(now_ns)) is not None:
            self.gateway.handle_radio(frame, now_ns)
        return True

    def poll_timeout(self) -> int:
        """When to wake up next: for a slot, or because a frame leaves the radio of either way."""
        alarm_ns = self.slots.poll_timeout()
        due_ns = None if self._radio_in is None else self._radio_in.poll_timeout()
        return alarm_ns if due_ns is None else min(due_ns, alarm_ns)

    def handle_exercises(self, exercises: Exercises, now_ns: int) -> None:
        """A trainer wants the signal to be lost until an instant, on both ways."""
        for radio in (self.gateway.radio, self._radio_in):
            if radio is not None:
                radio.handle_outage(exercises.los_ns, now_ns)

    def handle_refused(self, frames: int, reason: str, now_ns: int) -> None:
        """So far the system refused this many frames to the peer, the newest for `reason`."""
        self._check.handle_frames(self.slots.schedule.cycles, frames, reason, now_ns)
        self.gateway.handle_local_check(self._check.fault, now_ns)

    def publish(self, now_ns: int, peer: PeerMetrics | None = None) -> GatewayMetrics:
        """Put the figures into the probe, and return the gateway's.

        peer: the path to the other machine.
        """
        probe, schedule = self._probe, self.slots.schedule
        probe.publish(LoopMetrics(slips=schedule.slips, cycles=schedule.cycles))
        metrics = self.gateway.report(now_ns)
        probe.publish(metrics)
        _note_clock(probe, metrics)
        if peer is not None:
            probe.publish(peer)
            self.gateway.repair.set_compact(peer.compact)
        if self._radio_in is not None:
            probe.publish(WayInMetrics(radio_back=self._radio_in.report()))
        return metrics


def path_needs(topology: Topology, direction: Direction) -> PathNeeds:
    """What the videos of one way need of a path."""
    rows = (row for row in topology.media_streams if row.direction is direction)
    streams = [row.stream for row in rows if isinstance(row.stream, VideoStream)]
    least_parts = (PARTS * stream.least_bps // stream.cap_bps for stream in streams)
    return PathNeeds(sum(stream.cap_bps for stream in streams), min(least_parts, default=PARTS))


def _timing(setup: Setup) -> SupervisionTiming:
    """Return a timing that allows for the radio's delay."""
    longest_delay_ns = round(setup.radio_profile.longest_delay_ns)
    shortest_ns = SupervisionTiming().round_trip_ns
    return SupervisionTiming(round_trip_ns=max(shortest_ns, 2 * longest_delay_ns + _TURNAROUND_NS))


def _note_clock(probe: Probe, link: GatewayMetrics) -> None:
    """Add a row if the clock of the other machine is known."""
    clock = link.clock
    if clock is not None and clock.offset_ns is not None and clock.error_ns is not None:
        probe.series(ClockRow).add(ClockRow(clock.at_ns, clock.offset_ns, clock.error_ns))
