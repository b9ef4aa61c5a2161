"""The output of a received stream: pictures or sound, figures, and perhaps a file."""

import secrets

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h264 import H264Decoder
from kontur_av.media import AUDIO_CLOCK_HZ
from kontur_av.meters import Histogram
from kontur_av.rtp.report_timer import report_interval_ns
from kontur_av.rtp.sdp import StreamDescription
from kontur_av.rtp.wire import TimestampUnwrapper
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_player import VoicePlayer
from kontur_av.streams.voice_receiver import VoiceReceiver
from pipelines.commands.media_reports import PicturesReport, SoundReport
from pipelines.commands.raw_pictures import RawPictures
from pipelines.commands.remux import MatroskaWriter


class _TimeLine:
    """RTP timestamps as ticks since the first one; they continue when the sender restarts."""

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


class PictureOutput:
    """Decodes the pictures of its receiver. received_ns, decoded_ns: since the capture."""

    def __init__(
        self,
        stream: StreamDescription,
        clock: MonotonicClock,
        writer: MatroskaWriter | None,
        raw: RawPictures | None = None,
    ) -> None:
        self.receiver = VideoReceiver(
            ssrc=secrets.randbits(32),
            wall_offset_ns=clock.wall_offset_ns,
            parameter_sets=stream.parameter_sets,
            payload_type=stream.payload_type,
            report_interval_ns=report_interval_ns(frequent=stream.feedback),
            bandwidth_bps=stream.bandwidth_bps,
            reduced_size=stream.reduced_size,
            capture_time_id=stream.capture_time_id,
        )
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self._clock = clock
        self._raw = raw
        self._decoder = H264Decoder(reordered=True)
        self._time_line = _TimeLine(stream.clock_rate_hz)
        self._writer = writer
        self._size: tuple[int, int] | None = None

    @property
    def decoded(self) -> int:
        return self._decoder.counts.frames_decoded

    def drain(self) -> None:
        """Decode, count and write what the receiver has ready."""
        receiver = self.receiver
        while (unit := receiver.next_event()) is not None:
            capture_ns = receiver.capture_ns(unit.timestamp)
            if capture_ns is not None:
                self.received_ns.add(unit.received_ns - capture_ns)
            for picture in self._decoder.decode(unit.data, unit.timestamp):
                if self._raw is not None:
                    self._raw.handle_picture(picture)
                size = self._size = (picture.width, picture.height)
                capture_ns = receiver.capture_ns(picture.timestamp)
                stamp = receiver.handle_picture(
                    picture.timestamp, *size, capture_ns, corrupt=picture.corrupt
                )
                if stamp is not None:
                    self.decoded_ns.add(self._clock.now_ns() - stamp.capture_ns)
            if self._writer is not None:
                ticks = self._time_line.ticks(unit.timestamp, unit.received_ns)
                self._writer.add_unit(unit.data, ticks, keyframe=unit.keyframe)

    def report(self) -> PicturesReport:
        counts = self.receiver.counts
        return PicturesReport(
            size=self._size,
            frames_received=counts.frames_received,
            frames_damaged=counts.frames_damaged,
            frames_decoded=self._decoder.counts.frames_decoded,
            frames_corrupt=self._decoder.counts.frames_corrupt,
            frames_before_start=self._decoder.counts.frames_before_start,
            pictures_asked_for=counts.pictures_asked_for,
        )


class SoundOutput:
    """Plays the sound of its receiver. received_ns, decoded_ns: since the capture."""

    def __init__(
        self, stream: StreamDescription, clock: MonotonicClock, writer: MatroskaWriter | None
    ) -> None:
        self.receiver = VoiceReceiver(
            ssrc=secrets.randbits(32),
            wall_offset_ns=clock.wall_offset_ns,
            payload_type=stream.payload_type,
            report_interval_ns=report_interval_ns(frequent=stream.feedback),
            bandwidth_bps=stream.bandwidth_bps,
            capture_time_id=stream.capture_time_id,
        )
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self.decoded = 0
        self._concealed = 0
        self._player = VoicePlayer()
        self._time_line = _TimeLine(AUDIO_CLOCK_HZ)
        self._writer = writer

    def drain(self) -> None:
        """Decode, count and write what the receiver has ready."""
        receiver = self.receiver
        for timestamp, received_ns in receiver.take_arrivals():
            capture_ns = receiver.capture_ns(timestamp)
            if capture_ns is not None:
                self.received_ns.add(received_ns - capture_ns)
        while (block := receiver.next_event()) is not None:
            _, decoded = self._player.play(block)
            capture_ns = receiver.capture_ns(block.timestamp)
            stamp = receiver.handle_sound(block, decoded=decoded, capture_ns=capture_ns)
            if not decoded:
                # Before the first packet the decoder has nothing to conceal with.
                self._concealed += block.payload is None and self.decoded > 0
                continue
            self.decoded += 1
            if stamp is not None:
                self.decoded_ns.add(block.play_ns - stamp.capture_ns)
            if self._writer is not None and block.payload is not None and not block.recovered:
                ticks = self._time_line.ticks(block.timestamp, block.play_ns)
                self._writer.add_opus(block.payload, ticks, block.samples)

    def report(self) -> SoundReport:
        counts = self.receiver.counts
        return SoundReport(
            frames_received=counts.frames_received,
            frames_decoded=self.decoded,
            frames_corrupt=counts.frames_corrupt,
            frames_concealed=self._concealed,
            frames_recovered=counts.frames_recovered,
            frames_late=counts.frames_late,
            frames_dropped=counts.frames_left_out,
            playout_delay_ms=counts.playout_delay_ns / NS_PER_MS,
        )
