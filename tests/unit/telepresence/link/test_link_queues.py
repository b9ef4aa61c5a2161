"""Queues: depth, age and drops by policy."""

from telepresence.link.queues import DropPolicy, PacketQueue, QueueLimits

MS = 1_000_000


def queue(policy, depth_octets=100, max_age_ns=50 * MS):
    return PacketQueue(QueueLimits(depth_octets=depth_octets, max_age_ns=max_age_ns, policy=policy))


def taken(packets, now_ns=0):
    out = []
    while packets.waiting(now_ns):
        out.append(packets.take(now_ns)[1])
    return out


def test_reject_newest():
    packets = queue(DropPolicy.REJECT_NEWEST)
    assert packets.handle_packet(0, b"a" * 60, 0)
    assert not packets.handle_packet(0, b"b" * 60, 0)
    assert packets.handle_packet(0, b"c" * 40, 0)
    assert packets.report(0).drops == {"full": 1, "expired": 0, "signal_lost": 0}
    assert taken(packets) == [b"a" * 60, b"c" * 40]


def test_drop_oldest():
    packets = queue(DropPolicy.DROP_OLDEST)
    for octet in b"abc":
        assert packets.handle_packet(0, bytes([octet]) * 40, 0)
    assert taken(packets) == [b"b" * 40, b"c" * 40]
    assert not packets.handle_packet(0, b"x" * 101, 0)
    assert packets.report(0).drops == {"full": 2, "expired": 0, "signal_lost": 0}


def test_too_old_is_dropped_and_counted():
    packets = queue(DropPolicy.DROP_OLDEST)
    packets.handle_packet(0, b"old", 0)
    packets.handle_packet(0, b"young", 10 * MS)
    assert packets.waiting(50 * MS)
    report = packets.report(55 * MS)
    assert report.drops == {"full": 0, "expired": 1, "signal_lost": 0}
    assert (report.packets, report.octets, report.oldest_age_ns) == (1, 5, 45 * MS)
    assert (report.max_octets, report.max_age_ns) == (8, 50 * MS)
    assert taken(packets, 60 * MS) == [b"young"]


def test_patience_applies_only_if_shorter_than_the_limit():
    packets = queue(DropPolicy.REJECT_NEWEST)
    packets.set_patience(20 * MS)
    packets.handle_packet(0, b"old", 0)
    packets.handle_packet(0, b"young", 10 * MS)
    assert taken(packets, 25 * MS) == [b"young"]
    packets.set_patience(None)
    packets.handle_packet(0, b"patient", 30 * MS)
    assert taken(packets, 70 * MS) == [b"patient"]
    packets.set_patience(1000 * MS)
    packets.handle_packet(0, b"expired", 100 * MS)
    assert taken(packets, 151 * MS) == []
    assert packets.report(0).drops == {"full": 0, "expired": 1, "signal_lost": 1}


def test_flush():
    packets = queue(DropPolicy.REJECT_NEWEST)
    packets.handle_packet(0, b"too old", 0)
    packets.handle_packet(0, b"waiting", 40 * MS)
    packets.flush(1, 60 * MS)
    report = packets.report(60 * MS)
    assert report.drops == {"full": 0, "expired": 1, "signal_lost": 2}
    assert (report.packets, report.octets, report.max_age_ns) == (0, 0, 50 * MS)
