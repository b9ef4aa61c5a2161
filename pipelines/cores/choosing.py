"""Which camera goes up, by telecommand; and the telecommands' other end."""

from dataclasses import replace
from itertools import count

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.sources.selector import Selector
from pipelines.runtime.probe import Probe
from pipelines.setup.table import Setup
from telepresence.tmtc import (
    Housekeeping,
    SelectDone,
    SelectFailed,
    TelecommandReceiver,
    TelecommandSender,
)
from telepresence.world import WorldState

#: How often the robot's side reports its state. The link has room for it:
#: `telepresence.link.arithmetic.RESERVE_BPS`.
HOUSEKEEPING_INTERVAL_NS = 2 * NS_PER_S
#: What a telecommand and its answer may take beside the radio's delay.
_ANSWER_NS = 500 * NS_PER_MS


class CameraChoice:
    """Takes telecommands, and says which camera's pictures go on.

    After `handle_packet` and `handle_state` send what `poll_transmit` gives until None. `restamp`
    numbers each one that goes on.
    """

    def __init__(self, setup: Setup, probe: Probe, *, now_ns: int, selected: str = "") -> None:
        self._probe = probe
        self._telecommands = TelecommandReceiver()
        known = selected if selected in setup.cameras else setup.cameras[0]
        self._selector = Selector(setup.cameras, known)
        self._numbers = count()
        self._housekeeping_ns = now_ns

    @property
    def selected(self) -> str:
        return self._selector.selected

    def handle_packet(self, datagram: bytes, now_ns: int) -> bool:
        """A datagram of the telecommand port; True if another camera is selected now."""
        self._telecommands.handle_packet(datagram, now_ns)
        before = self.selected
        while (request := self._telecommands.next_event()) is not None:
            try:
                self._selector.handle_select(request.name, now_ns)
                ok = True
            except ProtocolError:
                ok = False
            self._telecommands.handle_result(request, ok=ok, selected=self.selected, now_ns=now_ns)
        return self.selected != before

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

    def restamp(self, stamp: CaptureStamp) -> CaptureStamp:
        """The stamp of a picture that goes on: its sequence counts all cameras'."""
        return replace(stamp, sequence=next(self._numbers))

    def tell(self) -> None:
        """Put the counters into the probe."""
        probe, telecommands = self._probe, self._telecommands
        probe.gauge("selected", self.selected)
        probe.total("switches", self._selector.switches)
        probe.total("telecommands", telecommands.executed)
        probe.total("telecommands_repeated", telecommands.duplicates)
        probe.total("garbage", telecommands.garbage)


class Console:
    """The operator's: sends telecommands, takes telemetry.

    After each input send what `poll_transmit` gives until None and drain `next_event`.
    """

    def __init__(self, setup: Setup, probe: Probe, *, first_token: int) -> None:
        self._probe = probe
        self._housekeeping = 0
        self.sender = telecommand_sender(setup, first_token=first_token)

    def select(self, camera: str, now_ns: int) -> int:
        """Ask for a camera; the token of the request."""
        return self.sender.select(camera, now_ns)

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        """A datagram of the telemetry port."""
        self.sender.handle_packet(datagram, now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next telecommand. Call until None."""
        return self.sender.poll_transmit(now_ns)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something next."""
        return self.sender.poll_timeout()

    def next_event(self) -> SelectDone | SelectFailed | None:
        """How a request ended, or None."""
        while (event := self.sender.next_event()) is not None:
            if not isinstance(event, Housekeeping):
                return event
            self._housekeeping += 1
            self._probe.gauge("camera", event.name)
            self._probe.gauge("force_n", event.force_n)
        return None

    def tell(self) -> None:
        """Put the counters into the probe."""
        probe, sender = self._probe, self.sender
        probe.total("telecommands", sender.sent)
        probe.total("telecommands_repeated", sender.repeated)
        probe.total("garbage", sender.garbage)
        probe.total("housekeeping", self._housekeeping)


def telecommand_sender(setup: Setup, *, first_token: int) -> TelecommandSender:
    """One that repeats no telecommand before its answer can have come."""
    delay_ns = setup.radio_profile.longest_delay_ns
    return TelecommandSender(first_token=first_token, timeout_ns=_ANSWER_NS + 2 * delay_ns)
