"""Packets and reports of a sender: octets from the standards, timestamps, markers, gaps."""

from dataclasses import replace

import pytest
from rtp_packets import PromptSender, make_sender, picture, singles

from kontur_av.clock import NS_PER_MS, NS_PER_S, unix_ns_from_ntp
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.rtcp import parse_rtcp
from kontur_av.rtp.sender import RtpIdentity, RtpSender
from kontur_av.rtp.wire import parse_rtp

BLOCK_NS = 20 * NS_PER_MS


def robot() -> PromptSender:
    return make_sender(
        ssrc=0xDEADBEEF, first_sequence=0x1234, timestamp_offset=0x01000000, cname="robot"
    )


def blocks(captures_ns, numbers=None):
    """Return the packets of a voice captured then, parsed."""
    rtp = make_sender(clock_rate_hz=48_000, timestamp_offset=0)
    for number, capture_ns in zip(numbers or range(len(captures_ns)), captures_ns, strict=True):
        (packet,) = rtp.audio_packets(b"\x08", CaptureStamp(capture_ns, number, "mic")).packets
        yield parse_rtp(packet)


def test_an_rtp_packet_octet_for_octet():
    # 1 s after the epoch of the clock: 90000 = 0x15F90 ticks after the offset.
    stamp = CaptureStamp(NS_PER_S, 0, "left")
    unit = AccessUnit(b"\x00\x00\x00\x01\x41\x9a\x55", stamp, False)
    (packet,) = robot().video_packets(unit).packets
    # V=2, no padding, extension or CSRC | marker, type 96 | sequence | timestamp | SSRC | NAL unit
    assert packet == bytes.fromhex("80 e0 1234 01015f90 deadbeef 419a55")


def test_a_sender_report_octet_for_octet():
    rtp, capture_ns = robot(), 1_500_000_000  # 1.5 s after 1970: NTP 2208988801.5
    stamp = CaptureStamp(capture_ns, 0, "left")
    rtp.video_packets(AccessUnit(b"\x00\x00\x01\x41\x9a\x55", stamp, False))
    assert rtp.poll_report(capture_ns) == bytes.fromhex(
        "80 c8 0006 deadbeef"  # V=2, no report blocks, SR, 7 words
        "83aa7e81 80000000"  # NTP: 2208988801 s and a half
        "01020f58"  # RTP: 0x01000000 + 135000
        "00000001 00000003"  # one packet, three octets
        "81 ca 0003 deadbeef"  # V=2, one chunk, SDES, 4 words in all
        "01 05 726f626f74 00"  # CNAME "robot", end, padded to a word
    )


def test_sequence_numbers_and_timestamps_wrap_around_and_the_last_packet_has_the_marker():
    for index, packet in enumerate(map(parse_rtp, singles(20))):
        assert packet.sequence_number == (65_530 + index) % 65_536
        assert packet.timestamp == (2**32 - 5000 + 3000 * index) % 2**32
    packets = [parse_rtp(p) for p in make_sender().video_packets(picture(0, octets=5000)).packets]
    assert [packet.marker for packet in packets] == [0, 0, 0, 0, 1]
    assert len({packet.timestamp for packet in packets}) == 1


@pytest.mark.parametrize(
    ("at", "numbers", "markers"),
    [
        ((0, 1, 2, 5, 6), (0, 1, 2, 5, 6), (1, 0, 0, 1, 0)),
        # If the source drops late blocks, only the capture times show it.
        ((0, 1, 4, 5), (0, 1, 2, 3), (1, 0, 1, 0)),
        # A microphone that was restarted does not turn time back.
        ((0, 100, 101), (100, 0, 1), (1, 1, 0)),
    ],
)
def test_a_gap_of_the_microphone_is_a_jump_of_the_timestamp_and_a_marker(at, numbers, markers):
    packets = list(blocks([one * BLOCK_NS for one in at], numbers))
    assert tuple(packet.timestamp / 960 for packet in packets) == at
    assert tuple(packet.marker for packet in packets) == markers


def test_drift_and_jitter_of_a_sound_card_make_no_gap():
    """200 parts in a million too slow, each block up to 6 ms early or late: 960 ticks a packet."""
    captures = [n * 20_004_000 + (n * 7919 % 13 - 6) * NS_PER_MS for n in range(10_000)]
    for number, packet in enumerate(blocks(captures)):
        assert packet.timestamp == number * 960


@pytest.mark.parametrize("late_ms", [14, 15, 34, 35, -60])
def test_a_block_is_missing_from_three_quarters_of_its_time_on(late_ms):
    _, packet = blocks([NS_PER_S, NS_PER_S + BLOCK_NS + late_ms * NS_PER_MS])
    missing = max(0, (late_ms + 5) // 20)
    assert (packet.timestamp, packet.marker) == (960 * (1 + missing), missing > 0)


def test_reports_come_with_the_first_packet_and_then_about_each_second():
    rtp = make_sender()
    assert (rtp.poll_report(0), rtp.poll_timeout(), rtp.goodbye(0)) == (None, None, None)
    rtp.video_packets(picture(0))
    assert rtp.poll_timeout() == 0
    assert rtp.poll_report(5) is not None
    sent_ns = [5]
    while len(sent_ns) < 200:
        due_ns = rtp.poll_timeout()
        assert rtp.poll_report(due_ns - 1) is None
        if rtp.poll_report(due_ns) is not None:
            sent_ns.append(due_ns)
    assert sent_ns[-1] / 199 == pytest.approx(NS_PER_S, rel=0.1)


def test_a_report_tells_its_own_instant_and_what_was_sent_by_then():
    settings = {"payload_type": 96, "clock_rate_hz": 90_000, "ssrc": 9, "first_sequence": 0}
    rtp = RtpSender(**settings, timestamp_offset=7, cname="x", wall_offset_ns=NS_PER_S)
    made = rtp.video_packets(picture(0))
    assert rtp.poll_report(0) is None
    # The picture waited for 0.3 s, and the report is sent half a second after its capture.
    rtp.handle_sent(made.packets[0], 300 * NS_PER_MS)
    rtp.video_packets(picture(12))
    report, _ = parse_rtcp(rtp.poll_report(NS_PER_S // 2))
    info = report.sender_info
    # To half a tick: the NTP time is that of the RTP time, without a rounding error.
    assert unix_ns_from_ntp(info.ntp_timestamp) == pytest.approx(3 * NS_PER_S // 2, abs=5556)
    assert info.rtp_timestamp == 7 + 45_000
    assert (info.packet_count, info.octet_count) == (1, made.payload_octets[0])


def test_a_goodbye_has_a_report_before_it_and_a_name_has_255_octets():
    rtp = make_sender(cname="x" * 300)
    rtp.video_packets(picture(0))
    report, description, goodbye = parse_rtcp(rtp.goodbye(NS_PER_S))
    assert report.sender_info.rtp_timestamp == (2**32 - 5000 + 90_000) % 2**32
    assert description.chunks[0].items == [(1, b"x" * 255)]
    assert goodbye.sources == [1]
    with pytest.raises(ValueError, match="without a NAL unit"):
        rtp.video_packets(replace(picture(0), data=b""))
    sound = make_sender(clock_rate_hz=48_000, timestamp_offset=7)
    made = sound.audio_packets(b"\x08", CaptureStamp(NS_PER_S, 0, "mic"))
    assert (made.timestamp, made.payload_octets) == (7, [1])


def test_an_identity_has_as_many_random_bits_as_its_fields():
    assert RtpIdentity.draw(lambda bits: (1 << bits) - 1) == RtpIdentity(
        ssrc=0xFFFF_FFFF, first_sequence=0xFFFF, timestamp_offset=0xFFFF_FFFF
    )
