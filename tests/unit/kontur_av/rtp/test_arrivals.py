"""How long a missing packet is waited for."""

import pytest

from kontur_av.rtp.arrivals import ReorderDepth, Transits

MS = 1_000_000
S = 1000 * MS


@pytest.mark.parametrize(
    ("late", "waits"),
    [
        # The longest until a path is known, and then the least.
        ((), {0: 200, 0.999: 200, 1: 10, 5: 10}),
        # Half as long again as the latest packet, and 5 ms.
        (((2, 3),), {3: 10}),
        (((4, 3),), {3: 11}),
        (((40, 3), (20, 3)), {3: 65}),
        (((40, 3), (128, 3)), {3: 197}),
        (((140, 3),), {3: 200}),
        # It is remembered for 10 to 20 s, also if nothing happened meanwhile.
        (((40, 3),), {9.9: 65, 10: 65, 19.9: 65, 20: 10}),
        (((40, 3),), {19.9: 65}),
        (((40, 3),), {20: 10}),
        (((40, 3), (10, 12)), {12: 65, 21: 65, 22: 20, 32: 10}),
    ],
)
def test_the_wait_follows_what_came_late(late, waits):
    """late: by how many ms, and when in s. waits: by the instant in s, in ms."""
    depth = ReorderDepth(least_ns=10 * MS, most_ns=200 * MS)
    depth.begin(0)
    for late_ms, at_s in late:
        depth.handle_late(late_ms * MS, at_s * S)
    assert {at_s: depth.depth_ns(round(at_s * S)) / MS for at_s in waits} == waits
    depth.begin(40 * S)
    assert [depth.depth_ns(now_ns) // MS for now_ns in (41 * S - 1, 41 * S)] == [200, 10]


def test_one_wait_alone_is_kept():
    depth = ReorderDepth(least_ns=10 * MS, most_ns=10 * MS)
    depth.begin(0)
    depth.handle_late(100 * MS, 0)
    assert depth.depth_ns(0) == depth.depth_ns(5 * S) == 10 * MS


def test_a_transit_counts_for_exactly_the_window():
    transits = Transits(window_ns=10, late_allowed=0)
    for now_ns, transit_ns, bound_ns in ((0, 9, 9), (10, 2, 9), (11, 3, 3)):
        transits.handle_arrival(now_ns, transit_ns)
        assert transits.bound_ns == bound_ns
