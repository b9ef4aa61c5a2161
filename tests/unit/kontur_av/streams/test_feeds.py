"""What feeds a stream and what comes out of it, on virtual time, without sockets."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES
from kontur_av.codecs.region import Focus, Region
from kontur_av.media import BLOCK_NS, AudioFrame, CaptureStamp, Quality
from kontur_av.rtp.sdp import parse_sdp, write_sdp
from kontur_av.streams.decoding import PictureDecoding, SoundDecoding
from kontur_av.streams.feeds import PictureFeed, SoundFeed, describe

SIZE, PERIOD_NS = (128, 96), 40 * NS_PER_MS


class Source:
    def __init__(self, clock):
        self.clock, self.number, self.closed, self.silent, self.late_ns = clock, 0, 0, False, 0

    def close(self):
        self.closed += 1


class Grey(Source):
    """Grey pictures, each brighter, one for each read."""

    def read(self, into, timeout_ns):
        if self.silent:
            return None
        into.fill(128)
        into[: SIZE[1]] = 60 + 10 * self.number
        self.number += 1
        return CaptureStamp(self.clock.now_ns(), self.number, "grey")


def pictures(codec="h264", **changes):
    clock = ManualClock(5 * NS_PER_S)
    source = Grey(clock)
    feed = PictureFeed(source, clock, size=SIZE, fps=25, cap_bps=300_000, codec=codec, **changes)
    return feed, source, clock


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_pictures_come_out_as_they_went_in(codec, monkeypatch):
    feed, source, clock = pictures(codec, regions=True)
    feed.focus, marked = Focus(0.0, 0.0, 0.5, 0.5), []
    monkeypatch.setattr(Region, "steps_after", lambda *of: marked.append(of) or 1)
    try:
        stream = parse_sdp(write_sdp(describe(feed, "127.0.0.1", 5004)))
        decoding = PictureDecoding(stream, clock)
        seen, asked = [], 0
        for number in range(10):
            feed.step(0)
            assert source.number == number + 1
            while not feed.sender.backlog_octets:
                # In the meantime no picture is taken.
                feed.step(NS_PER_S)
                assert source.number == number + 1
            while (packet := feed.sender.poll_transmit(clock.now_ns())) is not None:
                if number != 6:
                    decoding.receiver.handle_packet(packet, clock.now_ns())
            if (report := feed.sender.poll_report(clock.now_ns())) is not None:
                decoding.receiver.handle_report(report, clock.now_ns())
            decoding.receiver.handle_timeout(clock.now_ns() + 39 * NS_PER_MS)
            for unit, shown in decoding.units():
                assert unit.codec == codec
                # The very first picture has its date, number (from 1 here) and size.
                since_ns = decoding.receiver.capture_ns(unit.timestamp) - 5 * NS_PER_S
                told = round(since_ns / PERIOD_NS) + 1, *SIZE
                assert decoding.receiver.told(unit.timestamp) == told
                # The first picture has the parameter sets of the SDP.
                assert seen or all(one in unit.data for one in stream.parameter_sets)
                seen += [
                    (p.to_i420()[: SIZE[1]].mean(), stamp, p.width, p.height) for p, stamp in shown
                ]
            while decoding.receiver.poll_feedback(clock.now_ns()) is not None:
                asked += 1
            clock.advance_ns(PERIOD_NS)
    finally:
        feed.close()
    assert source.closed == 1 and marked
    numbers = [round((stamp.capture_ns - 5 * NS_PER_S) / PERIOD_NS) for _, stamp, *_ in seen]
    assert numbers[:6] == list(range(6)) and 6 not in numbers and asked > 0
    for (level, stamp, *size), number in zip(seen, numbers, strict=True):
        assert tuple(size) == SIZE
        if number < 6:
            assert abs(level - 60 - 10 * number) < 6
            assert stamp.quality is Quality.FRESH
        else:
            assert stamp.quality is Quality.DAMAGED


def test_a_stream_of_pictures_is_described_before_its_first_packet():
    feed, source, _ = pictures()
    try:
        stream = describe(feed, "::1", 5004)
        about = stream.kind, stream.host, stream.port, stream.payload_type
        assert about == ("video", "::1", 5004, 96)
        # A packet for each picture, and one more for each 1200 octets; IPv6, UDP and RTP: 60. An
        # extension of 12 octets for each picture, and one of 24 each second.
        headers = (25 + 300_000 / 8 / 1200) * 60 + 26 * 12
        assert stream.bandwidth_bps == 300_000 + round(headers * 8)
        assert [unit[0] & 31 for unit in stream.parameter_sets] == [7, 8]
        assert stream.profile_level_id and (stream.capture_time_id, stream.picture_id) == (1, 2)
        assert stream.feedback and stream.reduced_size
        assert feed.sender.cap_bps == feed.sender.channel_bps == 300_000
        assert source.number == 0 and feed.lookahead_ns == 0
        # Without a picture there is nothing to encode; after the end none is any more.
        source.silent = True
        feed.step(0)
        assert feed.sender.counts.frames_captured == 0
        source.silent = False
        feed.finish()
        assert feed.sender.poll_timeout() is None
    finally:
        feed.close()


class Tone(Source):
    def read(self, timeout_ns):
        if timeout_ns == 0:
            return None
        at = np.arange(960) + 960 * self.number
        self.number += 1
        stamp = CaptureStamp(self.clock.now_ns() - BLOCK_NS - self.late_ns, self.number, "tone")
        sound = (8000 * np.sin(2 * np.pi * 440 * at / 48_000)).astype(np.int16)
        return AudioFrame(sound, stamp)


def test_sound_comes_out_as_it_went_in():
    clock = ManualClock(5 * NS_PER_S)
    source = Tone(clock)
    feed = SoundFeed(source, clock, cap_bps=64_000, channel_bps=128_000)
    stream = parse_sdp(write_sdp(describe(feed, "127.0.0.1", 5004)))
    assert (stream.kind, stream.bandwidth_bps) == ("audio", 64_000 + 50 * 40 * 8 + 1000)
    assert (feed.sender.cap_bps, feed.sender.channel_bps) == (64_000, 128_000)
    assert feed.lookahead_ns == LOOKAHEAD_SAMPLES * NS_PER_S // 48_000
    decoding = SoundDecoding(stream, clock)
    heard = []
    for number in range(30):
        feed.step(0)
        assert feed.sender.backlog_octets == 0
        feed.step(NS_PER_S)
        packet = feed.sender.poll_transmit(clock.now_ns())
        if (report := feed.sender.poll_report(clock.now_ns())) is not None:
            decoding.receiver.handle_report(report, clock.now_ns())
        if number != 20:
            decoding.receiver.handle_packet(packet, clock.now_ns())
        clock.advance_ns(BLOCK_NS)
        decoding.receiver.handle_timeout(clock.now_ns())
        heard += decoding.blocks()
    assert decoding.receiver.poll_feedback(clock.now_ns()) is not None
    assert [decoded for _, _, decoded, _ in heard[:25]] == [n != 20 for n in range(25)]
    for number, (block, sound, decoded, stamp) in enumerate(heard[:25]):
        assert len(sound) == block.played_samples
        assert stamp.quality is (Quality.FRESH if decoded else Quality.CONCEALED)
        captured_ns = 5 * NS_PER_S + (number - 1) * BLOCK_NS - feed.lookahead_ns
        assert stamp.capture_ns == pytest.approx(captured_ns, abs=30_000)
        if 5 < number < 20:
            assert np.abs(sound.astype(int)).max() == pytest.approx(8000, rel=0.2)
    # A block that is too old is not encoded.
    source.late_ns = NS_PER_S
    feed.step(1)
    assert (feed.sender.counts.frames_refused, feed.sender.backlog_octets) == (1, 0)
    feed.finish()
    feed.close()
    assert source.closed == 1
