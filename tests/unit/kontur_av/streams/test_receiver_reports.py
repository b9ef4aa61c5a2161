"""Receiver reports of pictures and voices, as another implementation reads them."""

import pytest
from aiortc.rtp import RtcpPacket, RtcpPsfbPacket, RtcpRrPacket, RtcpSdesPacket
from rtp_packets import PromptSender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoiceReceiver

PERIOD_NS = 20 * NS_PER_MS
SLICE = b"\x00\x00\x01\x41\x88" + bytes([7]) * 50


def sender(rate_hz):
    return PromptSender(
        payload_type=96,
        clock_rate_hz=rate_hz,
        ssrc=9,
        first_sequence=65_534,
        timestamp_offset=0,
        cname="s",
    )


def packet_of(rtp, number):
    stamp = CaptureStamp(number * PERIOD_NS, number, "x")
    if rtp.clock_rate_hz == 48_000:
        (packet,) = rtp.audio_packets(b"\xf8\xff\xfe", stamp).packets
    else:
        (packet,) = rtp.video_packets(AccessUnit(SLICE, stamp, False)).packets
    return packet


RECEIVERS = {
    48_000: lambda: VoiceReceiver(ssrc=5, payload_type=96),
    90_000: lambda: VideoReceiver(ssrc=5, payload_type=96),
}


@pytest.mark.parametrize("rate_hz", RECEIVERS)
def test_reports_are_compound_with_a_block_of_what_came(rate_hz):
    rtp, receiver = sender(rate_hz), RECEIVERS[rate_hz]()
    reports, came_ns = [], []
    for number in range(200):
        now_ns = number * PERIOD_NS
        packet = packet_of(rtp, number)
        # Each tenth is lost; the others take 5 ms.
        if number % 10 != 9:
            receiver.handle_packet(packet, now_ns + 5 * NS_PER_MS)
        if (report := rtp.poll_report(now_ns)) is not None:
            receiver.handle_report(report, now_ns + 5 * NS_PER_MS)
        receiver.handle_timeout(now_ns + 19 * NS_PER_MS)
        while receiver.next_event() is not None:
            pass
        while (datagram := receiver.poll_feedback(now_ns + 19 * NS_PER_MS)) is not None:
            reports.append(RtcpPacket.parse(datagram))
            came_ns.append(now_ns + 19 * NS_PER_MS)
    # A first one at once, then one a second; more of them, if a picture asks for a key picture.
    assert 4 <= len(reports) < 25
    for compound in reports:
        first, second, *rest = compound
        assert isinstance(first, RtcpRrPacket) and isinstance(second, RtcpSdesPacket)
        assert all(isinstance(each, RtcpPsfbPacket) for each in rest)
        (chunk,) = second.chunks
        assert first.ssrc == chunk.ssrc == 5 and chunk.items[0] == (1, b"00000005@kontur-av")
    (block,) = reports[-1][0].reports
    last = int(came_ns[-1] / PERIOD_NS)
    lost = (last + 1) // 10
    assert block.ssrc == 9 and block.highest_sequence == 65_534 + last - (last % 10 == 9)
    assert abs(block.packets_lost - lost) <= 1
    assert 0 <= block.fraction_lost <= 256 // 5
    assert block.lsr and block.dlsr * NS_PER_S // 65_536 <= 2 * NS_PER_S
    assert block.jitter == 0


def test_without_reduced_size_a_report_precedes_what_asks_for_a_key_picture():
    for reduced in (False, True):
        rtp = sender(90_000)
        receiver = VideoReceiver(
            ssrc=5, payload_type=96, reduced_size=reduced, report_interval_ns=None
        )
        for number in (0, 1, 3):
            receiver.handle_packet(packet_of(rtp, number), number * PERIOD_NS)
        receiver.handle_timeout(NS_PER_S)
        while receiver.next_event() is not None:
            pass
        kinds = [type(each) for each in RtcpPacket.parse(receiver.poll_feedback(NS_PER_S))]
        before = [] if reduced else [RtcpRrPacket, RtcpSdesPacket]
        assert kinds == [*before, RtcpPsfbPacket]


def test_reports_of_this_software_ask_for_no_key_picture():
    rtp, receiver = sender(90_000), VideoReceiver(ssrc=5, payload_type=96)
    for number in range(3):
        receiver.handle_packet(packet_of(rtp, number), 0)
    # A picture came before, so none is asked for.
    receiver.handle_picture(0, 64, 48, None)
    while receiver.next_event() is not None:
        pass
    assert receiver.poll_timeout() is None
    receiver.handle_report(rtp.poll_report(0), 0)
    report = receiver.poll_feedback(0)
    listener = PictureLossListener(ssrc=9)
    listener.handle_feedback(report, 0)
    assert not listener.take(0) and listener.heard_ns == 0
    # The same report of a player that sends no PLI does.
    listener.handle_feedback(bytes(RtcpPacket.parse(report)[0]).replace(b"\x05", b"\x06", 1), 0)
    assert listener.take(0)


@pytest.mark.parametrize("rate_hz", RECEIVERS)
def test_without_a_sender_report_there_is_nowhere_to_send_one(rate_hz):
    rtp, receiver = sender(rate_hz), RECEIVERS[rate_hz]()
    if rate_hz == 90_000:
        # Otherwise it asks for a picture at which to begin.
        receiver.handle_picture(0, 64, 48, None)
    for number in range(300):
        receiver.handle_packet(packet_of(rtp, number), number * PERIOD_NS)
        while receiver.next_event() is not None:
            pass
        assert receiver.poll_feedback(number * PERIOD_NS) is None
