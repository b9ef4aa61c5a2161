"""The output of a received stream: pictures or sound, figures, perhaps a file and a player."""

from collections.abc import Sequence

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.media import AUDIO_CLOCK_HZ
from kontur_av.meters import Histogram
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import NAL_FORMATS
from kontur_av.rtp.sdp import StreamDescription
from kontur_av.rtp.wire import TimestampUnwrapper
from kontur_av.streams.decoding import PictureDecoding, SoundDecoding
from pipelines.media.rtp_reports import OutputReport
from pipelines.recording.live_output import LiveWriter
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures

#: What a picture's timestamp may run ahead of its arrival, or behind it, and a sound's of its play.
_PICTURE_S, _SOUND_S = 10.0, 0.25


class TimeLine:
    """RTP timestamps as ticks since the first one; they rise on when the sender begins anew.

    rate_hz: of the ticks: that of pictures, or that of sound.
    """

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._most = round(rate_hz * (_SOUND_S if rate_hz == AUDIO_CLOCK_HZ else _PICTURE_S))
        self._unwrapper = TimestampUnwrapper()
        self._base = self._last = self._largest = 0
        self._last_ns: int | None = None

    def ticks(self, timestamp: int, now_ns: int, *, follows_all: bool) -> int:
        """follows_all: it is shown after all before it, as a key picture is."""
        ticks = self._base + self._unwrapper.unwrap(timestamp)
        if self._last_ns is not None:
            passed = (now_ns - self._last_ns) * self._rate_hz // NS_PER_S
            if (
                (follows_all and ticks <= self._largest)
                or ticks < self._last - self._rate_hz
                or abs(ticks - self._last - passed) > self._most
            ):
                self._unwrapper = TimestampUnwrapper()
                self._base = self._largest + max(passed, 1)
                ticks = self._base + self._unwrapper.unwrap(timestamp)
        self._last, self._last_ns = ticks, now_ns
        self._largest = max(self._largest, ticks)
        return ticks


class PictureOutput:
    """Decodes the pictures of its receiver. received_ns, decoded_ns: since the capture."""

    def __init__(
        self,
        stream: StreamDescription,
        clock: MonotonicClock,
        writers: Sequence[MatroskaWriter | LiveWriter],
        raw: RawPictures | None = None,
    ) -> None:
        self._decoding = PictureDecoding(stream, clock)
        self._form = NAL_FORMATS[stream.codec]
        self.receiver = self._decoding.receiver
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self._clock = clock
        self._raw = raw
        self._time_line = TimeLine(stream.clock_rate_hz)
        self._writers = writers
        self._size: tuple[int, int] | None = None
        #: The types of NAL units that came before the first picture.
        self._came: set[int] = set()

    @property
    def decoded(self) -> int:
        return self._decoding.decoder.counts.frames_decoded

    def drain(self) -> None:
        for unit, pictures in self._decoding.units():
            capture_ns = self.receiver.capture_ns(unit.timestamp)
            if capture_ns is not None:
                self.received_ns.add(unit.received_ns - capture_ns)
            if not self.decoded:
                self._came.update(map(self._form.nal_type, split_annex_b(unit.data)))
            for picture, stamp in pictures:
                self._show(picture)
                if stamp is not None:
                    self.decoded_ns.add(self._clock.now_ns() - stamp.capture_ns)
            ticks = self._time_line.ticks(
                unit.timestamp, unit.received_ns, follows_all=unit.keyframe
            )
            for writer in self._writers:
                writer.add_unit(unit.data, ticks, keyframe=unit.keyframe)
                if writer.needs_key:
                    self.receiver.handle_new_viewer()

    def finish(self) -> None:
        """Show the pictures that the decoder has held back."""
        for picture in self._decoding.decoder.drain():
            self._show(picture)

    def missing(self) -> str:
        """Say what the decoder waits for; "" where that is not known."""
        wanted = self._form.set_names.items()
        names = [f"no {name}" for kind, name in wanted if kind not in self._came]
        if names:
            return f": {' and '.join(names)} came, in the stream or in the SDP"
        refused = self._decoding.decoder.counts.sets_refused
        return ": its SPS is malformed, or asks for too much memory" if refused else ""

    def _show(self, picture: DecodedPicture) -> None:
        if self._raw is not None:
            self._raw.handle_picture(picture)
        self._size = (picture.width, picture.height)

    def report(self) -> OutputReport:
        decoder = self._decoding.decoder.counts
        return OutputReport(video=self.receiver.counts, decoder=decoder, size=self._size)


class SoundOutput:
    """Plays the sound of its receiver. received_ns, decoded_ns: since the capture."""

    def __init__(
        self,
        stream: StreamDescription,
        clock: MonotonicClock,
        writers: Sequence[MatroskaWriter | LiveWriter],
    ) -> None:
        self._decoding = SoundDecoding(stream, clock)
        self.receiver = self._decoding.receiver
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self.decoded = 0
        self._time_line = TimeLine(AUDIO_CLOCK_HZ)
        self._writers = writers

    def drain(self) -> None:
        receiver = self.receiver
        for timestamp, received_ns in receiver.take_arrivals():
            capture_ns = receiver.capture_ns(timestamp)
            if capture_ns is not None:
                self.received_ns.add(received_ns - capture_ns)
        for block, _, decoded, stamp in self._decoding.blocks():
            if not decoded:
                continue
            self.decoded += 1
            if stamp is not None:
                self.decoded_ns.add(block.play_ns - stamp.capture_ns)
            if block.payload is not None and not block.recovered:
                ticks = self._time_line.ticks(block.timestamp, block.play_ns, follows_all=True)
                for writer in self._writers:
                    writer.add_opus(block.payload, ticks, block.samples)

    def finish(self) -> None:
        """All that was decoded was played."""

    def missing(self) -> str:
        """Nothing: each packet of sound can be decoded alone."""
        return ""

    def report(self) -> OutputReport:
        return OutputReport(voice=self.receiver.counts)
