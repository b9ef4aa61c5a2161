"""Both ends of a voice, without encoder and decoder."""

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_NS, CaptureStamp, Quality
from kontur_av.rtp.sender import RtpIdentity
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
