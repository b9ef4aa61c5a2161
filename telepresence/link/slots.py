"""The slots of one end of the link: when to wake, and what happens in a slot in which order.

A shell that binds sockets repeats this; `pipelines/parts/gateway.py` is one, and the simulation
does the same on virtual time:

1. Sleep until `poll_timeout()`, or until a frame comes by radio. A frame goes to
   `Gateway.handle_radio` at once, whatever the slot does.
2. From `wake_ns` on, a little before the slot: what waits in the flows' ports to
   `handle_datagrams`. Then `handle_ready`, and wait for `deadline_ns` itself.
3. At `deadline_ns`: what waits in the haptic port to `handle_slot`.
4. Until None: `Gateway.poll_transmit` to the radio.
5. `poll_backlog` to the sender of video.
6. Figures are put together when `poll_figures` says so.
"""

from collections.abc import Iterable
from itertools import islice

from kontur_av.clock import NS_PER_MS, NS_PER_US
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.link.backlog import Backlog, BacklogTeller
from telepresence.link.gateway import Gateway

#: A slot takes no more datagrams than this from a port; the rest waits there for the next slot.
MOST_DATAGRAMS = 64
#: How often figures are put together.
FIGURES_NS = 100 * NS_PER_MS
#: What they take at the worst: as much of a slot must be left.
FIGURES_COST_NS = NS_PER_MS // 2

#: The margin's steps, and its bound. One wake-up in four is later than the margin.
_SHRINK_NS = 100
_GROW_NS = 3 * _SHRINK_NS
_MOST_NS = 60 * NS_PER_US


class WakeMargin:
    """How long before a deadline to wake up, so that most times it has not passed by then.

    It follows what three of four wake-ups stay below: the stochastic approximation of a quantile
    (Robbins and Monro 1951), one comparison a wake-up. A larger share would cost more waiting
    than it gains.

    ns: the margin, at most 60 µs: what is later than that has been held up, not woken.
    """

    def __init__(self) -> None:
        self.ns = 0

    def handle_wakeup(self, late_ns: int) -> None:
        """It was ready `late_ns` after the instant for which it had asked to be woken."""
        if late_ns > self.ns:
            self.ns = min(self.ns + _GROW_NS, _MOST_NS)
        else:
            self.ns = max(self.ns - _SHRINK_NS, 0)


class GatewaySlots:
    """The slots of `gateway`, the first of them at `first_ns`; see the module for the run loop.

    deadline_ns: when the next slot begins. wake_ns: when to wake for it.
    schedule: counts slots and slips.
    """

    def __init__(self, gateway: Gateway, *, first_ns: int) -> None:
        self._handle_datagram = gateway.handle_datagram
        self._handle_haptic = gateway.handle_haptic
        self._handle_slot = gateway.handle_slot
        self._radio_due_ns = gateway.poll_timeout
        slot_ns = gateway.sender.profile.slot_ns
        self.schedule = PeriodicSchedule(start_ns=first_ns, period_ns=slot_ns)
        self._handle_wakeup = self.schedule.handle_wakeup
        self.margin = WakeMargin()
        self._teller = BacklogTeller(gateway)
        self._slot_ns = slot_ns
        self._figures_ns = 0
        self.deadline_ns = self.wake_ns = first_ns

    def poll_timeout(self) -> int:
        """When to wake next: for a slot, or because the radio gives a frame out."""
        due_ns, wake_ns = self._radio_due_ns(), self.wake_ns
        return wake_ns if due_ns is None or due_ns > wake_ns else due_ns

    def handle_datagrams(self, datagrams: Iterable[tuple[str, bytes | None]], now_ns: int) -> None:
        """Take what waits in the flows' ports: of each datagram the flow and the payload.

        A payload of None stands for a stranger's datagram, which is dropped but took its time.
        No more than `MOST_DATAGRAMS` are asked of the iterable.
        """
        handle_datagram = self._handle_datagram
        for flow, data in islice(datagrams, MOST_DATAGRAMS):
            if data is not None:
                handle_datagram(flow, data, now_ns)

    def handle_ready(self, now_ns: int) -> None:
        """All is done that can be done before the slot: from this the margin is learned."""
        self.margin.handle_wakeup(now_ns - self.wake_ns)

    def handle_slot(self, samples: Iterable[bytes | None], now_ns: int) -> int:
        """A slot begins. Gives how late (ns); negative: before `deadline_ns`, nothing happened.

        samples: what waits in the haptic port, None for a stranger's; the newest goes.
        """
        late_ns = self._handle_wakeup(now_ns)
        if late_ns < 0:
            return late_ns
        handle_haptic = self._handle_haptic
        for sample in islice(samples, MOST_DATAGRAMS):
            if sample is not None:
                handle_haptic(sample, now_ns)
        self._handle_slot(now_ns)
        self.deadline_ns = deadline_ns = self.schedule.next_deadline_ns
        self.wake_ns = deadline_ns - self.margin.ns
        return late_ns

    def poll_backlog(self) -> Backlog | None:
        """What to tell the sender of video after this slot, or None."""
        # By the slot's own instant: a slot that is some microseconds late delays no message.
        return self._teller.poll_transmit(self.deadline_ns - self._slot_ns)

    def poll_figures(self, now_ns: int, *, heard: bool) -> bool:
        """Whether to put figures together now.

        heard: a frame has just come by radio, and the next is most of a slot away. Without one
        they wait as long again, and are then put together right after a slot.
        """
        if heard:
            due_ns = self._figures_ns
            if self.deadline_ns - now_ns <= FIGURES_COST_NS:
                return False
        else:
            due_ns = self._figures_ns + FIGURES_NS
        if now_ns < due_ns:
            return False
        self._figures_ns = now_ns + FIGURES_NS
        return True
