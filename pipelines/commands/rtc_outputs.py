"""What becomes of a partner's picture and voice: decoded, counted, and written where asked."""

import argparse

from kontur_av.clock import MonotonicClock
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ
from kontur_av.meters import Histogram
from kontur_av.rtp.nal_payload import ReceivedUnit
from kontur_av.streams.voice_receiver import VoicePlayer
from pipelines.media.rtp_reports import latency_ms
from pipelines.partner.connection_report import ReceivedKind
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures
from pipelines.recording.received_media import TimeLine
from pipelines.session.option_rows import add_options


def add_output_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--save FILE.mkv  write the picture as it comes",
        "--save-voice FILE.mka  write the voice as it comes",
        "--raw",
    )


class PartnerOutput:
    """Takes the events of a connection. `close` it at the end.

    ConfigError for files that cannot be written.
    """

    def __init__(self, args: argparse.Namespace, clock: MonotonicClock) -> None:
        self._clock = clock
        self._decoder = H264Decoder(reordered=True)
        self._player = VoicePlayer()
        self._files: list[MatroskaWriter] = []
        self._picture_file = self._open(args.save)
        self._voice_file = self._open(args.save_voice)
        self._raw = None if args.raw is None else RawPictures(args.raw)
        # A partner may come again, with other timestamps.
        self._picture_time, self._voice_time = TimeLine(VIDEO_CLOCK_HZ), TimeLine(AUDIO_CLOCK_HZ)
        self._picture_ns, self._voice_ns = Histogram(), Histogram()
        self._pictures = self._blocks = 0
        #: Width and height of the newest picture; None before the first.
        self.size: tuple[int, int] | None = None

    def handle(self, event: PictureCame | SoundCame) -> None:
        if isinstance(event, PictureCame):
            self._handle_unit(event.unit, event.capture_ns)
        else:
            self._handle_block(event)

    def flush(self) -> None:
        """Write what a slow reader of --raw has not taken. Call it often."""
        if self._raw is not None and self._raw.pending() is not None:
            self._raw.handle_writable()

    def close(self) -> None:
        for file in self._files:
            file.close()
        if self._raw is not None:
            self._raw.close()

    def finish(self) -> list[str]:
        """Write the rest, close, and say which files could not be written."""
        for picture in self._decoder.drain():
            self._show(picture)
        self.close()
        faults = [file.fault for file in self._files]
        if self._raw is not None:
            faults.append(self._raw.fault)
        return [fault for fault in faults if fault]

    def pictures(self) -> ReceivedKind:
        return _kind(self._pictures, self._picture_ns)

    def voice(self) -> ReceivedKind:
        return _kind(self._blocks, self._voice_ns)

    def _open(self, path: str | None) -> MatroskaWriter | None:
        if path is None:
            return None
        file = MatroskaWriter(path)
        self._files.append(file)
        return file

    def _handle_unit(self, unit: ReceivedUnit, capture_ns: int | None) -> None:
        for picture in self._decoder.decode(unit.data, unit.timestamp):
            self._show(picture)
            if capture_ns is not None and picture.timestamp == unit.timestamp:
                self._picture_ns.add(max(self._clock.now_ns() - capture_ns, 0))
        if self._picture_file is not None:
            ticks = self._picture_time.ticks(
                unit.timestamp, unit.received_ns, follows_all=unit.keyframe
            )
            self._picture_file.add_unit(unit.data, ticks, keyframe=unit.keyframe)

    def _show(self, picture: DecodedPicture) -> None:
        self._pictures += 1
        self.size = picture.width, picture.height
        if self._raw is not None:
            self._raw.handle_picture(picture)

    def _handle_block(self, event: SoundCame) -> None:
        block = event.block
        _, decoded = self._player.play(block)
        if not decoded:
            return
        self._blocks += 1
        if event.capture_ns is not None:
            self._voice_ns.add(max(block.play_ns - event.capture_ns, 0))
        if self._voice_file is not None and block.payload is not None and not block.recovered:
            ticks = self._voice_time.ticks(block.timestamp, block.play_ns, follows_all=True)
            self._voice_file.add_opus(block.payload, ticks, block.samples)


def _kind(decoded: int, latency_ns: Histogram) -> ReceivedKind:
    latency = latency_ms(latency_ns) if latency_ns.count else None
    return ReceivedKind(decoded=decoded, latency_ms=latency)
