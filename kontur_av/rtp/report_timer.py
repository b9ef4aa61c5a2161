"""When to send reports: the randomised interval of RTCP (RFC 3550 sections 6.2, 6.3 and A.7)."""

from math import e
from random import Random

from kontur_av.clock import NS_PER_S

#: The least mean time between two reports under the profile RTP/AVP (RFC 3550 section 6.2).
AVP_LEAST_NS = 5 * NS_PER_S
#: The same under RTP/AVPF, which sets no limit but the bandwidth (RFC 4585 section 3.4).
AVPF_LEAST_NS = NS_PER_S
#: A stream has one sender and one receiver.
_MEMBERS = 2
#: The part of the session's bandwidth that RTCP may take (RFC 3550 section 6.2).
_SHARE = 0.05
#: Timer reconsideration makes intervals longer; this makes up for it (RFC 3550 section 6.3.1).
_COMPENSATION = e - 1.5
#: Headers of IP version 4 and UDP count, too (RFC 3550 section 6.2).
_LOWER_OCTETS = 28
#: The size of a report before the first one (RFC 3550 section 6.3.2).
_PROBABLE_OCTETS = 72


def report_interval_ns(*, frequent: bool) -> int:
    """Return the least mean time between two reports. frequent: the profile is RTP/AVPF."""
    return AVPF_LEAST_NS if frequent else AVP_LEAST_NS


class ReportTimer:
    """Tells when a report is due. Call `handle_sent` for each compound packet that is sent.

    The time between two reports varies from 0.41 to 1.23 times the mean.
    The first report is due at once, as section 6.2 allows between one sender and one receiver.

    least_ns: the least mean time between two reports.
    bandwidth_bps: of the session, of which reports take at most 5 %; None: unknown.
    seed: of the random numbers, such as the own SSRC.
    """

    def __init__(self, *, least_ns: int, bandwidth_bps: int | None, seed: int) -> None:
        self._least_ns, self._bandwidth_bps = least_ns, bandwidth_bps
        self._random = Random(seed)
        self._mean_octets = float(_PROBABLE_OCTETS + _LOWER_OCTETS)
        self._last_ns: int | None = None
        self._due_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        """Media flows since `now_ns`; later calls change nothing."""
        if self._due_ns is None:
            self._due_ns = now_ns

    def poll_timeout(self) -> int | None:
        """Return when to call `is_due`; None before `begin`."""
        return self._due_ns

    def is_due(self, now_ns: int) -> bool:
        """Return whether to send a report now, after reconsideration (RFC 3550 section 6.3.6)."""
        if self._due_ns is None or now_ns < self._due_ns:
            return False
        if self._last_ns is not None:
            self._due_ns = self._last_ns + self._draw_ns()
        return now_ns >= self._due_ns

    def handle_sent(self, octets: int, now_ns: int) -> None:
        """A compound packet of this size was sent."""
        self._mean_octets += (octets + _LOWER_OCTETS - self._mean_octets) / 16
        self._last_ns = now_ns
        self._due_ns = now_ns + self._draw_ns()

    def _draw_ns(self) -> int:
        mean_ns = float(self._least_ns)
        if self._bandwidth_bps is not None:
            octets_hz = self._bandwidth_bps * _SHARE / 8
            mean_ns = max(mean_ns, _MEMBERS * self._mean_octets * NS_PER_S / octets_hz)
        return round(mean_ns * self._random.uniform(0.5, 1.5) / _COMPENSATION)
