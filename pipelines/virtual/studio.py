"""The coders of a simulation: they draw, encode and decode, and need no clock.

Each coder is called with one job after the other, in a process of its own (`simulation.workers`).
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import log10
from typing import NamedTuple, TypeVar, cast

import numpy as np

from kontur_av.clock import NS_PER_S, ManualClock
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import DecodedPicture, DecoderCounts, VideoDecoder
from kontur_av.codecs.h26x import encoder_of
from kontur_av.codecs.opus import OpusEncoder, bitrate_under_cap
from kontur_av.codecs.region import Region
from kontur_av.detect import Click, ClickDetector, Light, LightDetector
from kontur_av.media import I420, AccessUnit, CaptureStamp, VideoCodec, VideoFrame, empty_picture
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.sources import AudioSource, open_audio, open_video
from kontur_av.sources.stereo import PicturePair
from kontur_av.streams.voice_receiver import VoicePlayer
from pipelines.media.marking import PictureComposer
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topology.rows import CameraRow
from telepresence.world import WorldState, audio_scenes, render

#: The most pictures or blocks of a file that are kept until they are encoded.
_MOST_KEPT = 16
#: The tries to read the next picture or block of a file, each of at most ten seconds.
_TRIES = 10
_TIMEOUT_NS = 10 * NS_PER_S
_T = TypeVar("_T")


class Shot(NamedTuple):
    """A captured picture that is drawn only when it is encoded.

    state: the state of the world at its capture; None for a picture of a file.
    """

    camera: str
    sequence: int
    state: WorldState | None


class Paired(NamedTuple):
    """A picture of a composed camera that is composed only when it is encoded.

    pair: the `data` of its pictures are `Shot`s. now_ns: when it was paired.
    """

    camera: str
    pair: PicturePair
    now_ns: int


#: A picture to encode.
Picture = Shot | Paired

#: The result for one access unit: see `VideoDecoding`.
Decoded = tuple[list[tuple[int, int, int, bool]], DecoderCounts, list[Light], list[float]]

#: PSNR of a picture that equals its original, in dB.
SAME_DB = 99.0


class VideoStudio:
    """Draws pictures or reads them from files, and encodes them.

    cameras: name -> SPEC of each input that the stream may show.
    regions: pictures may have a region of interest. composed: cameras that are composed of them.

    A job is one of:
    - a `Picture`, its `Coding`, and its `Region` or None; the result is the access
      unit, with another stamp;
    - a `Shot` that is likely to be encoded, to be drawn already; no result;
    - a camera's name; the result is the capture instant of the file's next picture, or None.
    """

    def __init__(
        self,
        stream: VideoStream,
        cameras: dict[str, str],
        start_ns: int,
        *,
        regions: bool = False,
        composed: Sequence[CameraRow] = (),
    ) -> None:
        self._stream = stream
        self._encoder = encoder_of(stream.codec)(
            width=stream.width,
            height=stream.height,
            fps=stream.coded_hz,
            cap_bps=stream.cap_bps,
            coded_size=stream.coded,
            regions=regions,
        )
        self._composers = {
            row.name: PictureComposer(row.composition) for row in composed if row.composition
        }
        self._views: dict[str, str] = {}
        self._films: dict[str, _Film] = {}
        for name, spec in cameras.items():
            kind, _, view = spec.partition(":")
            if kind == "scene":
                self._views[name] = view
            else:
                self._films[name] = _Film(spec, name, stream, start_ns)
        self._rooms = [empty_picture(stream.width, stream.height) for _ in range(3)]
        #: The newest picture of each camera that was drawn before it is encoded.
        self._ahead: dict[str, tuple[int, I420]] = {}

    def __call__(
        self, job: tuple[Picture, Coding, Region | None] | Shot | str
    ) -> AccessUnit | int | None:
        if isinstance(job, str):
            return self._films[job].next()
        if isinstance(job, Shot):
            drawn = self._ahead.pop(job.camera, None)
            room = drawn[1] if drawn else empty_picture(self._stream.width, self._stream.height)
            self._ahead[job.camera] = job.sequence, self._picture(job, room)
            return None
        return self._encode(*job)

    def _encode(self, picture: Picture, coding: Coding, region: Region | None) -> AccessUnit:
        left, right, merged = self._rooms
        if isinstance(picture, Paired):
            pair = replace(
                picture.pair,
                left=self._drawn(picture.pair.left, left),
                right=self._drawn(picture.pair.right, right),
            )
            self._composers[picture.camera].handle_pair(pair, merged, picture.now_ns)
        else:
            merged = self._picture(picture, left)
        stamp = CaptureStamp(0, self._encoder.encoded, self._stream.name)
        return self._encoder.encode(VideoFrame(merged, stamp), coding, region=region)

    def _drawn(self, frame: VideoFrame | None, room: I420) -> VideoFrame | None:
        if frame is None:
            return None
        return VideoFrame(self._picture(cast(Shot, frame.data), room), frame.stamp)

    def _picture(self, shot: Shot, room: I420) -> I420:
        if shot.state is None:
            pictures = self._films[shot.camera].pictures
            # Of a file that is much faster than its stream, only a newer one may be kept.
            return pictures[max(shot.sequence, next(iter(pictures)))]
        drawn = self._ahead.get(shot.camera)
        if drawn is not None and drawn[0] == shot.sequence:
            return drawn[1]
        render(self._views[shot.camera], shot.state, room, shot.sequence)
        return room


class _Film:
    """A media file that is read ahead, on a clock of its own."""

    def __init__(self, spec: str, name: str, stream: VideoStream, start_ns: int) -> None:
        self._stream = stream
        self._source = open_video(
            spec,
            name=name,
            width=stream.width,
            height=stream.height,
            fps=stream.fps,
            clock=ManualClock(start_ns),
        )
        self.pictures: OrderedDict[int, I420] = OrderedDict()

    def next(self) -> int | None:
        picture = empty_picture(self._stream.width, self._stream.height)
        stamp = _tried(lambda: self._source.read(picture, _TIMEOUT_NS))
        return None if stamp is None else _kept(self.pictures, stamp, picture)


def _tried(read: Callable[[], _T | None]) -> _T | None:
    return next((found for _ in range(_TRIES) if (found := read()) is not None), None)


def _kept(items: OrderedDict[int, _T], stamp: CaptureStamp, item: _T) -> int:
    """Keep a picture or block of a file until it is encoded; return its capture instant."""
    items[stamp.sequence] = item
    if len(items) > _MOST_KEPT:
        items.popitem(last=False)
    return stamp.capture_ns


class VideoDecoding:
    """Decodes access units: (Annex B octets, timestamp, instant of display).

    The result for each has:
    - its pictures as (timestamp, width, height, corrupt);
    - the decoder's counters after it: decoded, corrupt, restarts;
    - the lights that came on, whose tags are the timestamps of their picture and the one before;
    - the PSNR of each picture against its original, in dB; none without `originals`.

    codec: of the stream.
    watched: (width, height) of the display in which to look for lights; None: do not look.
    """

    def __init__(
        self,
        watched: tuple[int, int] | None = None,
        originals: "Originals | None" = None,
        *,
        codec: VideoCodec = "h264",
    ) -> None:
        self._decoder = VideoDecoder(codec)
        self._originals = originals
        self._shown = None if watched is None else empty_picture(*watched)
        self._eye = LightDetector()

    def __call__(self, unit: tuple[bytes, int, int]) -> Decoded:
        data, timestamp, shown_ns = unit
        decoder, originals = self._decoder, self._originals
        pictures, quality = [], []
        for picture in decoder.decode(data, timestamp):
            pictures.append((picture.timestamp, picture.width, picture.height, picture.corrupt))
            if self._shown is not None:
                picture.scale_into(self._shown)
                self._eye.handle_picture(self._shown, shown_ns, picture.timestamp)
            db = None if originals is None else originals.psnr_db(picture)
            if db is not None:
                quality.append(db)
        lights = list(iter(self._eye.next_event, None))
        return pictures, replace(decoder.counts), lights, quality


class Originals:
    """What a stream showed where it was sent: its own access units, decoded without a loss.

    units: (RTP timestamp, access unit), in order. size: width and height of the display, in which
    pictures are compared. codec: of the stream.
    """

    def __init__(
        self,
        units: Sequence[tuple[int, bytes]],
        size: tuple[int, int],
        codec: VideoCodec = "h264",
    ) -> None:
        self._units = units
        self._places = {timestamp: place for place, (timestamp, _) in enumerate(units)}
        self._decoder = VideoDecoder(codec)
        self._next = 0
        self._place = -1
        self._original, self._picture = empty_picture(*size), empty_picture(*size)

    def psnr_db(self, picture: DecodedPicture) -> float | None:
        """PSNR of the luma, at most `SAME_DB`; None without an original. Call it in order."""
        place = self._places.get(picture.timestamp)
        if place is None or place < self._place:
            return None
        while self._next <= place:
            timestamp, data = self._units[self._next]
            self._next += 1
            for original in self._decoder.decode(data, timestamp):
                self._place = self._next - 1
                if self._place == place:
                    original.scale_into(self._original)
        if self._place != place:
            return None  # no decoder could begin with it
        picture.scale_into(self._picture)
        lines = len(self._picture) * 2 // 3
        away = self._picture[:lines].astype(np.int16) - self._original[:lines]
        error = float(np.mean(np.square(away, dtype=np.int32)))
        return min(SAME_DB, 10 * log10(255**2 / error)) if error else SAME_DB


class VoiceStudio:
    """Makes sounds or reads them from a file, and encodes them.

    A job is one of:
    - (instant at which a block of the scene is complete, state of the world); the result is the
      Opus packet;
    - None; the result is the capture instant of the file's next block, or None at its end;
    - the number of a block of the file; the result is its Opus packet.
    """

    def __init__(self, stream: VoiceStream, name: str, spec: str, start_ns: int) -> None:
        self._encoder = OpusEncoder(bitrate_bps=bitrate_under_cap(stream.cap_bps))
        self._state, self._clock = WorldState(start_ns), ManualClock(start_ns)
        self._packets: OrderedDict[int, bytes] = OrderedDict()
        scenes = audio_scenes(lambda _: self._state)
        self._source: AudioSource = open_audio(spec, name=name, clock=self._clock, scenes=scenes)

    def __call__(self, job: tuple[int, WorldState] | int | None) -> bytes | int | None:
        if job is None:
            return self._next()
        if isinstance(job, int):
            return self._packets[job]
        complete_ns, self._state = job
        self._clock.sleep_until_ns(complete_ns)
        frame = self._source.read(0)
        assert frame is not None
        return self._encoder.encode(frame.samples)

    def _next(self) -> int | None:
        frame = _tried(lambda: self._source.read(_TIMEOUT_NS))
        if frame is None:
            return None
        return _kept(self._packets, frame.stamp, self._encoder.encode(frame.samples))


class VoiceDecoding:
    """Decodes blocks of sound: (`PlayoutBlock`, instant of playing it).

    The result for each is whether it was decoded (not concealed), and the clicks that began in it.
    The tag of a click is the timestamp of its block.

    watched: listen for clicks.
    """

    def __init__(self, *, watched: bool = False) -> None:
        self._player = VoicePlayer()
        self._ear = ClickDetector() if watched else None

    def __call__(self, heard: tuple[PlayoutBlock, int]) -> tuple[bool, list[Click]]:
        block, heard_ns = heard
        samples, decoded = self._player.play(block)
        if self._ear is None:
            return decoded, []
        self._ear.handle_block(samples, heard_ns, block.timestamp)
        return decoded, list(iter(self._ear.next_event, None))
