"""The receiver of pictures: stamps, damage and its healing, what it asks for."""

import pytest
from picture_stream import AHEAD_NS, PERIOD_NS, PictureStream, coded, make_receiver, make_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.h26x import recovery_point
from kontur_av.media import Quality
from kontur_av.rtp.wire import pack_rtp
from kontur_av.streams.paced_sender import UnitSent


@pytest.mark.rule("5")
def test_pictures_arrive_with_stamps_of_the_receivers_clock():
    stream = PictureStream().run(range(10))
    sent = [event for event in iter(stream.sender.next_event, None) if isinstance(event, UnitSent)]
    assert [event.capture_ns for event in sent] == [n * PERIOD_NS for n in range(10)]
    for number, (stamp, event) in enumerate(zip(stream.stamps, sent, strict=True)):
        assert abs(stamp.capture_ns - number * PERIOD_NS - AHEAD_NS) <= 11_112
        assert (stamp.sequence, stamp.source) == (number, "view")
        assert (stamp.quality, stamp.rtp_timestamp) == (Quality.FRESH, event.timestamp)
    counts = stream.receiver.counts
    assert (counts.frames_received, counts.rtp.rtp_packets) == (10, 10)
    counts = stream.sender.counts
    assert (counts.frames_captured, counts.frames_encoded) == (10, 10)
    assert (counts.frames_sent, counts.frames_refused) == (10, 0)


@pytest.mark.parametrize(
    ("numbers", "marks", "keys"),
    [
        # A loss is reported, and healed by a key picture.
        ({"lost": {4}}, "....D......", [6]),
        # Damage that only the decoder finds.
        ({"corrupt": {4}}, "....DD......", [6]),
        # After a pause the picture before the key picture refers to pictures that were lost.
        ({"lost": range(4, 15)}, "....-....", [16]),
    ],
)
def test_damage_is_healed_by_a_key_picture(numbers, marks, keys):
    last = 20 if len(numbers.get("lost", "")) > 1 else 12
    stream = PictureStream(**numbers).run(range(last))
    assert (stream.marks, stream.keys) == (marks, keys)
    counts = stream.receiver.counts
    assert (counts.pictures_asked_for, counts.frames_withheld) == (1, marks.count("-"))
    assert stream.sender.feedback.feedback_received == 1


@pytest.mark.parametrize(
    ("numbers", "marks", "answered", "healed"),
    [
        ({"lost": {4}}, "....D..........", [6], 1),
        # The answer is lost, too, and later ones ask again.
        ({"lost": {4, 6}}, "....DDDDDDDD..", [6, 14], 2),
        # A decoder that gives up needs a key picture.
        ({"lost": {4}, "undecoded": {5}}, "..............", [], 0),
    ],
)
def test_an_encoder_that_can_heals_without_a_key_picture(numbers, marks, answered, healed):
    stream = PictureStream(heals=True, **numbers).run(range(16))
    lost = [(number, one.lost) for number, one in enumerate(stream.codings) if one.lost is not None]
    assert lost == [(number, number - 4) for number in answered]
    assert (stream.marks, stream.keys) == (marks, [] if healed else [6])
    assert stream.sender.feedback.losses_healed == healed


def test_without_a_key_picture_damage_is_shown_200_ms_after_a_pause():
    stream = PictureStream(lost=range(4, 15), way_back=False).run(range(24))
    assert stream.marks == "....-------DD"


def test_a_wave_of_hevc_heals_though_its_pictures_cannot_be_decoded():
    options = {"codec": "h265", "way_back": False, "lost": {4}, "undecoded": range(5, 9)}
    stream = PictureStream(sei={6: [recovery_point(3)]}, **options).run(range(14))
    assert stream.marks == "." * 9


def test_damage_that_was_known_and_healed_hurts_no_later_picture():
    stream = PictureStream(lost={4}, late={5}).run(range(8))
    known = stream.units[4]
    assert known.lost_before
    assert stream.show(known, corrupt=True).quality is Quality.DAMAGED
    assert stream.run([8]).marks[-1] == "."


def test_undated_or_too_large_pictures_are_counted():
    receiver = make_receiver(largest=(64, 48))
    assert receiver.handle_picture(1, 64, 48, None) is None
    assert receiver.handle_picture(2, 48, 64, 5).capture_ns == 5
    assert receiver.handle_picture(3, 64, 52, 5) is None
    counts = receiver.counts
    assert (counts.frames_undated, counts.frames_oversized) == (1, 1)


def test_garbage_is_counted_and_changes_nothing():
    stream = PictureStream()
    stream.sender.handle_feedback(b"\x00nonsense", 0)
    stream.receiver.handle_packet(b"", 0)
    assert not stream.receiver.handle_report(b"\x81", 0)
    assert stream.run(range(2)).marks == ".."
    assert stream.sender.feedback.feedback_garbage == 1
    assert stream.receiver.counts.rtp.garbage == 2


def test_a_new_viewer_gets_a_key_picture():
    stream = PictureStream().run(range(4))
    stream.sender.handle_new_viewer()
    stream.run(range(4, 8))
    stream.receiver.handle_new_viewer()
    assert stream.run(range(8, 12)).keys == [4, 9]


def take(receiver, sender, numbers, **options):
    """Send pictures that are coded already; return the units that come, and the last instant."""
    units = []
    for number in numbers:
        now_ns = number * PERIOD_NS
        sender.handle_coded(coded(number, **options), now_ns)
        while (packet := sender.poll_transmit(now_ns)) is not None:
            receiver.handle_packet(packet, now_ns)
        receiver.handle_timeout(now_ns + 50 * NS_PER_MS)
        units += iter(receiver.next_event, None)
    return units, now_ns


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_what_cannot_be_decoded_asks_for_a_key_picture(codec):
    receiver = make_receiver(codec=codec, report_interval_ns=None, reduced_size=True)
    sender = make_sender()
    take(receiver, sender, [0], codec=codec, key=True)
    take(receiver, sender, [1, 2], codec=codec)
    receiver.handle_undecoded()
    take(receiver, sender, [3], codec=codec)
    assert len(receiver.poll_feedback(NS_PER_S)) == 12
    assert receiver.counts.pictures_asked_for == 1
    # It is repeated until the picture is whole.
    assert receiver.poll_timeout() == NS_PER_S + 250 * NS_PER_MS


def test_another_sender_may_be_another_camera():
    receiver = make_receiver(report_interval_ns=None)
    for ssrc in range(2):
        sender = make_sender(ssrc)
        begin = 30 * ssrc
        units, _ = take(receiver, sender, [begin], key=ssrc == 0)
        later, now_ns = take(receiver, sender, range(begin + 1, begin + 3))
        for unit in [*units, *later]:
            receiver.handle_picture(unit.timestamp, 64, 48, now_ns)
        assert (receiver.poll_feedback(now_ns) is not None) is (ssrc == 1)
    receiver.handle_report(sender.goodbye(now_ns), now_ns)
    assert receiver.ended
    sender.handle_coded(coded(40), 40 * PERIOD_NS)
    packet = sender.poll_transmit(40 * PERIOD_NS)
    receiver.handle_packet(packet[:1] + b"\x61" + packet[2:], now_ns)
    assert receiver.other_payload_type == 0x61


def test_a_picture_without_a_marker_is_shown_after_500_ms():
    receiver = make_receiver(report_interval_ns=None)
    fields = {"payload_type": 96, "marker": False, "timestamp": 0, "ssrc": 5}
    for number in range(2):
        packet = pack_rtp(b"\x41\x88" + bytes([7]) * 9, sequence=number, **fields)
        receiver.handle_packet(packet, number)
    assert receiver.next_event() is not None
    assert receiver.poll_timeout() is not None
    receiver.handle_timeout(NS_PER_S)
    assert receiver.next_event() is not None
