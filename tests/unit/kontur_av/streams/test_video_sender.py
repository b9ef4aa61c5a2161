"""The sender of pictures: when and how it encodes."""

import pytest
from picture_stream import PERIOD_NS, PictureStream, coded, make_receiver, make_sender

from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S
from kontur_av.media import CaptureStamp
from kontur_av.streams.paced_sender import EVENTS_KEPT
from kontur_av.streams.video_sender import PictureCoded

NS_PER_S = 1_000_000_000


def test_the_refresh_is_slow_while_the_receiver_is_heard():
    stream = PictureStream().run(range(60))
    stream.way_back = False
    (begin, slow), (at, fast) = stream.run(range(60, 340)).refreshes
    assert (begin, slow, fast) == (0, SLOW_REFRESH_S, REFRESH_S)
    # Seven seconds after the last report; they are at most 1.24 s apart.
    assert 60 + 210 - 38 <= at <= 60 + 211


def test_a_receiver_on_a_thin_channel_is_silent_without_losses():
    stream = PictureStream(receiver=make_receiver(report_interval_ns=None)).run(range(60))
    assert stream.receiver.poll_feedback(10**12) is None
    assert stream.receiver.poll_timeout() is None
    # A way back is assumed for half a second.
    assert stream.refreshes == [(0, SLOW_REFRESH_S), (16, REFRESH_S)]
    # An encoder with its own refresh gets none.
    assert PictureStream(make_sender(adapt_refresh=False)).run(range(40)).refreshes == []


def test_a_reported_channel_controls_the_refresh_and_key_pictures():
    stream = PictureStream(way_back=False)
    for number, (contacts, way_back) in enumerate([(3, True), (3, True), (4, True), (4, False)]):
        told_ns = number * PERIOD_NS
        stream.sender.handle_channel(0, told_ns, contacts=contacts, way_back=way_back)
        stream.step(number)
    assert stream.refreshes == [(0, SLOW_REFRESH_S), (3, REFRESH_S)]
    assert stream.keys == [2]


def test_octets_waiting_in_the_channel_delay_the_next_picture():
    sender = make_sender()
    sender.handle_channel(5000, 0, contacts=1, way_back=True)  # 40 ms of it
    sender.handle_picture(CaptureStamp(0, 0, "camera"), 0)
    assert sender.poll_encode(0) is None
    assert sender.poll_timeout() > 0
    sender.finish()
    assert sender.poll_timeout() is None
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (1, 1)


def test_another_cap_reaches_the_encoder_once_and_holds_from_then_on():
    stream = PictureStream().run([0])
    stream.sender.follow(cap_bps=1_100_000, channel_bps=2_000_000)
    stream.run([1, 2])
    assert [coding.cap_bps for coding in stream.codings] == [None, 1_100_000, None]
    assert (stream.sender.cap_bps, stream.sender.channel_bps) == (1_100_000, 2_000_000)
    # Below the first one packets are smaller, too: they fit 100 ms of it.
    stream.sender.follow(cap_bps=30_000, channel_bps=60_000)
    stream.step(30, octets=1500)
    assert stream.codings[-1].cap_bps == 30_000
    sent = [len(packet) for packet in iter(lambda: stream.sender.poll_transmit(10**10), None)]
    assert 200 < max(sent) <= 562 + 12
    with pytest.raises(ValueError, match="at least 1000"):
        stream.sender.follow(cap_bps=999, channel_bps=2_000_000)


def test_a_picture_has_stamps_of_arrival_and_coding():
    sender = make_sender()
    sender.handle_picture(CaptureStamp(0, 0, "camera"), 20, skipped=2)
    assert sender.poll_encode(30) is not None
    sender.handle_access_unit(coded(0, 3000, key=True), 40)
    event = sender.next_event()
    assert event == PictureCoded(event.timestamp, 0, 20, 30, 40, event.octets, 3)
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (3, 2)
    assert sender.backlog_octets == event.octets > 3000
    assert sender.oldest_age_ns(45) == 5
    # One that comes coded has one instant.
    sender.handle_coded(coded(1), 50)
    event = sender.next_event()
    assert (event.came_ns, event.begun_ns, event.encoded_ns) == (50, 50, 50)
    assert (sender.counts.frames_captured, sender.counts.frames_encoded) == (4, 2)
    assert sender.timestamp(NS_PER_S) == (2**32 - 9 + 90_000) % 2**32


def test_unfetched_events_drop_the_oldest():
    stream = PictureStream().run(range(EVENTS_KEPT), octets=20)
    assert len(list(iter(stream.sender.next_event, None))) == EVENTS_KEPT
