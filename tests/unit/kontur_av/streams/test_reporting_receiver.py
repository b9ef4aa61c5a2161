"""Receiver reports of pictures and voices, as another implementation reads them."""

import pytest
from aiortc.rtp import RtcpPacket, RtcpPsfbPacket, RtcpRrPacket, RtcpSdesPacket
from rtp_packets import make_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoiceReceiver

PERIOD_NS = 20 * NS_PER_MS
SLICE = b"\x00\x00\x01\x41\x88" + bytes([7]) * 50
RECEIVERS = {48_000: VoiceReceiver, 90_000: VideoReceiver}


class Path:
    """A sender whose packets and reports take 5 ms to a receiver; each picture is decoded."""

    def __init__(self, rate_hz=90_000, **options):
        identity = {"ssrc": 9, "first_sequence": 65_534, "timestamp_offset": 0}
        self.rtp = make_sender(clock_rate_hz=rate_hz, **identity)
        self.receiver = RECEIVERS[rate_hz](ssrc=5, payload_type=96, **options)
        self.answers = []

    def send(self, numbers, *, lost=lambda number: False, reports=True):
        for number in numbers:
            now_ns = number * PERIOD_NS
            stamp = CaptureStamp(now_ns, number, "x")
            if self.rtp.clock_rate_hz == 48_000:
                (packet,) = self.rtp.audio_packets(b"\xf8\xff\xfe", stamp).packets
            else:
                (packet,) = self.rtp.video_packets(AccessUnit(SLICE, stamp, False)).packets
            if not lost(number):
                self.receiver.handle_packet(packet, now_ns + 5 * NS_PER_MS)
            report = self.rtp.poll_report(now_ns) if reports else None
            if report is not None:
                self.receiver.handle_report(report, now_ns + 5 * NS_PER_MS)
            self.hear(now_ns + 19 * NS_PER_MS)

    def hear(self, now_ns):
        """Take the datagrams that are due, parsed, and their instant."""
        self.receiver.handle_timeout(now_ns)
        while self.receiver.next_event() is not None:
            pass
        while (datagram := self.receiver.poll_feedback(now_ns)) is not None:
            self.answers.append((now_ns, RtcpPacket.parse(datagram)))


@pytest.mark.parametrize("rate_hz", RECEIVERS)
def test_reports_are_compound_with_a_block_of_what_came(rate_hz):
    path = Path(rate_hz)
    path.send(range(200), lost=lambda number: number % 10 == 9)
    # A first one at once, then one a second; more of them, if a picture asks for a key picture.
    assert 4 <= len(path.answers) < 25
    for _, (first, second, *rest) in path.answers:
        assert isinstance(first, RtcpRrPacket) and isinstance(second, RtcpSdesPacket)
        assert all(isinstance(each, RtcpPsfbPacket) for each in rest)
        (chunk,) = second.chunks
        assert first.ssrc == chunk.ssrc == 5 and chunk.items[0] == (1, b"00000005@kontur-av")
    came_ns, (report, *_) = path.answers[-1]
    (block,) = report.reports
    last = int(came_ns / PERIOD_NS)
    assert block.ssrc == 9 and block.highest_sequence == 65_534 + last - (last % 10 == 9)
    assert abs(block.packets_lost - (last + 1) // 10) <= 1
    assert 0 <= block.fraction_lost <= 256 // 5
    assert block.lsr and block.dlsr * NS_PER_S // 65_536 <= 2 * NS_PER_S
    assert block.jitter == 0


@pytest.mark.parametrize("reduced", [False, True])
def test_without_reduced_size_a_report_precedes_what_asks_for_a_key_picture(reduced):
    path = Path(reduced_size=reduced, report_interval_ns=None)
    path.send((0, 1, 3), reports=False)
    before = [] if reduced else [RtcpRrPacket, RtcpSdesPacket]
    for _, answer in path.answers:
        assert [type(each) for each in answer] == [*before, RtcpPsfbPacket]
    assert path.answers
