"""Picture loss indications: the receiver of a damaged picture asks for one that needs no other.

RFC 4585 clause 6.3.1 (PLI), sent alone as RFC 5506 allows: 12 octets, on a channel where each
counts. Healing on demand spares the periodic refresh most of its octets, as long as there is a way
back.
"""

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.rtp.wire import RTCP_PSFB_PLI, RtcpPsfbPacket, parse_rtcp

#: While a picture stays damaged, it is asked for again this often: longer than most round trips.
ASK_AGAIN_NS = 250 * NS_PER_MS
#: A sender that is asked by several, or twice for the same loss, answers once in this time.
ANSWER_ONCE_NS = 100 * NS_PER_MS


class PictureLossReporter:
    """The receiver's end. ssrc: its own, told in each indication.

    Tell it after each access unit whether the picture shows damage; send what `poll_transmit`
    gives.
    """

    def __init__(self, *, ssrc: int, ask_again_ns: int = ASK_AGAIN_NS) -> None:
        self._ssrc = ssrc
        self._ask_again_ns = ask_again_ns
        self._media_ssrc = 0
        self._due_ns: int | None = None
        self.sent = 0

    def handle_picture(self, *, damaged: bool, media_ssrc: int, now_ns: int) -> None:
        """A picture was received, and whether it or what it refers to is damaged or missing."""
        self._media_ssrc = media_ssrc
        if not damaged:
            self._due_ns = None
        elif self._due_ns is None:
            self._due_ns = now_ns

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The indication to send now, or None."""
        if self._due_ns is None or now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + self._ask_again_ns
        self.sent += 1
        return bytes(RtcpPsfbPacket(RTCP_PSFB_PLI, self._ssrc, self._media_ssrc))

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something."""
        return self._due_ns


class PictureLossListener:
    """The sender's end. ssrc: of the stream; indications for any other are not its concern."""

    def __init__(self, *, ssrc: int, answer_once_ns: int = ANSWER_ONCE_NS) -> None:
        self._ssrc = ssrc
        self._answer_once_ns = answer_once_ns
        self._answered_ns: int | None = None
        self._asked = False
        self.received = 0
        self.garbage = 0
        #: When the last RTCP datagram came, of any content.
        self.heard_ns: int | None = None

    def handle_feedback(self, datagram: bytes, now_ns: int) -> None:
        """An RTCP datagram from the receiver. Garbage is counted; this never raises."""
        try:
            packets = parse_rtcp(datagram)
        except ProtocolError:
            self.garbage += 1
            return
        self.heard_ns = now_ns
        for packet in packets:
            if (
                isinstance(packet, RtcpPsfbPacket)
                and packet.fmt == RTCP_PSFB_PLI
                and packet.media_ssrc == self._ssrc
            ):
                self.received += 1
                self._asked = True

    def take(self, now_ns: int) -> bool:
        """Whether the next picture shall be one that needs no other; asked for each picture."""
        if not self._asked:
            return False
        answered_ns = self._answered_ns
        self._asked = False
        if answered_ns is not None and now_ns - answered_ns < self._answer_once_ns:
            return False
        self._answered_ns = now_ns
        return True
