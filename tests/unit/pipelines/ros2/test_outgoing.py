"""A subscriber in the middle of a stream gets a key picture first."""

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.ros2.outgoing import JoinedStream

KEY = b"\0\0\1\x67\1\0\0\1\x68\1\0\0\1\x65\1"
SETS = b"\0\0\1\x67\1\0\0\1\x68\1"


def unit(number, *, added=False):
    key = number == 0 or added
    data = KEY if key else b"\0\0\1\x41" + bytes([number])
    return CodedUnit(data=data, key=key, width=64, height=48, parameter_sets=SETS, added=added)


def fed(stream, numbers, *, subscribed=True, added=False):
    passed = []
    for number in numbers:
        stamp = CaptureStamp(number * NS_PER_S // 25, number, "head")
        coded = unit(number, added=added)
        passed += stream.handle_unit(coded, stamp, stamp.capture_ns, subscribed=subscribed)
    return [(each.stamp.sequence, each.unit.added) for each in passed]


def plain(numbers):
    return [(number, False) for number in numbers]


def test_units_wait_for_the_key_picture_of_who_joins():
    stream = JoinedStream()
    assert fed(stream, range(3), subscribed=False) == []
    stream.handle_subscriber(0)
    assert stream.poll_ask(0)
    assert fed(stream, (3, 4)) == []
    assert fed(stream, (3,), added=True) == [(3, False), (3, True), (4, False)]
    assert not stream.poll_ask(NS_PER_S)
    assert fed(stream, range(5, 50)) == plain(range(5, 50))
    # The way to the subscriber may not have been there: once more, two seconds later.
    assert fed(stream, (50,)) == [] and stream.poll_ask(2 * NS_PER_S)
    assert fed(stream, (50,), added=True) == [(50, False), (50, True)]
    # Of others, a key picture is not published.
    assert fed(stream, (50,), added=True) == []


def test_a_key_picture_that_is_late_holds_nothing_up():
    stream = JoinedStream()
    fed(stream, range(3))
    stream.handle_subscriber(0)
    assert fed(stream, range(3, 40)) == plain(range(3, 40))
    # Who joined has no picture yet: it is tried again, without being asked for.
    assert not stream.poll_ask(2 * NS_PER_S)
    fed(stream, range(40, 80))
    assert stream.poll_ask(3 * NS_PER_S)
    assert fed(stream, (79,), added=True)[-1] == (79, True)
