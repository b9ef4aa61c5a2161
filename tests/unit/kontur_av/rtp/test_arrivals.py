"""How long a missing packet is waited for."""

from kontur_av.rtp.arrivals import ReorderDepth

MS = 1_000_000
S = 1000 * MS


def depth():
    one = ReorderDepth(least_ns=10 * MS, most_ns=200 * MS)
    one.begin(0)
    return one


def test_the_wait_is_the_longest_until_a_path_is_known_and_then_the_least():
    one = depth()
    assert [one.depth_ns(now_ns) // MS for now_ns in (0, S - 1, S, 5 * S)] == [200, 200, 10, 10]
    one.begin(7 * S)
    assert [one.depth_ns(now_ns) // MS for now_ns in (8 * S - 1, 8 * S)] == [200, 10]


def test_the_wait_is_half_as_long_again_as_the_latest_packet_and_5_ms():
    one = depth()
    for late_ms, wait_ms in ((2, 10), (4, 11), (40, 65), (20, 65), (128, 197), (140, 200)):
        one.handle_late(late_ms * MS, 3 * S)
        assert one.depth_ns(3 * S) == wait_ms * MS


def test_what_came_late_is_remembered_for_10_to_20_s():
    one = depth()
    one.handle_late(40 * MS, 3 * S)
    for at_s, wait_ms in ((9.9, 65), (10, 65), (19.9, 65), (20, 10)):
        assert one.depth_ns(round(at_s * S)) == wait_ms * MS
    # Also if nothing happened meanwhile.
    for at_s, wait_ms in ((19.9, 65), (20, 10)):
        one = depth()
        one.handle_late(40 * MS, 3 * S)
        assert one.depth_ns(round(at_s * S)) == wait_ms * MS
    one = depth()
    one.handle_late(40 * MS, 3 * S)
    one.handle_late(10 * MS, 12 * S)
    assert [one.depth_ns(at_s * S) // MS for at_s in (12, 21, 22, 32)] == [65, 65, 20, 10]


def test_one_wait_alone_is_kept():
    one = ReorderDepth(least_ns=10 * MS, most_ns=10 * MS)
    one.begin(0)
    one.handle_late(100 * MS, 0)
    assert one.depth_ns(0) == one.depth_ns(5 * S) == 10 * MS
