"""Both ends of a voice, without encoder and decoder."""

from itertools import pairwise

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_NS, CaptureStamp, Quality
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.rtp.wire import pack_rtp
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender

#: A SILK packet of 20 ms with voice activity and without a copy of the one before.
PACKET = b"\x08\x80" + bytes(18)
LOOKAHEAD_NS = LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ


def make_sender(**changes):
    settings = {"cap_bps": 8_000, "channel_bps": 64_000, "cname": "test"}
    return VoiceSender(identity=RtpIdentity(5, 65_530, 2**32 - 960), **settings | changes)


def test_a_block_that_is_too_old_is_not_encoded():
    sender = make_sender()
    assert sender.handle_block(CaptureStamp(0, 0, "mic"), 100 * NS_PER_MS)
    assert not sender.handle_block(CaptureStamp(0, 1, "mic"), 101 * NS_PER_MS)
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (2, 1)
    assert sender.bitrate_bps == 7_600


def test_no_block_is_encoded_behind_one_that_waits_too_long():
    sender = make_sender(channel_bps=None)
    for number in range(9):
        stamp = CaptureStamp(0, number, "mic")
        sender.handle_packet(PACKET, stamp, 0)
    while sender.poll_transmit(0) is not None:
        pass
    now_ns = 120 * NS_PER_MS
    assert not sender.handle_block(CaptureStamp(now_ns - BLOCK_NS, 9, "mic"), now_ns)
    assert sender.oldest_age_ns(now_ns) == now_ns
    assert sender.backlog_octets > 0


def test_sound_is_dated_when_heard_and_a_lost_block_is_marked():
    sender = make_sender()
    receiver = VoiceReceiver(name="voice")
    stamps = []

    def play(until_ns):
        while (due_ns := receiver.poll_timeout()) is not None and due_ns <= until_ns:
            receiver.handle_timeout(due_ns)
            while (block := receiver.next_event()) is not None:
                stamps.append(
                    receiver.handle_sound(
                        block,
                        decoded=block.payload is not None,
                        capture_ns=receiver.capture_ns(block.timestamp),
                    )
                )

    for number in range(20):
        now_ns = number * BLOCK_NS + BLOCK_NS
        stamp = CaptureStamp(number * BLOCK_NS, number, "mic")
        play(now_ns)
        assert sender.handle_block(stamp, now_ns)
        sender.handle_packet(PACKET, stamp, now_ns)
        packet = sender.poll_transmit(now_ns)
        if (report := sender.poll_report(now_ns)) is not None:
            receiver.handle_report(report, now_ns)
        if number != 10:
            receiver.handle_packet(packet, now_ns)
        event = sender.next_event()
        assert (event.encoded_ns, event.sent_ns) == (now_ns, now_ns)
        assert event.capture_ns == stamp.capture_ns - LOOKAHEAD_NS
    play(20 * BLOCK_NS)
    assert [stamp.sequence for stamp in stamps] == list(range(len(stamps)))
    lost = [stamp for stamp in stamps if stamp.quality is Quality.CONCEALED]
    assert [round((stamp.capture_ns + LOOKAHEAD_NS) / BLOCK_NS) for stamp in lost] == [10]
    assert {stamp.quality for stamp in stamps} == {Quality.FRESH, Quality.CONCEALED}
    assert len(receiver.take_arrivals()) == 19
    assert receiver.take_arrivals() == []
    counts = receiver.counts
    assert (counts.rtp.rtp_packets, counts.frames_concealed, counts.frames_corrupt) == (19, 1, 0)
    assert (counts.frames_undated, counts.inserted_ns) == (0, 0)


def test_undated_sound_is_counted():
    sender, receiver = make_sender(), VoiceReceiver()
    for number in range(3):
        stamp = CaptureStamp(number * BLOCK_NS, number, "mic")
        sender.handle_packet(PACKET, stamp, stamp.capture_ns)
        packet = sender.poll_transmit(stamp.capture_ns)
        receiver.handle_packet(packet, stamp.capture_ns)
    receiver.handle_timeout(3 * BLOCK_NS)
    block = receiver.next_event()
    capture_ns = receiver.capture_ns(block.timestamp)
    assert receiver.handle_sound(block, decoded=True, capture_ns=capture_ns) is None
    assert receiver.handle_sound(block, decoded=False, capture_ns=1).quality is Quality.CONCEALED
    assert (receiver.counts.frames_undated, receiver.counts.frames_corrupt) == (1, 1)


def heard(receiver, until_ns):
    blocks = []
    while (due_ns := receiver.poll_timeout()) is not None and due_ns <= until_ns:
        receiver.handle_timeout(due_ns)
        receiver.poll_feedback(due_ns)
        blocks += iter(receiver.next_event, None)
    return [*blocks, *iter(receiver.next_event, None)]


@pytest.mark.parametrize(("lip_sync", "wait_ms"), [(True, 78), (False, None)])
def test_sound_waits_for_the_pictures_of_its_place(lip_sync, wait_ms):
    limits = {"oldest_picture_ns": 300 * NS_PER_MS, "oldest_sound_ns": 150 * NS_PER_MS}
    sender = make_sender(cap_bps=16_000)
    receiver = VoiceReceiver(**limits if lip_sync else {})
    for number in range(300):
        now_ns = number * BLOCK_NS + BLOCK_NS
        # Of 120 ms, which sound may be ahead of by 45 ms; the margin is 3 ms.
        receiver.handle_picture_shown(now_ns, 120 * NS_PER_MS)
        sender.handle_packet(PACKET, CaptureStamp(number * BLOCK_NS, number, "mic"), now_ns)
        receiver.handle_packet(sender.poll_transmit(now_ns), now_ns)
        if (report := sender.poll_report(now_ns)) is not None:
            receiver.handle_report(report, now_ns)
        for block in heard(receiver, now_ns):
            latency_ns = block.play_ns - receiver.capture_ns(block.timestamp)
    if wait_ms is None:
        assert latency_ns < 50 * NS_PER_MS
    else:
        assert abs(latency_ns - wait_ms * NS_PER_MS) < NS_PER_MS
    counts = receiver.counts
    # How long it waits above the quickest transit: a block, the look-ahead, and the wait.
    least_ns = BLOCK_NS + LOOKAHEAD_NS
    assert abs(latency_ns - counts.playout_delay_ns - least_ns) < NS_PER_MS
    assert counts.frames_received == counts.frames_decoded >= 290


def test_timestamps_that_count_too_slowly_are_multiplied():
    receiver = VoiceReceiver()
    blocks = []
    for number in range(40):
        now_ns = number * BLOCK_NS
        packet = pack_rtp(
            PACKET, payload_type=97, marker=False, sequence=number, timestamp=480 * number, ssrc=5
        )
        receiver.handle_packet(packet, now_ns)
        blocks += heard(receiver, now_ns)
    stamps = [block.timestamp for block in blocks if block.payload][8:]
    assert {(later - early) % 2**32 for early, later in pairwise(stamps)} == {960}
    assert len(receiver.take_arrivals()) == 40


def test_inserted_and_invalid_sound_is_counted():
    receiver = VoiceReceiver()
    inserted = PlayoutBlock(None, 0, 480, 0, 480, inserted=True)
    stamp = receiver.handle_sound(inserted, decoded=False, capture_ns=7)
    assert (stamp.capture_ns, stamp.quality, stamp.source) == (7, Quality.CONCEALED, "voice")
    broken = PlayoutBlock(b"\xff", 5, 960, 0, 960)
    assert receiver.handle_sound(broken, decoded=False, capture_ns=8).sequence == 1
    counts = receiver.counts
    assert (counts.inserted_ns, counts.frames_corrupt) == (10 * NS_PER_MS, 1)
    assert (counts.frames_decoded, counts.frames_concealed) == (-1, 1)


def test_padding_is_no_sound_and_arrivals_that_nobody_takes_are_256():
    receiver = VoiceReceiver(ssrc=3, report_interval_ns=NS_PER_S)
    for number in range(300):
        payload = PACKET if number % 2 == 0 else b""
        packet = pack_rtp(
            payload,
            payload_type=97,
            marker=False,
            sequence=number,
            timestamp=number * 960,
            ssrc=5,
        )
        receiver.handle_packet(packet, number * BLOCK_NS)
    assert len(receiver.take_arrivals()) == 150
    for number in range(300, 600):
        packet = pack_rtp(
            PACKET, payload_type=97, marker=False, sequence=number, timestamp=number * 960, ssrc=5
        )
        receiver.handle_packet(packet, number * BLOCK_NS)
    arrivals = receiver.take_arrivals()
    assert len(arrivals) == 256
    assert arrivals[-1] == (599 * 960, 599 * BLOCK_NS)
    # Nobody has said yet where reports go.
    assert receiver.poll_feedback(10**12) is None


def test_a_block_leaves_at_once_and_is_counted():
    sender = make_sender()
    assert sender.poll_timeout() is None
    sender.handle_packet(PACKET, CaptureStamp(0, 0, "mic"), 5)
    assert sender.poll_timeout() == 5
    assert (sender.cap_bps, sender.channel_bps) == (8_000, 64_000)
    assert sender.poll_transmit(5) is not None
    assert (sender.counts.frames_encoded, sender.counts.frames_sent) == (1, 1)
    assert sender.counts.rtp_packets_sent == 1
    assert sender.released.events == 1
