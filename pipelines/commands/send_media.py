"""What `kontur-av send` does with its source: pictures or sound to packets that may leave."""

import argparse
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h264 import REFRESH_S, SLOW_REFRESH_S, H264Encoder
from kontur_av.codecs.h264_settings import Search
from kontur_av.codecs.opus import OpusEncoder, bitrate_under_cap, heard_stamp
from kontur_av.errors import ConfigError
from kontur_av.media import (
    AUDIO_CLOCK_HZ,
    VIDEO_CLOCK_HZ,
    AccessUnit,
    CaptureStamp,
    VideoFrame,
    empty_picture,
    parse_size,
)
from kontur_av.meters import Histogram
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.rtp.payload_h264 import (
    DEFAULT_MAX_PAYLOAD_OCTETS,
    NAL_PPS,
    NAL_SPS,
    nal_type,
    split_annex_b,
)
from kontur_av.rtp.sdp import AUDIO_PAYLOAD_TYPE, VIDEO_PAYLOAD_TYPE
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from kontur_av.sources import open_audio, open_video
from kontur_av.streams.budget import Pacer
from kontur_av.streams.coding import Coding
from kontur_av.streams.encode_scheduler import EncodeScheduler
from kontur_av.streams.encoding_thread import EncodingThread
from kontur_av.topics.notifier import WaitSet

#: A block of sound that waits longer for its leave is not sent at all.
_STALE_VOICE_NS = 100 * NS_PER_MS
#: A receiver that gives feedback does so every second; after so long it is taken for gone.
_FEEDBACK_SILENCE_NS = 3 * NS_PER_S


def _sender(payload_type: int, clock_rate_hz: int, pacer: Pacer) -> RtpSender:
    return RtpSender(
        payload_type=payload_type,
        clock_rate_hz=clock_rate_hz,
        ssrc=secrets.randbits(32),
        first_sequence=secrets.randbits(16),
        timestamp_offset=secrets.randbits(32),
        cname=f"kontur-av-{secrets.token_hex(6)}",
        max_payload_octets=min(DEFAULT_MAX_PAYLOAD_OCTETS, pacer.max_payload_octets),
    )


class VideoOut:
    """Pictures from their source to packets that wait in the pacer.

    A picture is encoded in a thread of its own: the packets of the one before leave meanwhile.
    """

    kind: Literal["video", "audio"] = "video"

    def __init__(
        self,
        spec: str,
        width: int,
        height: int,
        fps: int,
        cap_bps: int,
        channel_bps: int | None,
        clock: MonotonicClock,
        coded_size: tuple[int, int] | None,
        refresh_s: float | None,
        search: Search,
    ) -> None:
        self._clock = clock
        self._refresh_s = refresh_s
        encoder = H264Encoder(
            width=width,
            height=height,
            fps=fps,
            cap_bps=cap_bps,
            coded_size=coded_size,
            refresh_s=REFRESH_S if refresh_s is None else refresh_s,
            search=search,
        )
        self.size, self.coded_size = (width, height), encoder.coded_size
        #: What the source writes to, and the newest whole picture.
        self._coming, self._newest = empty_picture(width, height), empty_picture(width, height)
        self._stamp = CaptureStamp(0, 0, "none")
        self.pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps, slack_ns=NS_PER_S // fps)
        self.rtp = _sender(VIDEO_PAYLOAD_TYPE, VIDEO_CLOCK_HZ, self.pacer)
        self._scheduler = EncodeScheduler(self.pacer, fps=fps)
        self._listener = PictureLossListener(ssrc=self.rtp.ssrc)
        self._heard_ns: int | None = None
        self._slow_refresh = False
        self.parameter_sets = self._parameter_sets(fps, cap_bps, search)
        self.encoded = 0
        self.encode_ns = Histogram()
        self.source = open_video(
            spec,
            name="video",
            width=width,
            height=height,
            fps=fps,
            clock=clock,
            scenes=_scenes("video") if spec.startswith("scene:") else None,
        )
        self._encoding = EncodingThread(encoder, clock.now_ns)
        self._wait_set = WaitSet([], [self._encoding.fileno()])

    @property
    def captured(self) -> int:
        return self._scheduler.captured

    @property
    def refused(self) -> int:
        return self._scheduler.refused

    def _parameter_sets(self, fps: int, cap_bps: int, search: Search) -> tuple[bytes, ...]:
        # The SDP has to be there before the first packet is. A second encoder that is set up alike
        # writes the same SPS and PPS, and the real one still begins with the first real picture.
        width, height = self.size
        twin = H264Encoder(
            width=width,
            height=height,
            fps=fps,
            cap_bps=cap_bps,
            coded_size=self.coded_size,
            search=search,
        )
        self._newest.fill(128)
        unit = twin.encode(VideoFrame(self._newest, CaptureStamp(0, 0, "twin")), lambda: 0)
        units = split_annex_b(unit.data)
        return tuple(unit for unit in units if nal_type(unit) in (NAL_SPS, NAL_PPS))

    def step(self, timeout_ns: int) -> CaptureStamp | None:
        """The stamp of the picture whose packets were queued, if one was within `timeout_ns`.

        Returns as soon as there is anything to do.
        """
        if self._encoding.busy:
            # A picture that comes meanwhile can wait: it would not be encoded sooner.
            self._wait_set.wait(timeout_ns)
            unit = self._encoding.poll()
            if unit is None:
                return None
            self._queue(unit)
            return unit.stamp
        stamp = self.source.read(self._coming, timeout_ns)
        if stamp is not None:
            self._coming, self._newest = self._newest, self._coming
            self._stamp = stamp
            self._scheduler.handle_picture(stamp.capture_ns, self._clock.now_ns())
        now_ns = self._clock.now_ns()
        if self._scheduler.poll_encode(now_ns):
            self._encoding.submit(VideoFrame(self._newest, self._stamp), self._coding(now_ns))
        return None

    def _queue(self, unit: AccessUnit) -> None:
        self._scheduler.handle_encoded(unit.encoded_ns)
        self.encoded += 1
        self.encode_ns.add(unit.encoded_ns - unit.stamp.capture_ns)
        packets = self.rtp.video_packets(unit)
        octets = [len(packet) - RTP_HEADER_OCTETS for packet in packets]
        self.pacer.handle_access_unit(packets, octets, self._clock.now_ns())

    def poll_timeout(self) -> int | None:
        """When to step again, whatever comes."""
        return self._scheduler.poll_timeout()

    def handle_feedback(self, datagram: bytes) -> None:
        """What a receiver says of what it got."""
        now_ns, garbage = self._clock.now_ns(), self._listener.garbage
        self._listener.handle_feedback(datagram, now_ns)
        if self._listener.garbage == garbage:
            self._heard_ns = now_ns

    def close(self) -> None:
        """End the thread, and give the source back."""
        self._encoding.close()
        self.source.close()

    def _coding(self, now_ns: int) -> Coding:
        keyframe = self._listener.take(now_ns)
        # Whoever joins and is silent, or becomes so, cannot ask for a whole picture.
        since_ns = self._heard_ns
        slow = since_ns is not None and now_ns - since_ns < _FEEDBACK_SILENCE_NS
        refresh_s = None
        if slow != self._slow_refresh and self._refresh_s is None:
            self._slow_refresh = slow
            refresh_s = SLOW_REFRESH_S if slow else REFRESH_S
        return Coding(keyframe, self._scheduler.next_rate_hz(), refresh_s)


class AudioOut:
    """Sound from its source to packets that wait in the pacer."""

    kind: Literal["video", "audio"] = "audio"
    parameter_sets: tuple[bytes, ...] = ()

    def __init__(
        self, spec: str, cap_bps: int, channel_bps: int | None, clock: MonotonicClock
    ) -> None:
        self._clock = clock
        self._encoder = OpusEncoder(bitrate_bps=bitrate_under_cap(cap_bps))
        self.pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps)
        self.rtp = _sender(AUDIO_PAYLOAD_TYPE, AUDIO_CLOCK_HZ, self.pacer)
        self.captured = self.encoded = self.refused = 0
        self.encode_ns = Histogram()
        self.source = open_audio(
            spec,
            name="audio",
            clock=clock,
            scenes=_scenes("audio") if spec.startswith("scene:") else None,
        )

    def poll_timeout(self) -> int | None:
        return None

    def handle_feedback(self, datagram: bytes) -> None:
        pass

    def close(self) -> None:
        """Give the source back."""
        self.source.close()

    def step(self, timeout_ns: int) -> CaptureStamp | None:
        """As that of `VideoOut`, for a block of sound."""
        block = self.source.read(timeout_ns)
        if block is None:
            return None
        self.captured += 1
        if self.pacer.oldest_age_ns(self._clock.now_ns()) > _STALE_VOICE_NS:
            return None
        opus = self._encoder.encode(block.samples)
        self.encoded += 1
        self.encode_ns.add(self._clock.now_ns() - block.stamp.capture_ns)
        packets = self.rtp.audio_packets(opus, heard_stamp(block.stamp))
        self.pacer.handle_access_unit(packets, [len(opus)], self._clock.now_ns())
        return block.stamp


@contextmanager
def open_media(args: argparse.Namespace, clock: MonotonicClock) -> Iterator[VideoOut | AudioOut]:
    """The source, encoder, pacer and sender that the options name."""
    cap_bps = round(args.cap_kbps * 1000)
    channel_bps = None if args.channel_kbps is None else round(args.channel_kbps * 1000)
    media: VideoOut | AudioOut
    if args.video is not None:
        width, height = parse_size(args.size)
        coded = None if args.coded_size == "auto" else parse_size(args.coded_size, "--coded-size")
        if args.refresh_s is not None and not 0.1 <= args.refresh_s <= 600:
            raise ConfigError(f"--refresh-s {args.refresh_s:g}: take 0.1 to 600 seconds")
        media = VideoOut(
            *(args.video, width, height, args.fps, cap_bps, channel_bps),
            *(clock, coded, args.refresh_s, args.search),
        )
    else:
        media = AudioOut(args.audio, cap_bps, channel_bps, clock)
    try:
        yield media
    finally:
        media.close()


def _scenes(kind: str) -> Mapping[str, Any]:
    from telepresence import world

    scenes: Mapping[str, Any] = world.video_scenes() if kind == "video" else world.audio_scenes()
    return scenes
