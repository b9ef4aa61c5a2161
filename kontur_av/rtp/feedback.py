"""What a receiver tells its sender: reports, picture loss indications (PLI), and rates (REMB).

With a PLI (RFC 4585 section 6.3.1) the receiver of a damaged picture asks for a key picture. It is
sent alone where both ends know of reduced size (RFC 5506): 12 octets. Elsewhere a report precedes
it. While feedback arrives, the periodic intra refresh can be slow, which saves most of its octets.

Some receivers, such as ffplay, send receiver reports (RFC 3550 section 6.4.2) but no PLI. A new
receiver in them, and packets lost since the last one, ask for a key picture, too. Reports of a
receiver that sends PLIs, and of this software, ask for nothing.

Behind a PLI stands, once a picture was whole, an application layer feedback message (RFC 4585
section 6.4): the unique identifier KAVL, then the RTP timestamps of the newest picture that came
and of the newest one that is whole. So the sender need not code a key picture, and knows whether
its last answer had come: 24 octets.

A REMB is the receiver's estimate of the largest rate (draft-alvestrand-rmcat-remb-03).
"""

import struct
from collections import OrderedDict
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from kontur_av.rtp.reports import ReportTimer
from kontur_av.rtp.rtcp import (
    RTCP_PSFB_APP,
    RTCP_PSFB_PLI,
    SDES_TOOL,
    TOOL,
    RtcpPsfbPacket,
    RtcpReceiverInfo,
    RtcpRrPacket,
    RtcpSdesPacket,
    pack_remb_fci,
    parse_rtcp,
    receiver_report,
    unpack_remb_fci,
)

#: The time between two indications while pictures stay damaged: longer than most round trips.
ASK_AGAIN_NS = 250 * NS_PER_MS
#: A sender answers all indications within this time once: several may report the same loss.
ANSWER_ONCE_NS = 100 * NS_PER_MS
#: Reports of losses are answered no more often, because each key picture is coarse.
REPORTED_AGAIN_NS = 2 * NS_PER_S
#: The most receivers whose losses are remembered; the oldest is dropped.
_MOST_REPORTERS = 16
_WHOLE = struct.Struct("!4sII")
_WHOLE_IDENTIFIER = b"KAVL"


class WholePicture(NamedTuple):
    """What a receiver with damaged pictures has. RTP timestamps.

    newest: of the newest picture that came. whole: of the newest one that was decoded exactly.
    """

    newest: int
    whole: int


def whole_of(packet: RtcpPsfbPacket) -> WholePicture | None:
    """Return what a feedback message tells; None if it is of another kind."""
    named = packet.fmt == RTCP_PSFB_APP and packet.fci[:4] == _WHOLE_IDENTIFIER
    if not named or len(packet.fci) != _WHOLE.size:
        return None
    return WholePicture(*_WHOLE.unpack(packet.fci)[1:])


class ReceptionReporter:
    """When a receiver reports on its stream, and what (RFC 3550 sections 6.1 and 6.4.2).

    ssrc: the receiver's own, of 32 random bits. interval_ns: mean time between two reports; None:
    none is due by itself. bandwidth_bps: of the session, see `ReportTimer`.
    """

    def __init__(
        self, *, ssrc: int, interval_ns: int | None, bandwidth_bps: int | None = None
    ) -> None:
        self._ssrc = ssrc
        # A name that lasts as long as the SSRC.
        self._cname = f"{ssrc:08x}@kontur-av".encode()
        self._timer: ReportTimer | None = None
        if interval_ns is not None:
            self._timer = ReportTimer(least_ns=interval_ns, bandwidth_bps=bandwidth_bps, seed=ssrc)

    def handle_sender_report(self, now_ns: int) -> None:
        """A sender report came. The first one says where reports go, and makes one due."""
        if self._timer is not None:
            self._timer.begin(now_ns)

    def is_due(self, now_ns: int) -> bool:
        """Return whether to send `report` now."""
        return self._timer is not None and self._timer.is_due(now_ns)

    def report(
        self, block: RtcpReceiverInfo | None, now_ns: int, *, feedback: bytes = b""
    ) -> bytes:
        """Return the compound packet to send now: RR, SDES and feedback.

        block: see `RtpReceiver.report_block`.
        """
        compound = receiver_report(self._ssrc, block, self._cname) + feedback
        if self._timer is not None:
            self._timer.handle_sent(len(compound), now_ns)
        return compound

    def poll_timeout(self) -> int | None:
        """Return when the next report is due; None: not yet."""
        return None if self._timer is None else self._timer.poll_timeout()


class PictureLossReporter:
    """The receiver's end. Call `handle_picture` after each access unit; send `poll_transmit`.

    ssrc: the receiver's own, of 32 bits; it stands in each indication.
    ask_again_ns: the time between two indications while pictures stay damaged.
    """

    def __init__(self, *, ssrc: int, ask_again_ns: int = ASK_AGAIN_NS) -> None:
        self._ssrc = ssrc
        self._ask_again_ns = ask_again_ns
        self._media_ssrc = 0
        self._due_ns: int | None = None
        self.sent = 0

    def handle_picture(self, *, damaged: bool, media_ssrc: int, now_ns: int) -> None:
        """Handle a received picture. damaged: it, or a picture to which it refers, shows a loss."""
        self._media_ssrc = media_ssrc
        if not damaged:
            self._due_ns = None
        elif self._due_ns is None:
            self._due_ns = now_ns

    def poll_transmit(self, now_ns: int, has: WholePicture | None = None) -> bytes | None:
        """Return the indication to send now, or None. has: told with it."""
        if self._due_ns is None or now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + self._ask_again_ns
        self.sent += 1
        ends = self._ssrc, self._media_ssrc
        asked = bytes(RtcpPsfbPacket(RTCP_PSFB_PLI, *ends))
        if has is None:
            return asked
        fci = _WHOLE.pack(_WHOLE_IDENTIFIER, *has)
        return asked + bytes(RtcpPsfbPacket(RTCP_PSFB_APP, *ends, fci))

    def poll_timeout(self) -> int | None:
        """Return when `poll_transmit` has an indication; None while pictures are whole."""
        return self._due_ns


class PictureLossListener:
    """The sender's end. ssrc: of its stream; indications for other streams are ignored."""

    def __init__(self, *, ssrc: int, answer_once_ns: int = ANSWER_ONCE_NS) -> None:
        self._ssrc = ssrc
        self._answer_once_ns = answer_once_ns
        self._answered_ns: int | None = None
        self._asked = False
        #: Of receivers that told what they have, since the last answer.
        self._have: list[WholePicture] = []
        self._answer: int | None = None
        #: RTP timestamp of the newest picture that is whole for all that asked; None: not known.
        self.whole: int | None = None
        #: Of each receiver by its SSRC: the packets it has lost; None: it sends PLIs.
        self._lost: OrderedDict[int, int | None] = OrderedDict()
        #: When a report was answered.
        self._report_ns: int | None = None
        self.received = 0
        self.garbage = 0
        #: When the last RTCP datagram came, of any content.
        self.heard_ns: int | None = None

    def handle_feedback(self, datagram: bytes, now_ns: int) -> None:
        """Handle an RTCP datagram from the receiver. Garbage is counted and never raises."""
        try:
            packets = parse_rtcp(datagram)
        except ProtocolError:
            self.garbage += 1
            return
        self.heard_ns = now_ns
        for packet in packets:
            if isinstance(packet, RtcpSdesPacket):
                for chunk in packet.chunks:
                    if (SDES_TOOL, TOOL) in chunk.items:
                        self._remember(chunk.ssrc, None)
        own = [packet for packet in packets if isinstance(packet, RtcpPsfbPacket)]
        own = [packet for packet in own if packet.media_ssrc == self._ssrc]
        have = {packet.ssrc: has for packet in own if (has := whole_of(packet)) is not None}
        for packet in own:
            if packet.fmt == RTCP_PSFB_PLI:
                self.received += 1
                self._remember(packet.ssrc, None)
                if packet.ssrc in have and len(self._have) < _MOST_REPORTERS:
                    self._have.append(have[packet.ssrc])
                else:
                    self._asked = True
        for packet in packets:
            if isinstance(packet, RtcpRrPacket):
                for report in packet.reports:
                    if report.ssrc == self._ssrc:
                        self._handle_report(packet.ssrc, report.packets_lost, now_ns)

    def _handle_report(self, receiver: int, packets_lost: int, now_ns: int) -> None:
        before = self._lost.get(receiver, -1)
        if before is None or packets_lost <= before:
            return
        if self._report_ns is not None and now_ns - self._report_ns < REPORTED_AGAIN_NS:
            return  # the next report shows this loss, too
        self._remember(receiver, packets_lost)
        self._asked = True
        self._report_ns = now_ns

    def _remember(self, receiver: int, packets_lost: int | None) -> None:
        self._lost[receiver] = packets_lost
        if len(self._lost) > _MOST_REPORTERS:
            self._lost.popitem(last=False)

    def take(self, now_ns: int) -> bool:
        """Return whether the next picture is to mend a loss. Call it for each picture.

        A key picture always does; one that refers to pictures up to `whole` does, if it is known.
        """
        have = [one for one in self._have if self._unanswered(one)]
        asked, self._asked, self.whole = self._asked, False, None
        keyed_ns = self._answered_ns
        soon = keyed_ns is not None and now_ns - keyed_ns < self._answer_once_ns
        self._have = have if soon and not asked else []
        if soon or not (asked or have):
            return False
        if asked:
            self._answered_ns = now_ns
        else:
            first = have[0].whole
            self.whole = min(
                (one.whole for one in have), key=lambda at: serial_difference(at - first)
            )
        return True

    def handle_answer(self, timestamp: int, now_ns: int, *, key: bool) -> None:
        """A picture of this RTP timestamp mends all losses before it. key: as a key picture."""
        self._answer = timestamp
        if key:
            self._answered_ns = now_ns

    def _unanswered(self, has: WholePicture) -> bool:
        """Return whether a receiver had seen the last answer."""
        return self._answer is None or serial_difference(has.newest - self._answer) >= 0


def rate_message(rate_bps: int, *, ssrc: int, media_ssrcs: list[int]) -> bytes:
    """Return a REMB. ssrc: the receiver's own. media_ssrcs: the streams that share the rate."""
    fci = pack_remb_fci(rate_bps, media_ssrcs)
    return bytes(RtcpPsfbPacket(RTCP_PSFB_APP, ssrc, 0, fci))


def told_rate(packet: RtcpPsfbPacket) -> tuple[int, list[int]] | None:
    """Return the rate in bit/s and the streams that share it; None if `packet` is no REMB."""
    if packet.fmt != RTCP_PSFB_APP:
        return None
    try:
        return unpack_remb_fci(packet.fci)
    except ProtocolError:
        return None
