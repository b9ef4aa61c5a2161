"""The source of `kontur-av send`, with its encoder and the sender of its stream."""

import argparse
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.coding import REFRESH_S
from kontur_av.codecs.h264 import H264Encoder
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES, OpusEncoder
from kontur_av.errors import ConfigError
from kontur_av.media import (
    AUDIO_CLOCK_HZ,
    AUDIO_PAYLOAD_TYPE,
    VIDEO_PAYLOAD_TYPE,
    CaptureStamp,
    VideoFrame,
    empty_picture,
    parse_size,
)
from kontur_av.rtp.payload_h264 import (
    DEFAULT_MAX_PAYLOAD_OCTETS,
    NAL_PPS,
    NAL_SPS,
    nal_type,
    split_annex_b,
)
from kontur_av.rtp.sdp import profile_level_id
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.sources import open_audio, open_video
from kontur_av.streams.encoding_thread import EncodingThread, switch_threads_often
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender
from kontur_av.topics.notifier import WaitSet

#: Of the header extension that tells captures.
CAPTURE_TIME_ID = 1


def _parameter_sets(encoder: H264Encoder) -> tuple[bytes, ...]:
    """SPS and PPS that `encoder` writes. Do not use it afterwards: it has begun its stream."""
    grey = empty_picture(encoder.width, encoder.height)
    grey.fill(128)
    units = split_annex_b(encoder.encode(VideoFrame(grey, CaptureStamp(0, 0, "twin"))).data)
    return tuple(unit for unit in units if nal_type(unit) in (NAL_SPS, NAL_PPS))


class PictureFeed:
    """Pictures from their source to the sender.

    A picture is encoded in a thread of its own, while the packets of the picture before leave.
    """

    kind: Literal["video", "audio"] = "video"
    payload_type = VIDEO_PAYLOAD_TYPE
    #: The sender's events stamp the sound of a packet this much earlier than its block.
    lookahead_ns = 0

    def __init__(self, args: argparse.Namespace, clock: MonotonicClock) -> None:
        width, height = parse_size(args.size)
        coded = None if args.coded_size == "auto" else parse_size(args.coded_size, "--coded-size")
        if args.refresh_s is not None and not 0.1 <= args.refresh_s <= 600:
            raise ConfigError(f"--refresh-s {args.refresh_s:g}: take 0.1 to 600 seconds")

        def make(coded: tuple[int, int] | None) -> H264Encoder:
            return H264Encoder(
                width=width,
                height=height,
                fps=args.fps,
                cap_bps=_bps(args.cap_kbps),
                coded_size=coded,
                refresh_s=REFRESH_S if args.refresh_s is None else args.refresh_s,
                search=args.search,
            )

        encoder = make(coded)
        self.size, self.coded_size = (width, height), encoder.coded_size
        self.sender = VideoSender(
            cap_bps=_bps(args.cap_kbps),
            channel_bps=None if args.channel_kbps is None else _bps(args.channel_kbps),
            fps=args.fps,
            identity=RtpIdentity.draw(secrets.randbits),
            cname=_cname(),
            wall_offset_ns=clock.wall_offset_ns,
            capture_time_id=CAPTURE_TIME_ID,
            adapt_refresh=args.refresh_s is None,
        )
        # The SDP must exist before the first packet. A second encoder of the same settings has the
        # same SPS and PPS, and the real one still begins with the first real picture. A third shows
        # the level that pictures may grow to.
        self.parameter_sets = _parameter_sets(make(coded))
        self.profile_level_id = profile_level_id(_parameter_sets(make(encoder.largest_size)))
        #: At most: a packet for each picture, and one more for each whole payload of the cap.
        self.packets_per_s = args.fps + _bps(args.cap_kbps) / 8 / DEFAULT_MAX_PAYLOAD_OCTETS
        self._clock = clock
        #: What the source writes to, and the newest whole picture.
        self._coming, self._newest = empty_picture(width, height), empty_picture(width, height)
        self._stamp = CaptureStamp(0, 0, "none")
        self.source = open_video(
            args.video,
            name="video",
            width=width,
            height=height,
            fps=args.fps,
            clock=clock,
            scenes=_scenes("video") if args.video.startswith("scene:") else None,
        )
        self._encoding = EncodingThread(encoder, clock)
        self._wait_set = WaitSet([], [self._encoding.fileno()])

    def step(self, timeout_ns: int) -> None:
        """Take a picture or an access unit; return within `timeout_ns`, or as soon as there is
        anything to do."""
        if self._encoding.busy:
            # A picture that comes in the meantime can wait, because it would not be encoded sooner.
            self._wait_set.wait(timeout_ns)
            done = self._encoding.poll()
            if done is not None:
                self.sender.handle_access_unit(done.unit, done.encoded_ns)
            return
        stamp = self.source.read(self._coming, timeout_ns)
        if stamp is not None:
            self._coming, self._newest = self._newest, self._coming
            self._stamp = stamp
            self.sender.handle_picture(stamp, self._clock.now_ns())
        coding = self.sender.poll_encode(self._clock.now_ns())
        if coding is not None:
            self._encoding.submit(VideoFrame(self._newest, self._stamp), coding)

    def finish(self) -> None:
        """Encode no more pictures."""
        self.sender.finish()

    def close(self) -> None:
        """End the thread, and close the source."""
        self._encoding.close()
        self.source.close()


class SoundFeed:
    """Sound from its source to the sender."""

    kind: Literal["video", "audio"] = "audio"
    payload_type = AUDIO_PAYLOAD_TYPE
    lookahead_ns = LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
    parameter_sets: tuple[bytes, ...] = ()
    profile_level_id = ""
    packets_per_s = 50.0

    def __init__(self, args: argparse.Namespace, clock: MonotonicClock) -> None:
        self._clock = clock
        self.sender = VoiceSender(
            cap_bps=_bps(args.cap_kbps),
            channel_bps=None if args.channel_kbps is None else _bps(args.channel_kbps),
            identity=RtpIdentity.draw(secrets.randbits),
            cname=_cname(),
            wall_offset_ns=clock.wall_offset_ns,
            capture_time_id=CAPTURE_TIME_ID,
        )
        self._encoder = OpusEncoder(bitrate_bps=self.sender.bitrate_bps)
        self.source = open_audio(
            args.audio,
            name="audio",
            clock=clock,
            scenes=_scenes("audio") if args.audio.startswith("scene:") else None,
        )

    def step(self, timeout_ns: int) -> None:
        """Take a block of sound, if one comes within `timeout_ns`."""
        block = self.source.read(timeout_ns)
        if block is None or not self.sender.handle_block(block.stamp, self._clock.now_ns()):
            return
        opus = self._encoder.encode(block.samples)
        self.sender.handle_packet(opus, block.stamp, self._clock.now_ns())

    def finish(self) -> None:
        """Encode no more sound."""

    def close(self) -> None:
        """Close the source."""
        self.source.close()


@contextmanager
def open_feed(args: argparse.Namespace, clock: MonotonicClock) -> Iterator[PictureFeed | SoundFeed]:
    """The source, encoder and sender that the options name."""
    if args.video is not None:
        switch_threads_often()
    feed = (PictureFeed if args.video is not None else SoundFeed)(args, clock)
    try:
        yield feed
    finally:
        feed.close()


def _bps(kbps: float) -> int:
    return round(kbps * 1000)


def _cname() -> str:
    return f"kontur-av-{secrets.token_hex(6)}"


def _scenes(kind: str) -> Mapping[str, Any]:
    from telepresence import world

    scenes: Mapping[str, Any] = world.video_scenes() if kind == "video" else world.audio_scenes()
    return scenes
