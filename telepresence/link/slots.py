"""The slots of one end of the link: when to wake up, and the order of work in a slot.

A shell that binds sockets, or the simulation, repeats these steps:

1. Sleep until `poll_timeout()`, or until a frame arrives by radio. Pass a frame to
   `Gateway.handle_radio` at once, at any time.
2. At `deadline_ns`: pass the datagrams in the flows' ports to `handle_datagrams`, then the samples
   in the haptic port to `handle_slot`.
3. Send `Gateway.poll_transmit` by radio until it is None.
4. Send `poll_backlog` to the sender of video.
5. Collect figures when `poll_metrics` says so.
"""

from collections.abc import Iterable
from itertools import islice

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.link.gateway import Backlog, BacklogReporter, Gateway

#: Datagrams taken from a port in one slot; the rest stays there for the next slot.
MOST_DATAGRAMS = 64
#: Interval of the figures.
METRICS_NS = 100 * NS_PER_MS
#: Longest time that figures take; this much of a slot must remain.
METRICS_COST_NS = NS_PER_MS // 2


class GatewaySlots:
    """The slots of `gateway`, the first of them at `first_ns`; see the module for the run loop.

    deadline_ns: when the next slot begins.
    metrics_ns: before this instant `poll_metrics` is False.
    schedule: counts slots and slips.
    """

    def __init__(self, gateway: Gateway, *, first_ns: int) -> None:
        self._handle_datagram = gateway.handle_datagram
        # Bound to the innermost method: with cold caches, each Python call takes about 1 µs.
        self._handle_haptic = gateway.sender.handle_haptic
        self._handle_slot = gateway.handle_slot
        self._radio_due_ns = gateway.radio.poll_timeout
        slot_ns = gateway.sender.profile.slot_ns
        self.schedule = PeriodicSchedule(start_ns=first_ns, period_ns=slot_ns)
        self._handle_wakeup = self.schedule.handle_wakeup
        self._reporter = BacklogReporter(gateway)
        self._slot_ns = slot_ns
        self.metrics_ns = 0
        self.deadline_ns = first_ns

    def poll_timeout(self) -> int:
        """When to wake up next: for a slot, or because a frame leaves the radio path."""
        due_ns, deadline_ns = self._radio_due_ns(), self.deadline_ns
        return deadline_ns if due_ns is None or due_ns > deadline_ns else due_ns

    def handle_datagrams(self, datagrams: Iterable[tuple[str, bytes | None]], now_ns: int) -> None:
        """Take the datagrams in the flows' ports as pairs of flow and payload.

        A payload of None is a datagram from an unknown sender, which is dropped but took time. At
        most `MOST_DATAGRAMS` are taken from the iterable.
        """
        handle_datagram = self._handle_datagram
        for flow, data in islice(datagrams, MOST_DATAGRAMS):
            if data is not None:
                handle_datagram(flow, data, now_ns)

    def handle_slot(self, samples: Iterable[bytes | None], now_ns: int) -> int:
        """Run a slot; return how late it is (ns). Negative: too early, nothing happened.

        samples: those in the haptic port, None for an unknown sender's. The newest one is sent.
        """
        late_ns = self._handle_wakeup(now_ns)
        if late_ns < 0:
            return late_ns
        handle_haptic = self._handle_haptic
        for sample in islice(samples, MOST_DATAGRAMS):
            if sample is not None:
                handle_haptic(sample, now_ns)
        self.deadline_ns = deadline_ns = self.schedule.next_deadline_ns
        self._handle_slot(now_ns, deadline_ns - self._slot_ns)
        return late_ns

    def poll_backlog(self) -> Backlog | None:
        """The report for the sender of video after this slot, or None."""
        # Use the slot's own instant, so that a slightly late slot delays no report.
        return self._reporter.poll_transmit(self.deadline_ns - self._slot_ns)

    def poll_metrics(self, now_ns: int, *, heard: bool) -> bool:
        """Whether to collect figures now.

        heard: a frame has just arrived by radio, so the next is most of a slot away. Without frames
        the figures wait one more interval, and are then collected right after a slot.
        """
        if heard:
            due_ns = self.metrics_ns
            if self.deadline_ns - now_ns <= METRICS_COST_NS:
                return False
        else:
            due_ns = self.metrics_ns + METRICS_NS
        if now_ns < due_ns:
            return False
        self.metrics_ns = now_ns + METRICS_NS
        return True
