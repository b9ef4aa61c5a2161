"""What feeds a stream: a source with its encoder and the sender of its packets."""

import os
import secrets
import socket
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, get_args

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S, coded_rate_for
from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.encoder_settings import Search
from kontur_av.codecs.h26x import encoder_of, settings_of
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES, OpusEncoder
from kontur_av.codecs.region import Focus
from kontur_av.errors import ConfigError, refused
from kontur_av.media import (
    AUDIO_CLOCK_HZ,
    AUDIO_PAYLOAD_TYPE,
    VIDEO_PAYLOAD_TYPE,
    CaptureStamp,
    VideoCodec,
    VideoFrame,
    empty_picture,
)
from kontur_av.rtp.nal_payload import DEFAULT_MAX_PAYLOAD_OCTETS
from kontur_av.rtp.sdp import StreamDescription, profile_level_id, session_bandwidth_bps, write_sdp
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.sources.source import AudioSource, VideoSource
from kontur_av.streams.encoding_thread import EncodingThread
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender
from kontur_av.topics.notifier import WaitSet

#: What a stream carries.
StreamCodec = Literal["h264", "h265", "opus"]
STREAM_CODECS: tuple[StreamCodec, ...] = get_args(StreamCodec)
#: Of the header extensions that tell captures, and numbers and sizes of pictures.
_CAPTURE_TIME_ID, _PICTURE_ID = 1, 2


class PictureFeed:
    """Pictures from their source to the sender.

    A picture is encoded in a thread of its own, while the packets of the picture before leave.
    """

    kind: Literal["video", "audio"] = "video"
    #: The sender's events stamp the sound of a packet this much earlier than its block.
    lookahead_ns = 0

    def __init__(
        self,
        source: VideoSource,
        clock: MonotonicClock,
        *,
        size: tuple[int, int],
        fps: float,
        cap_bps: int,
        channel_bps: int | None = None,
        coded_size: tuple[int, int] | None = None,
        refresh_s: float | None = None,
        search: Search = "thorough",
        codec: VideoCodec = "h264",
        regions: bool = False,
    ) -> None:
        width, height = size
        coded_hz = coded_rate_for(fps, cap_bps)

        def make(coded: tuple[int, int] | None, usual_s: float) -> VideoEncoder:
            return encoder_of(codec)(
                width=width,
                height=height,
                fps=coded_hz,
                cap_bps=cap_bps,
                coded_size=coded,
                refresh_s=usual_s if refresh_s is None else refresh_s,
                search=search,
                regions=regions,
            )

        #: Where pictures are coded finer, of a feed with `regions`.
        self.focus: Focus | None = None
        encoder = make(coded_size, REFRESH_S)
        self.size, self.coded_size = size, encoder.coded_size
        #: Of which library, in words.
        self.encoder = settings_of(codec).encoder_in_use()
        self.sender = VideoSender(
            cap_bps=cap_bps,
            channel_bps=channel_bps,
            fps=coded_hz,
            camera_hz=fps,
            identity=RtpIdentity.draw(secrets.randbits),
            cname=_cname(),
            wall_offset_ns=clock.wall_offset_ns,
            capture_time_id=_CAPTURE_TIME_ID,
            picture_id=_PICTURE_ID,
            size=size,
            adapt_refresh=refresh_s is None,
        )
        self.codec: VideoCodec = codec
        self._make = tuple(
            partial(make, one, SLOW_REFRESH_S) for one in (coded_size, encoder.largest_size)
        )
        #: At most: a packet for each picture, and one more for each whole payload of the cap.
        self.packets_per_s = fps + cap_bps / 8 / DEFAULT_MAX_PAYLOAD_OCTETS
        #: Of header extensions: one for each picture, and a longer one each second.
        self.extension_bps = round(8 * 12 * (fps + 1))
        self._clock = clock
        #: What the source writes to, and the newest whole picture.
        self._coming, self._newest = empty_picture(width, height), empty_picture(width, height)
        self._stamp = CaptureStamp(0, 0, "none")
        self.source = source
        self._encoding = EncodingThread(encoder, clock)
        self._wait_set = WaitSet([], [self._encoding.fileno()])

    # The SDP must exist before the first packet. A second encoder has the parameter sets of the
    # first picture, before which the sender makes the refresh slow. The real one still begins with
    # that picture.
    @cached_property
    def parameter_sets(self) -> tuple[bytes, ...]:
        """The parameter sets of the stream."""
        return self._make[0]().parameter_sets()

    @cached_property
    def profile_level_id(self) -> str:
        """As of `StreamDescription`, of the largest pictures that may come."""
        if self.codec != "h264":
            return ""
        return profile_level_id(self._make[1]().parameter_sets())

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
            region = None if self.focus is None else self.focus.region(*self.size)
            self._encoding.submit(VideoFrame(self._newest, self._stamp), coding, region)

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
    lookahead_ns = LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
    parameter_sets: tuple[bytes, ...] = ()
    profile_level_id = ""
    codec: VideoCodec = "h264"
    packets_per_s, extension_bps = 50.0, 8 * 16

    def __init__(
        self,
        source: AudioSource,
        clock: MonotonicClock,
        *,
        cap_bps: int,
        channel_bps: int | None = None,
    ) -> None:
        self._clock = clock
        self.sender = VoiceSender(
            cap_bps=cap_bps,
            channel_bps=channel_bps,
            identity=RtpIdentity.draw(secrets.randbits),
            cname=_cname(),
            wall_offset_ns=clock.wall_offset_ns,
            capture_time_id=_CAPTURE_TIME_ID,
        )
        self._encoder = OpusEncoder(bitrate_bps=self.sender.bitrate_bps)
        self.source = source

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


def describe(feed: PictureFeed | SoundFeed, host: str, port: int) -> StreamDescription:
    """Return what receivers at `host` must know of the stream."""
    bandwidth_bps = session_bandwidth_bps(feed.sender.cap_bps, feed.packets_per_s, host)
    return replace(
        undescribed(port, feed.codec if feed.kind == "video" else "opus"),
        host=host,
        bandwidth_bps=bandwidth_bps + feed.extension_bps,
        parameter_sets=feed.parameter_sets,
        profile_level_id=feed.profile_level_id,
        reduced_size=True,
    )


def checked_sdp(sdp: str | Path | None) -> Path | None:
    """Return where to write an SDP. ConfigError unless that is a file in a folder that is there."""
    with refused(f"sdp {sdp!r}: give a path", TypeError):
        path = None if sdp is None else Path(sdp)
    if path is not None and (path.is_dir() or not os.access(path.parent, os.W_OK)):
        raise ConfigError(f"sdp {str(sdp)!r} cannot be written: name a file in an open folder")
    return path


def write_description(feed: PictureFeed | SoundFeed, to: tuple[str, int], path: Path) -> None:
    """Write an SDP for receivers at an IP address and port. ConfigError if it cannot be."""
    with refused(f"sdp {str(path)!r} cannot be written"):
        path.write_text(write_sdp(describe(feed, *to)), encoding="utf-8")


def undescribed(
    port: int, codec: StreamCodec, payload_type: int | None = None
) -> StreamDescription:
    """Return what a receiver may suppose of a stream that no SDP describes: ours, or another.

    payload_type: None: that of our senders.
    """
    sound = codec == "opus"
    usual = AUDIO_PAYLOAD_TYPE if sound else VIDEO_PAYLOAD_TYPE
    return StreamDescription(
        kind="audio" if sound else "video",
        host="::" if socket.has_dualstack_ipv6() else "0.0.0.0",
        port=port,
        payload_type=usual if payload_type is None else payload_type,
        codec="h264" if codec == "opus" else codec,
        feedback=True,
        capture_time_id=_CAPTURE_TIME_ID,
        picture_id=None if sound else _PICTURE_ID,
    )


def _cname() -> str:
    return f"kontur-av-{secrets.token_hex(6)}"
