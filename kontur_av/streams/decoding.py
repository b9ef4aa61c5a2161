"""What comes out of a stream: the receiver that its description asks for, with a decoder."""

import secrets
from collections.abc import Iterator

from kontur_av.clock import MonotonicClock
from kontur_av.codecs.decoder import DecodedPicture, VideoDecoder
from kontur_av.media import CaptureStamp, Pcm
from kontur_av.rtp.arrivals import MOST_REORDER_NS
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.rtp.reports import report_interval_ns
from kontur_av.rtp.sdp import StreamDescription
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoicePlayer, VoiceReceiver


class PictureDecoding:
    """Receives and decodes pictures. Drive `receiver`, and take what comes from `units`."""

    def __init__(self, stream: StreamDescription, clock: MonotonicClock) -> None:
        self.receiver = VideoReceiver(
            ssrc=secrets.randbits(32),
            wall_offset_ns=clock.wall_offset_ns,
            codec=stream.codec,
            parameter_sets=stream.parameter_sets,
            payload_type=stream.payload_type,
            report_interval_ns=report_interval_ns(frequent=stream.feedback),
            bandwidth_bps=stream.bandwidth_bps,
            reduced_size=stream.reduced_size,
            capture_time_id=stream.capture_time_id,
            picture_id=stream.picture_id,
            ask_time=True,
            most_reorder_ns=MOST_REORDER_NS,
        )
        self.decoder = VideoDecoder(stream.codec, reordered=True)

    def units(
        self,
    ) -> Iterator[tuple[ReceivedUnit, Iterator[tuple[DecodedPicture, CaptureStamp | None]]]]:
        """Yield each access unit with its pictures. A stamp is None until a report dates it.

        Exhaust the pictures of a unit before the next one is taken.
        """
        while (unit := self.receiver.next_event()) is not None:
            yield unit, self._pictures(unit)

    def _pictures(self, unit: ReceivedUnit) -> Iterator[tuple[DecodedPicture, CaptureStamp | None]]:
        undecoded = self.decoder.counts.undecoded
        pictures = self.decoder.decode(unit.data, unit.timestamp)
        if self.decoder.counts.undecoded > undecoded:
            self.receiver.handle_undecoded()
        yield from self._stamped(pictures)

    def rest(self) -> Iterator[tuple[DecodedPicture, CaptureStamp | None]]:
        """Yield the pictures that the decoder has held back, as the stream has ended."""
        return self._stamped(self.decoder.drain())

    def _stamped(
        self, pictures: list[DecodedPicture]
    ) -> Iterator[tuple[DecodedPicture, CaptureStamp | None]]:
        for picture in pictures:
            yield (
                picture,
                self.receiver.handle_picture(
                    picture.timestamp,
                    picture.width,
                    picture.height,
                    self.receiver.capture_ns(picture.timestamp),
                    corrupt=picture.corrupt,
                ),
            )


class SoundDecoding:
    """Receives and plays sound. Drive `receiver`, and take what comes from `blocks`."""

    def __init__(self, stream: StreamDescription, clock: MonotonicClock) -> None:
        self.receiver = VoiceReceiver(
            ssrc=secrets.randbits(32),
            wall_offset_ns=clock.wall_offset_ns,
            payload_type=stream.payload_type,
            report_interval_ns=report_interval_ns(frequent=stream.feedback),
            bandwidth_bps=stream.bandwidth_bps,
            capture_time_id=stream.capture_time_id,
        )
        self._player = VoicePlayer()

    def blocks(self) -> Iterator[tuple[PlayoutBlock, Pcm, bool, CaptureStamp | None]]:
        """Yield each block, its sound, whether that is real, and its stamp if a report dates it."""
        while (block := self.receiver.next_event()) is not None:
            sound, decoded = self._player.play(block)
            capture_ns = self.receiver.capture_ns(block.timestamp)
            stamp = self.receiver.handle_sound(block, decoded=decoded, capture_ns=capture_ns)
            yield block, sound, decoded, stamp
