"""The thin channel between sender and receiver: a FIFO of a fixed rate. A core."""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_S


class Departure(NamedTuple):
    """A datagram that has passed the channel. due_ns: when its last bit passed."""

    due_ns: int
    port: int
    datagram: bytes


class ThinChannel:
    """Passes datagrams on in order, each after the time that its octets take at `rate_bps`.

    All octets of a datagram count (RTP with its header, RTCP), but not those of UDP and IP.
    The queue is unlimited and drops nothing.
    """

    def __init__(self, rate_bps: int) -> None:
        self._rate_bps = rate_bps
        self._free_ns = 0
        self._queue: deque[Departure] = deque()
        self.longest_wait_ns = 0

    def handle_datagram(self, datagram: bytes, port: int, now_ns: int) -> None:
        """A whole datagram has come at `now_ns` to the port of index `port`."""
        begin_ns = max(self._free_ns, now_ns)
        # Rounded up, so that no datagram leaves before its last bit.
        self._free_ns = begin_ns - (-len(datagram) * 8 * NS_PER_S // self._rate_bps)
        self.longest_wait_ns = max(self.longest_wait_ns, begin_ns - now_ns)
        self._queue.append(Departure(self._free_ns, port, datagram))

    def poll_transmit(self, now_ns: int) -> Departure | None:
        """The next datagram that has passed by now. Call until None."""
        if self._queue and self._queue[0].due_ns <= now_ns:
            return self._queue.popleft()
        return None

    def poll_timeout(self) -> int | None:
        return self._queue[0].due_ns if self._queue else None


def rtp_payload_octets(datagram: bytes) -> int:
    """Octets of an RTP packet without its header (RFC 3550 section 5.1); padding counts."""
    if len(datagram) < 12:
        return 0
    header = 12 + 4 * (datagram[0] & 0x0F)
    if datagram[0] & 0x10 and len(datagram) >= header + 4:
        header += 4 + 4 * int.from_bytes(datagram[header + 2 : header + 4], "big")
    return max(len(datagram) - header, 0)


#: Octets of the authentication tag behind a packet (RFC 3711 section 3.4).
_SRTP_TAG = 10


def muxed_payload_octets(datagram: bytes) -> int | None:
    """Octets of payload of an SRTP packet; None for what else shares the port of a WebRTC peer.

    RFC 7983 tells STUN and DTLS apart by the first octet, RFC 5761 section 4 RTCP by the second.
    """
    if len(datagram) < 12 or datagram[0] >> 6 != 2 or 64 <= datagram[1] & 0x7F < 96:
        return None
    return max(rtp_payload_octets(datagram) - _SRTP_TAG, 0)
