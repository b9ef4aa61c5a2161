"""The cap that the units of a recorded stream need. A core."""

from collections.abc import Sequence

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.budget import Pacer

#: Under a lower cap a packet may wait so much longer than under the recorded one.
MOST_MORE_NS = 100 * NS_PER_MS
#: Caps are named in steps of this.
_STEP_BPS = 1000


def longest_wait_ns(
    units: Sequence[tuple[int, int]], *, cap_bps: int, channel_bps: int, payload_octets: int
) -> int:
    """Return the longest that a packet waits for its release.

    units: (instant, octets) of each, in order. channel_bps: of the link, for media.
    payload_octets: the largest payload of a packet.
    """
    pacer = Pacer(cap_bps=cap_bps, channel_bps=max(cap_bps, channel_bps))
    largest = min(payload_octets, pacer.max_payload_octets)
    for at_ns, octets in units:
        _drain(pacer, at_ns)
        sizes = [largest] * (octets // largest) + [octets % largest] * bool(octets % largest)
        pacer.handle_access_unit([b""] * len(sizes), sizes, at_ns)
    _drain(pacer, None)
    return pacer.longest_wait_ns


def _drain(pacer: Pacer, until_ns: int | None) -> None:
    while (due_ns := pacer.poll_timeout()) is not None:
        if until_ns is not None and due_ns >= until_ns:
            return
        pacer.poll_transmit(due_ns)


def cap_needed_bps(
    units: Sequence[tuple[int, int]],
    *,
    cap_bps: int,
    recorded_bps: int,
    channel_bps: int,
    payload_octets: int,
    speed: float = 1.0,
) -> int:
    """Return `cap_bps` if it carries the units about as soon as the cap of their recording did.

    Else the lowest cap that does, in whole kbit/s. The arguments of `longest_wait_ns`; speed: how
    much faster they come than when they were recorded.
    """

    def wait_ns(cap_bps: int, units: Sequence[tuple[int, int]]) -> int:
        return longest_wait_ns(
            units, cap_bps=cap_bps, channel_bps=channel_bps, payload_octets=payload_octets
        )

    if cap_bps >= recorded_bps * max(speed, 1.0):
        return cap_bps
    most_ns = wait_ns(recorded_bps, units) + MOST_MORE_NS
    faster = [(round(at_ns / speed), octets) for at_ns, octets in units]
    if wait_ns(cap_bps, faster) <= most_ns:
        return cap_bps
    low, high = cap_bps // _STEP_BPS, -(-round(recorded_bps * max(speed, 1.0)) // _STEP_BPS)
    while high - low > 1:
        middle = (low + high) // 2
        if wait_ns(middle * _STEP_BPS, faster) <= most_ns:
            high = middle
        else:
            low = middle
    return high * _STEP_BPS
