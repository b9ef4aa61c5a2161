"""The sender of a voice: what it encodes, and what it refuses because it would be late."""

from voice_ends import PACKET, make_voice_sender

from kontur_av.clock import NS_PER_MS
from kontur_av.media import BLOCK_NS, CaptureStamp


def test_a_block_that_is_too_old_is_not_encoded():
    sender = make_voice_sender()
    assert sender.handle_block(CaptureStamp(0, 0, "mic"), 100 * NS_PER_MS)
    assert not sender.handle_block(CaptureStamp(0, 1, "mic"), 101 * NS_PER_MS)
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (2, 1)
    assert sender.bitrate_bps == 7_600


def test_no_block_is_encoded_behind_one_that_waits_too_long():
    sender = make_voice_sender(channel_bps=None)
    for number in range(9):
        sender.handle_packet(PACKET, CaptureStamp(0, number, "mic"), 0)
    while sender.poll_transmit(0) is not None:
        pass
    now_ns = 120 * NS_PER_MS
    assert not sender.handle_block(CaptureStamp(now_ns - BLOCK_NS, 9, "mic"), now_ns)
    assert sender.oldest_age_ns(now_ns) == now_ns
    assert sender.backlog_octets > 0


def test_a_block_leaves_at_once_and_is_counted():
    sender = make_voice_sender()
    assert sender.poll_timeout() is None
    sender.handle_packet(PACKET, CaptureStamp(0, 0, "mic"), 5)
    assert sender.poll_timeout() == 5
    assert (sender.cap_bps, sender.channel_bps) == (8_000, 64_000)
    assert sender.poll_transmit(5) is not None
    counts = sender.counts
    assert (counts.frames_encoded, counts.frames_sent, counts.rtp_packets_sent) == (1, 1, 1)
    assert sender.released.events == 1


def test_a_receiver_that_is_there_only_now_gets_a_report_at_once():
    sender = make_voice_sender()
    sender.handle_contacts(0, 0)
    sender.handle_packet(PACKET, CaptureStamp(0, 0, "mic"), 0)
    assert sender.poll_transmit(0) is not None and sender.poll_report(0) is not None
    now_ns = 200 * NS_PER_MS
    assert sender.poll_report(now_ns) is None
    sender.handle_contacts(1, now_ns)
    assert sender.poll_report(now_ns) is not None
    sender.handle_contacts(1, now_ns)
    assert sender.poll_report(now_ns) is None
