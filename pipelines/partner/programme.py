"""What partners may watch: one picture and one voice, to any number of connections. A shell."""

from collections.abc import Callable

from kontur_av.media import AccessUnit, CaptureStamp
from pipelines.partner.description import Kind
from pipelines.partner.peer import RtcPeer


class Programme:
    """A picture with its voice, sent to each of its peers.

    name: in its address. sends: by kind, the usual bit/s.
    want_key: called with a peer that needs a key picture.
    """

    def __init__(
        self, name: str, *, sends: dict[Kind, int], want_key: Callable[[RtcPeer], None]
    ) -> None:
        self.name, self.sends, self.want_key = name, sends, want_key
        self.peers: set[RtcPeer] = set()

    def send_unit(self, unit: AccessUnit) -> None:
        """Send an access unit to all."""
        for peer in self.peers:
            peer.send_unit(unit)

    def send_opus(self, opus: bytes, stamp: CaptureStamp) -> None:
        """Send an Opus packet to all."""
        for peer in self.peers:
            peer.send_opus(opus, stamp)

    @property
    def wish_bps(self) -> int | None:
        """The lowest rate that a peer says it can take; None if none says any."""
        wishes = [peer.media.wish_bps for peer in self.peers if peer.media is not None]
        return min((wish for wish in wishes if wish is not None), default=None)
