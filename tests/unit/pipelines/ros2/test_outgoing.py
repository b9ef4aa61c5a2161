"""A subscriber in the middle of a stream gets a key picture first."""

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.ros2.outgoing import JoinedStream

KEY = b"\0\0\1\x67\1\0\0\1\x68\1\0\0\1\x65\1"
SETS = b"\0\0\1\x67\1\0\0\1\x68\1"


def unit(number):
    key = number == 0
    data = KEY if key else b"\0\0\1\x41" + bytes([number])
    return CodedUnit(data=data, key=key, width=64, height=48, parameter_sets=SETS)


def fed(stream, numbers, *, subscribed=True):
    for number in numbers:
        stamp = CaptureStamp(number * NS_PER_S // 25, number, "head")
        stream.handle_unit(unit(number), stamp, stamp.capture_ns, subscribed=subscribed)
    return list(stream.poll_transmit())


def test_units_wait_for_the_key_picture_of_who_joins():
    stream = JoinedStream()
    assert fed(stream, range(3), subscribed=False) == []
    stream.handle_subscriber(0)
    assert fed(stream, (3, 4)) == []
    wanted = stream.next_event()
    assert stream.next_event() is None
    # All until this one: a decoder of them shows the picture before it.
    assert wanted.units[0] == KEY and len(wanted.units) == 3
    stream.handle_key_picture(wanted.number, b"own")
    key, first, second = stream.poll_transmit()
    at_ns = 3 * NS_PER_S // 25
    assert key == (b"own", at_ns - 1000, "h264") and first.session_ns == at_ns
    assert first.data.endswith(unit(3).data) and second.data == unit(4).data
    assert [one.data for one in fed(stream, (5,))] == [unit(5).data]
    # The way to the subscriber may not have been there: once more, two seconds later.
    assert fed(stream, range(6, 52)) and stream.next_event() is not None


def test_a_key_picture_that_is_late_or_cannot_be_made_holds_nothing_up():
    stream = JoinedStream()
    fed(stream, range(3))
    stream.handle_subscriber(0)
    assert len(fed(stream, range(3, 40))) == 37
    wanted = stream.next_event()
    assert wanted is None or stream.handle_key_picture(wanted.number, b"own") is None
    assert list(stream.poll_transmit()) == []
    # Who joined has no picture yet: it is tried again, without being asked for.
    fed(stream, range(40, 90))
    stream.handle_key_picture(stream.next_event().number, b"own")
    assert next(stream.poll_transmit()).data == b"own"
    stream.handle_subscriber(5 * NS_PER_S)
    assert fed(stream, (140,)) == []
    stream.handle_key_picture(stream.next_event().number, None)
    assert len(list(stream.poll_transmit())) == 1
