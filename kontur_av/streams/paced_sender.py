"""What a sender of pictures and a sender of sound have in common: budget, RTP, and its figures."""

from collections import deque
from typing import NamedTuple

from kontur_av.meters import RateMeter
from kontur_av.rtp.sender import Packetized, RtpSender
from kontur_av.streams.budget import Pacer

#: Events that are kept for a caller that takes none; the oldest goes.
EVENTS_KEPT = 256


class UnitSent(NamedTuple):
    """The last packet of a picture or of a block of sound has left.

    timestamp: its RTP timestamp. capture_ns, encoded_ns, sent_ns: its instants.
    """

    timestamp: int
    capture_ns: int
    encoded_ns: int
    sent_ns: int


class _UnderWay:
    """A coded picture or block of sound of which packets still wait in the pacer."""

    __slots__ = ("capture_ns", "encoded_ns", "packets", "timestamp")

    def __init__(self, packets: int, timestamp: int, capture_ns: int, encoded_ns: int) -> None:
        self.packets = packets
        self.timestamp = timestamp
        self.capture_ns = capture_ns
        self.encoded_ns = encoded_ns


class PacedSender:
    """Packets wait for their leave, and each unit's last one is noted. Base of the senders."""

    def __init__(self, pacer: Pacer, rtp: RtpSender) -> None:
        self._pacer = pacer
        self._rtp = rtp
        self._under_way: deque[_UnderWay] = deque()
        self._encoded = 0
        self._sent = 0

    @property
    def cap_bps(self) -> int:
        """The cap that holds now."""
        return self._pacer.cap_bps

    @property
    def channel_bps(self) -> int:
        """The rate at which packets leave now."""
        return self._pacer.channel_bps

    @property
    def released(self) -> RateMeter:
        """What has left, by payload octets: the mean rate, and the largest of any window."""
        return self._pacer.released

    @property
    def backlog_octets(self) -> int:
        """Payload octets that wait for their leave."""
        return self._pacer.backlog_octets

    def oldest_age_ns(self, now_ns: int) -> int:
        """How long the oldest packet has waited for its leave; 0 when none waits."""
        return self._pacer.oldest_age_ns(now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next RTP packet, if it may leave now. Send it, and call until None."""
        packet = self._pacer.poll_transmit(now_ns)
        if packet is None:
            return None
        unit = self._under_way[0]
        unit.packets -= 1
        if unit.packets == 0:
            self._under_way.popleft()
            self._sent += 1
            self._note(UnitSent(unit.timestamp, unit.capture_ns, unit.encoded_ns, now_ns))
        return packet

    def poll_report(self, now_ns: int) -> bytes | None:
        """The sender report (RFC 3550 section 6.4.1) to send to the RTCP port, if one is due.

        Ask after each `poll_transmit`: reports have no timeout of their own, because they date
        what was sent.
        """
        return self._rtp.poll_report(now_ns)

    def goodbye(self) -> bytes | None:
        """The last RTCP datagram, so that a successor is believed at once; None if nothing was
        sent."""
        return self._rtp.goodbye()

    def _queue(self, packetized: Packetized, capture_ns: int, encoded_ns: int) -> None:
        packets, timestamp, octets = packetized
        self._encoded += 1
        self._under_way.append(_UnderWay(len(packets), timestamp, capture_ns, encoded_ns))
        self._pacer.handle_access_unit(packets, octets, encoded_ns)

    def _note(self, event: UnitSent) -> None:
        raise NotImplementedError
