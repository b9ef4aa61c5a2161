"""Lost packets sent again (generic NACK, RFC 4585 section 6.2.1): both ends.

A packet is sent again as it was, with its own sequence number. Retransmission in a stream of its
own (RFC 4588) is not used.
"""

from collections import OrderedDict
from itertools import pairwise
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.rtp.rtcp import RTCP_RTPFB_NACK, RtcpRtpfbPacket

#: The time between two requests for the same packet: longer than most round trips.
ASK_AGAIN_NS = 60 * NS_PER_MS
#: A packet that is older is not asked for any more, and not sent again.
TOO_OLD_NS = 250 * NS_PER_MS
#: The most packets that may be asked for at once. More missing ones are a picture loss.
MOST_MISSING = 128


class _Kept(NamedTuple):
    packet: bytes
    sent_ns: int


class PacketHistory:
    """The sender's end: keeps packets for a while, and returns those that are asked for.

    most_packets: kept; the oldest is dropped. again_ns: the least time between two repetitions of
    one packet. share: of what was sent in a second, the largest part that may be repeated.
    """

    def __init__(
        self, *, most_packets: int = 512, again_ns: int = 20 * NS_PER_MS, share: float = 0.25
    ) -> None:
        self._most_packets, self._again_ns, self._share = most_packets, again_ns, share
        self._kept: OrderedDict[int, _Kept] = OrderedDict()
        self._repeated_ns: dict[int, int] = {}
        self._second_ns = 0
        self._sent_octets = self._again_octets = 0
        #: Sequence numbers asked for; packets sent again; not sent: too old, too soon or too many.
        self.asked = self.repeated = self.refused = 0

    def handle_sent(self, sequence: int, packet: bytes, now_ns: int) -> None:
        """A packet with this 16-bit sequence number is sent."""
        self._begin_second(now_ns)
        self._sent_octets += len(packet)
        self._kept.pop(sequence, None)
        self._repeated_ns.pop(sequence, None)
        self._kept[sequence] = _Kept(packet, now_ns)
        while len(self._kept) > self._most_packets:
            dropped, _ = self._kept.popitem(last=False)
            self._repeated_ns.pop(dropped, None)

    def handle_lost(self, lost: list[int], now_ns: int) -> list[bytes]:
        """Return the packets to send again. lost: 16-bit sequence numbers of one NACK."""
        self._begin_second(now_ns)
        again: list[bytes] = []
        # A short burst is always allowed: a stream that has just begun has sent nothing yet.
        most_octets = max(int(self._sent_octets * self._share), 16_000)
        # An unknown sender may ask for anything, in any number.
        for sequence in lost[:MOST_MISSING]:
            self.asked += 1
            kept = self._kept.get(sequence)
            repeated_ns = self._repeated_ns.get(sequence)
            if (
                kept is None
                or now_ns - kept.sent_ns > TOO_OLD_NS
                or (repeated_ns is not None and now_ns - repeated_ns < self._again_ns)
                or self._again_octets + len(kept.packet) > most_octets
            ):
                self.refused += 1
                continue
            self._repeated_ns[sequence] = now_ns
            self._again_octets += len(kept.packet)
            self.repeated += 1
            again.append(kept.packet)
        return again

    def _begin_second(self, now_ns: int) -> None:
        if now_ns - self._second_ns >= NS_PER_S:
            self._second_ns = now_ns
            self._sent_octets //= 2
            self._again_octets = 0


class LossAsker:
    """The receiver's end. Call `handle_packet` for each packet, and send `poll_transmit`.

    ssrc: the receiver's own.
    """

    def __init__(self, *, ssrc: int) -> None:
        self._ssrc = ssrc
        self._media_ssrc: int | None = None
        self._highest = 0
        #: By 16-bit sequence number: missing since, and when to ask.
        self._missing: OrderedDict[int, tuple[int, int]] = OrderedDict()
        #: NACKs sent; packets that came after they were asked for; packets given up.
        self.sent = self.repaired = self.given_up = 0

    def handle_packet(self, media_ssrc: int, sequence: int, now_ns: int) -> None:
        """A packet of the stream has come, also one that was asked for."""
        if media_ssrc != self._media_ssrc:
            self._media_ssrc, self._highest = media_ssrc, sequence
            self._missing.clear()
            return
        if self._missing.pop(sequence, None) is not None:
            self.repaired += 1
            return
        ahead = (sequence - self._highest) & 0xFFFF
        if ahead == 0 or ahead >= 0x8000:
            return
        if ahead > MOST_MISSING:
            # Too many: a key picture fixes that.
            self._missing.clear()
        else:
            for step in range(1, ahead):
                self._missing[(self._highest + step) & 0xFFFF] = (now_ns, now_ns)
        self._highest = sequence
        while len(self._missing) > MOST_MISSING:
            self._missing.popitem(last=False)
            self.given_up += 1

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the NACK to send now, or None."""
        for sequence, (since_ns, _) in list(self._missing.items()):
            if now_ns - since_ns > TOO_OLD_NS:
                del self._missing[sequence]
                self.given_up += 1
        due = [sequence for sequence, (_, ask_ns) in self._missing.items() if ask_ns <= now_ns]
        if not due or self._media_ssrc is None:
            return None
        for sequence in due:
            self._missing[sequence] = (self._missing[sequence][0], now_ns + ASK_AGAIN_NS)
        self.sent += 1
        # Numbers are modular: behind 65535 a packet of its own begins.
        packets, media = [due[:1]], self._media_ssrc
        for before, sequence in pairwise(due):
            if sequence < before:
                packets.append([])
            packets[-1].append(sequence)
        return b"".join(
            bytes(RtcpRtpfbPacket(RTCP_RTPFB_NACK, self._ssrc, media, lost)) for lost in packets
        )

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_transmit` next; None while nothing is missing."""
        return min((ask_ns for _, ask_ns in self._missing.values()), default=None)
