"""The choice of the camera by telecommand: the selector on the ground."""

from collections import deque

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.media.camera_selector import Selector
from pipelines.media.figures import SelectorFigures
from pipelines.media.following import Choice
from pipelines.session.probe import Probe
from pipelines.session.setup.table import Setup
from telepresence.tmtc import (
    Housekeeping,
    SelectCamera,
    TelecommandReceiver,
)
from telepresence.world import WorldState

#: How often the robot's side reports its state. The link has room for it:
#: `telepresence.link.arithmetic.RESERVE_BPS`.
HOUSEKEEPING_INTERVAL_NS = 2 * NS_PER_S
#: The console has one telecommand open at a time; beyond this the oldest is never acknowledged.
_MOST_OPEN = 16


class CameraChoice:
    """Receives telecommands, and decides which camera the sender of the picture follows. A core.

    After `handle_packet` publish `choice` for the sender; pass its confirmations to
    `handle_confirmed`. After each input send the packets of `poll_transmit` until None.

    A telecommand is acknowledged when the sender has confirmed the choice that it led to. From then
    on nothing of another camera is coded or sent. Either process may be killed at any time. A new
    selector numbers its choice anew, and the repeated telecommand waits for that number. A new
    sender confirms the first choice that it hears. Publish choice and confirmation repeatedly, for
    a process that starts late.
    """

    def __init__(self, setup: Setup, probe: Probe, *, now_ns: int, selected: str = "") -> None:
        self._probe = probe
        self._telecommands = TelecommandReceiver()
        known = selected if selected in setup.cameras else setup.cameras[0]
        self._selector = Selector(setup.cameras, known)
        #: The clock never goes back: a restarted selector's first number is above all before.
        self._number = now_ns
        self._confirmed: int | None = None
        #: Executed telecommands that are not acknowledged yet, with the numbers they wait for.
        self._open: deque[tuple[SelectCamera, int]] = deque(maxlen=_MOST_OPEN)
        self._housekeeping_ns = now_ns

    @property
    def selected(self) -> str:
        return self._selector.selected

    @property
    def choice(self) -> Choice:
        """What the sender has to know."""
        return Choice(self._number, self.selected)

    def handle_packet(self, datagram: bytes, now_ns: int) -> bool:
        """A datagram of the telecommand port; True if another camera is selected now."""
        self._telecommands.handle_packet(datagram, now_ns)
        before = self.selected
        while (request := self._telecommands.next_event()) is not None:
            try:
                changed = self._selector.handle_select(request.name, now_ns).changed
            except ProtocolError:
                self._telecommands.handle_result(
                    request, ok=False, selected=self.selected, now_ns=now_ns
                )
                continue
            if changed:
                self._number = max(now_ns, self._number + 1)
            self._open.append((request, self._number))
        self._acknowledge(now_ns)
        return self.selected != before

    def select(self, name: str, now_ns: int) -> bool:
        """The ground selects a camera; True if another one is selected now. ProtocolError."""
        if not self._selector.handle_select(name, now_ns).changed:
            return False
        self._number = max(now_ns, self._number + 1)
        return True

    def handle_confirmed(self, number: int, now_ns: int) -> None:
        """The sender has confirmed a choice: nothing of an earlier camera is coded or sent."""
        self._confirmed = number
        self._acknowledge(now_ns)

    def _acknowledge(self, now_ns: int) -> None:
        while self._open and self._confirmed is not None and self._open[0][1] <= self._confirmed:
            request, _ = self._open.popleft()
            self._telecommands.handle_result(
                request, ok=True, selected=self.selected, now_ns=now_ns
            )

    def poll_timeout(self) -> int:
        """When `handle_state` is due."""
        return self._housekeeping_ns

    def handle_state(self, state: WorldState, now_ns: int) -> None:
        """The robot's state, for the telemetry."""
        self._housekeeping_ns = now_ns + HOUSEKEEPING_INTERVAL_NS
        self._telecommands.handle_housekeeping(
            Housekeeping(self.selected, state.contact, state.force_n), now_ns
        )

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next packet of telemetry. Call until None."""
        return self._telecommands.poll_transmit(now_ns)

    def tell(self) -> None:
        """Put the counters into the probe."""
        telecommands = self._telecommands
        self._probe.tell(
            SelectorFigures(
                selected=self.selected,
                switches=self._selector.switches,
                telecommands=telecommands.executed,
                telecommands_repeated=telecommands.duplicates,
                garbage=telecommands.garbage,
            )
        )
