"""RTCP sender reports of the peer, told in the own clock. A core.

A sender report (RFC 3550, section 6.4.1) dates a stream in its sender's wall time. Receivers take
the wall time of their own machine off. So the gateway, which knows the difference of both clocks,
corrects each report on its way out. Then ages and stamps are right, whatever wall time the other
machine has.
"""

from collections import deque

from kontur_av.clock import NS_PER_S
from telepresence.link.clock.exchange import ClockExchange
from telepresence.link.flows import PacketReceived

#: Sender report: its RTCP packet type; where its NTP timestamp is.
_SENDER_REPORT = 200
_NTP_AT = slice(8, 16)
#: Reports are held back for this long if the peer's clock is not known.
PATIENCE_NS = 3 * NS_PER_S
#: Enough for the streams of a session.
_MOST_HELD = 8


class ReportClock:
    """Takes the peer's RTCP packets; `next_event` returns them with the own wall time.

    While the peer's clock is not known, the newest packet of each flow is held back for 3 s. With a
    peer that never tells its clock, all ages are by its wall time.
    """

    def __init__(self, clock: ClockExchange) -> None:
        self._clock = clock
        self._held: dict[str, PacketReceived] = {}
        self._since_ns = 0
        self._ready: deque[PacketReceived] = deque(maxlen=_MOST_HELD)

    def handle_report(self, event: PacketReceived) -> None:
        """An RTCP packet came. One of the same flow that is still held back is dropped."""
        if not self._held:
            self._since_ns = event.now_ns
        if len(self._held) < _MOST_HELD:
            self._held[event.flow.name] = event
        self.handle_time(event.now_ns)

    def handle_time(self, now_ns: int) -> None:
        """The time is `now_ns`. Call it again when something may be known of the peer's clock."""
        if not self._held:
            return
        estimate = self._clock.estimate(now_ns)
        if estimate is None and now_ns - self._since_ns < PATIENCE_NS:
            return
        behind_ns = 0 if estimate is None else estimate.offset_ns
        for event in self._held.values():
            self._ready.append(event._replace(data=earlier(event.data, behind_ns), now_ns=now_ns))
        self._held.clear()

    def next_event(self) -> PacketReceived | None:
        """Return a packet that is not held back any more, or None."""
        return self._ready.popleft() if self._ready else None


def earlier(packet: bytes, by_ns: int) -> bytes:
    """Return an RTCP packet whose sender report, if it begins with one, is earlier by `by_ns`."""
    if len(packet) < _NTP_AT.stop or packet[1] != _SENDER_REPORT or not by_ns:
        return packet
    ntp = int.from_bytes(packet[_NTP_AT], "big")
    shifted = (ntp - (by_ns << 32) // NS_PER_S) % (1 << 64)
    return packet[: _NTP_AT.start] + shifted.to_bytes(8, "big") + packet[_NTP_AT.stop :]
