"""The common part of video and voice senders: budget, RTP and counts."""

from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

from kontur_av.meters import RateMeter
from kontur_av.rtp.sender import Packetized, RtpSender
from kontur_av.streams.budget import Pacer

#: The most events kept for a caller that takes none; the oldest is dropped.
EVENTS_KEPT = 256


class UnitSent(NamedTuple):
    """The last packet of a picture or of a block of sound has left.

    timestamp: its 32-bit RTP timestamp. capture_ns, encoded_ns, sent_ns: its instants.
    """

    timestamp: int
    capture_ns: int
    encoded_ns: int
    sent_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SenderCounts:
    """The sender of a stream, in pictures or blocks of sound."""

    #: Pictures or blocks of sound at the sender.
    frames_captured: int = 0
    frames_encoded: int = 0
    frames_sent: int = 0
    #: Pictures or blocks never encoded: the channel was busy, or they were too old.
    frames_refused: int = 0
    rtp_packets_sent: int = 0


@dataclass(slots=True)
class _UnderWay:
    """A coded picture or block of sound with packets that wait in the pacer."""

    packets: int
    timestamp: int
    capture_ns: int
    encoded_ns: int


class PacedSender:
    """Base of the senders: it paces packets, and notes when the last one of each unit leaves."""

    def __init__(self, pacer: Pacer, rtp: RtpSender) -> None:
        self._pacer = pacer
        self._rtp = rtp
        self._under_way: deque[_UnderWay] = deque()
        self._contacts: int | None = None
        self._encoded = 0
        self._sent = 0
        self._events: deque[Any] = deque(maxlen=EVENTS_KEPT)

    def handle_contacts(self, contacts: int, now_ns: int) -> bool:
        """Return whether contact with the other end has begun; contacts: how often it has so far.

        Then a report is due, because what was sent without contact did not arrive.
        """
        begun = self._contacts is not None and contacts != self._contacts
        self._contacts = contacts
        if begun:
            self._rtp.handle_contact(now_ns)
        return begun

    @property
    def cap_bps(self) -> int:
        """The present cap in bit/s."""
        return self._pacer.cap_bps

    @property
    def channel_bps(self) -> int:
        """The present rate of the channel in bit/s."""
        return self._pacer.channel_bps

    @property
    def released(self) -> RateMeter:
        """Payload rates of released packets: the mean, and the largest over a window."""
        return self._pacer.released

    @property
    def backlog_octets(self) -> int:
        """Payload octets that wait for release."""
        return self._pacer.backlog_octets

    def oldest_age_ns(self, now_ns: int) -> int:
        """Return how long the oldest packet has waited for release; 0 while none waits."""
        return self._pacer.oldest_age_ns(now_ns)

    def _counts(self, *, captured: int, refused: int) -> SenderCounts:
        return SenderCounts(
            frames_captured=captured,
            frames_encoded=self._encoded,
            frames_sent=self._sent,
            frames_refused=refused,
            rtp_packets_sent=self._rtp.packets_sent,
        )

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next RTP packet if it may leave now. Send it; call until None."""
        packet = self._pacer.poll_transmit(now_ns)
        if packet is None:
            return None
        self._rtp.handle_sent(packet, now_ns)
        unit = self._under_way[0]
        unit.packets -= 1
        if unit.packets == 0:
            self._under_way.popleft()
            self._sent += 1
            sent = UnitSent(unit.timestamp, unit.capture_ns, unit.encoded_ns, now_ns)
            self._events.append(sent)
        return packet

    def poll_report(self, now_ns: int) -> bytes | None:
        """Return the sender report (RFC 3550 section 6.4.1) for the RTCP port, if one is due.

        Call it after each `poll_transmit`. Reports date packets that were sent, so they have no
        timeout of their own.
        """
        return self._rtp.poll_report(now_ns)

    def goodbye(self, now_ns: int) -> bytes | None:
        """Return the last RTCP datagram (BYE), after which a new sender is accepted at once.

        None if nothing was sent.
        """
        return self._rtp.goodbye(now_ns)

    def _queue(self, packetized: Packetized, capture_ns: int, encoded_ns: int) -> None:
        packets, timestamp, octets = packetized
        self._encoded += 1
        self._under_way.append(_UnderWay(len(packets), timestamp, capture_ns, encoded_ns))
        self._pacer.handle_access_unit(packets, octets, encoded_ns)
