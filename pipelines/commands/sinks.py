"""What becomes of a received stream: pictures or sound, counts, and perhaps a file."""

import secrets
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h264 import H264Decoder
from kontur_av.codecs.healing import Healing
from kontur_av.meters import Histogram
from kontur_av.rtp.feedback import PictureLossReporter
from kontur_av.rtp.packets import RtcpRrPacket
from kontur_av.rtp.payload_h264 import H264Depacketizer
from kontur_av.rtp.playout import PlayoutBuffer
from kontur_av.rtp.receiver import RtpReceived, RtpReceiver
from kontur_av.rtp.sdp import StreamDescription
from kontur_av.rtp.wire import TimestampUnwrapper
from kontur_av.streams.voice_player import VoicePlayer
from pipelines.commands.raw_pictures import RawPictures
from pipelines.commands.remux import MatroskaWriter

#: How often a sender is told that it is heard.
_ALIVE_NS = NS_PER_S


class _TimeLine:
    """RTP timestamps as ticks since the first one; a restarted sender's go on where they were."""

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._unwrapper = TimestampUnwrapper()
        self._base = self._last = 0
        self._last_ns: int | None = None

    def ticks(self, timestamp: int, now_ns: int) -> int:
        ticks = self._base + self._unwrapper.unwrap(timestamp)
        if self._last_ns is not None:
            passed = (now_ns - self._last_ns) * self._rate_hz // NS_PER_S
            if abs(ticks - self._last - passed) > 10 * self._rate_hz:
                self._unwrapper = TimestampUnwrapper()
                self._base = self._last + max(passed, 1)
                ticks = self._base + self._unwrapper.unwrap(timestamp)
        self._last, self._last_ns = ticks, now_ns
        return ticks


class VideoSink:
    """Packets in order to access units, to pictures."""

    def __init__(
        self,
        stream: StreamDescription,
        writer: MatroskaWriter | None,
        raw: RawPictures | None = None,
    ) -> None:
        self.receiver: RtpReceiver
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self._raw = raw
        self._depacketizer = H264Depacketizer(stream.parameter_sets)
        self._healing = Healing()
        self._ssrc = secrets.randbits(32)
        self._losses = PictureLossReporter(ssrc=self._ssrc)
        self._begun = False
        self._alive_ns = 0
        self._decoder = H264Decoder(reordered=True)
        self._time_line = _TimeLine(stream.clock_rate_hz)
        self._writer = writer
        self._size: tuple[int, int] | None = None

    @property
    def decoded(self) -> int:
        return self._decoder.decoded

    def handle_packet(self, packet: RtpReceived, clock: MonotonicClock) -> None:
        self._depacketizer.handle_packet(packet)
        while (unit := self._depacketizer.next_event()) is not None:
            hurt = self._healing.handle_unit(unit)
            pictures = self._decoder.decode(unit.data, unit.timestamp)
            self._begun = self._begun or bool(pictures)
            self._losses.handle_picture(
                damaged=hurt or not self._begun,
                media_ssrc=self.receiver.ssrc or 0,
                now_ns=unit.received_ns,
            )
            capture_ns = self.receiver.capture_ns(unit.timestamp)
            if capture_ns is not None:
                self.received_ns.add(unit.received_ns - capture_ns)
            for picture in pictures:
                if self._raw is not None:
                    self._raw.handle_picture(picture)
                self._size = (picture.width, picture.height)
                shown_ns = self.receiver.capture_ns(picture.timestamp)
                if shown_ns is not None:
                    self.decoded_ns.add(clock.now_ns() - shown_ns)
            if self._writer is not None:
                ticks = self._time_line.ticks(unit.timestamp, unit.received_ns)
                self._writer.add_unit(unit.data, ticks, keyframe=unit.keyframe)

    def poll_feedback(self, now_ns: int) -> bytes | None:
        """RTCP for the sender: that a picture is missing, or each second that it is heard."""
        if (asked := self._losses.poll_transmit(now_ns)) is not None:
            return asked
        if self.receiver.ssrc is None or now_ns - self._alive_ns < _ALIVE_NS:
            return None
        self._alive_ns = now_ns
        # RFC 3550 section 6.4.2: a report without blocks, as from who has nothing to report.
        return bytes(RtcpRrPacket(self._ssrc))

    def poll_timeout(self) -> int | None:
        return self._losses.poll_timeout()

    def handle_timeout(self, now_ns: int) -> None:
        pass

    def report(self) -> dict[str, Any]:
        return {
            "size": self._size,
            "frames_received": self._depacketizer.units,
            "frames_damaged": self._depacketizer.units_damaged,
            "frames_decoded": self._decoder.decoded,
            "frames_corrupt": self._decoder.corrupt_units,
            "frames_before_start": self._decoder.units_before_start,
            "pictures_asked_for": self._losses.sent,
        }


class AudioSink:
    """Packets through the jitter buffer to sound."""

    def __init__(self, writer: MatroskaWriter | None) -> None:
        self.receiver: RtpReceiver
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self.decoded = 0
        self._concealed = self._corrupt = 0
        self._playout = PlayoutBuffer()
        self._player = VoicePlayer()
        self._time_line = _TimeLine(48_000)
        self._writer = writer

    def handle_packet(self, packet: RtpReceived, clock: MonotonicClock) -> None:
        capture_ns = self.receiver.capture_ns(packet.timestamp)
        if capture_ns is not None:
            self.received_ns.add(packet.received_ns - capture_ns)
        self._playout.handle_packet(packet)
        self._drain()

    def poll_feedback(self, now_ns: int) -> bytes | None:
        return None

    def poll_timeout(self) -> int | None:
        return self._playout.poll_timeout()

    def handle_timeout(self, now_ns: int) -> None:
        self._playout.handle_timeout(now_ns)
        self._drain()

    def _drain(self) -> None:
        while (block := self._playout.next_event()) is not None:
            _, decoded = self._player.play(block)
            if not decoded:
                self._corrupt += block.payload is not None
                # Before the first packet there is nothing to make up anything from.
                self._concealed += block.payload is None and self.decoded > 0
                continue
            self.decoded += 1
            capture_ns = self.receiver.capture_ns(block.timestamp)
            if capture_ns is not None:
                self.decoded_ns.add(block.play_ns - capture_ns)
            if self._writer is not None and block.payload is not None and not block.recovered:
                ticks = self._time_line.ticks(block.timestamp, block.play_ns)
                self._writer.add_opus(block.payload, ticks, block.samples)

    def report(self) -> dict[str, Any]:
        counts = self._playout.counts
        return {
            "frames_received": counts.played + counts.late + counts.dropped,
            "frames_decoded": self.decoded,
            "frames_corrupt": self._corrupt + counts.garbage,
            "frames_concealed": self._concealed,
            "frames_recovered": counts.recovered,
            "frames_late": counts.late,
            "frames_dropped": counts.dropped,
            "playout_delay_ms": self._playout.delay_ns / NS_PER_MS,
        }
