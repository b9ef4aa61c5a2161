"""`kontur-av send`: one stream from a source to plain RTP over UDP, under a hard cap."""

import argparse
import json
import secrets
import socket
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal

from kontur_av.budget import Pacer
from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.h264 import REFRESH_S, SLOW_REFRESH_S, H264Encoder
from kontur_av.link_clock import LinkClock
from kontur_av.media import (
    AUDIO_CLOCK_HZ,
    VIDEO_CLOCK_HZ,
    CaptureStamp,
    VideoFrame,
    empty_picture,
)
from kontur_av.meters import Histogram
from kontur_av.opus import OpusEncoder, bitrate_under_cap, heard_stamp
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.rtp.payload_h264 import (
    DEFAULT_MAX_PAYLOAD_OCTETS,
    NAL_PPS,
    NAL_SPS,
    nal_type,
    split_annex_b,
)
from kontur_av.rtp.sdp import (
    AUDIO_PAYLOAD_TYPE,
    VIDEO_PAYLOAD_TYPE,
    StreamDescription,
    write_sdp,
)
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from kontur_av.sources import open_audio, open_video
from pipelines.command import (
    check_options,
    open_socket,
    parse_address,
    parse_size,
    stopped_by_signals,
    write_text,
)

#: A block of sound that waits longer for its leave is not sent at all.
_STALE_VOICE_NS = 100 * NS_PER_MS
_LONGEST_WAIT_NS = 100 * NS_PER_MS
#: A receiver that gives feedback does so every second; after so long it is taken for gone.
_FEEDBACK_SILENCE_NS = 3 * NS_PER_S
_FEEDBACK_OCTETS = 1500


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av send`."""
    what = parser.add_mutually_exclusive_group(required=True)
    spec = "FILE, pipe:PATH, v4l2:DEVICE or scene:NAME"
    what.add_argument("--video", metavar="SPEC", help=spec)
    what.add_argument("--audio", metavar="SPEC", help=spec.replace("v4l2", "alsa"))
    parser.add_argument("--to", metavar="HOST:PORT", required=True, help="RTCP goes to PORT+1")
    parser.add_argument(
        "--cap-kbps",
        metavar="K",
        type=float,
        required=True,
        help="hard cap on RTP payload over any second, in kbit/s",
    )
    parser.add_argument(
        "--channel-kbps",
        metavar="C",
        type=float,
        help="the rate at which packets of a picture leave (default: the cap)",
    )
    parser.add_argument("--size", metavar="WxH", default="640x480", help="default: 640x480")
    parser.add_argument(
        "--coded-size",
        metavar="WxH",
        default="auto",
        help="in which pictures are coded; receivers scale them up (default: auto, as large as "
        "there are bits for)",
    )
    parser.add_argument(
        "--refresh-s",
        metavar="S",
        type=float,
        help=f"renew the whole picture every S seconds (default: {SLOW_REFRESH_S:g} while a "
        f"receiver gives feedback, so that it can ask for a whole picture, else {REFRESH_S:g})",
    )
    parser.add_argument("--fps", metavar="N", type=int, default=30, help="default: 30")
    parser.add_argument("--seconds", metavar="S", type=float, help="default: until Ctrl-C")
    parser.add_argument("--sdp", metavar="FILE", help="write what receivers need to know")
    parser.add_argument("--report", metavar="FILE", help="write a JSON report")


def run(args: argparse.Namespace) -> int:
    """Send until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError, with nothing sent, for what cannot work.
    """
    check_options(args)
    address = parse_address(args.to)
    clock = MonotonicClock()
    with open_media(args, clock) as media:
        stream = StreamDescription(
            kind=media.kind,
            host=str(address[0]),
            port=address[1],
            payload_type=media.rtp.payload_type,
            bandwidth_bps=round(args.cap_kbps * 1000),
            parameter_sets=media.parameter_sets,
        )
        if args.sdp:
            write_text(args.sdp, write_sdp(stream), "--sdp")
        if args.report:
            write_text(args.report, "", "--report")
        with open_socket(address) as channel:
            report = _Shell(media, channel, address, clock).run(args.seconds)
    if args.report:
        write_text(args.report, json.dumps(report, indent=2) + "\n", "--report")
    for failure in report["failed"]:
        print(f"failed: {failure}", file=sys.stderr)
    return 1 if report["failed"] else 0


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


class _Video:
    """Pictures from their source to packets that wait in the pacer."""

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
    ) -> None:
        self._clock = clock
        self._refresh_s = refresh_s
        self._encoder = H264Encoder(
            width=width,
            height=height,
            fps=fps,
            cap_bps=cap_bps,
            coded_size=coded_size,
            refresh_s=REFRESH_S if refresh_s is None else refresh_s,
        )
        self.size, self.coded_size = (width, height), self._encoder.coded_size
        #: What the source writes to, and the newest whole picture.
        self._coming, self._newest = empty_picture(width, height), empty_picture(width, height)
        self._stamp = CaptureStamp(0, 0, "none")
        self.pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps, slack_ns=NS_PER_S // fps)
        self.rtp = _sender(VIDEO_PAYLOAD_TYPE, VIDEO_CLOCK_HZ, self.pacer)
        self._link_clock = LinkClock(self.pacer, fps=fps)
        self._listener = PictureLossListener(ssrc=self.rtp.ssrc)
        self._heard_ns: int | None = None
        self._slow_refresh = False
        self.parameter_sets = self._parameter_sets(fps, cap_bps)
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

    @property
    def captured(self) -> int:
        return self._link_clock.captured

    @property
    def refused(self) -> int:
        return self._link_clock.refused

    def _parameter_sets(self, fps: int, cap_bps: int) -> tuple[bytes, ...]:
        # The SDP has to be there before the first packet is. A second encoder that is set up alike
        # writes the same SPS and PPS, and the real one still begins with the first real picture.
        width, height = self.size
        twin = H264Encoder(
            width=width, height=height, fps=fps, cap_bps=cap_bps, coded_size=self.coded_size
        )
        self._newest.fill(128)
        unit = twin.encode(VideoFrame(self._newest, CaptureStamp(0, 0, "twin")), lambda: 0)
        units = split_annex_b(unit.data)
        return tuple(unit for unit in units if nal_type(unit) in (NAL_SPS, NAL_PPS))

    def step(self, timeout_ns: int) -> CaptureStamp | None:
        """The stamp of the picture whose packets were queued, if one was within `timeout_ns`."""
        stamp = self.source.read(self._coming, timeout_ns)
        if stamp is not None:
            self._coming, self._newest = self._newest, self._coming
            self._stamp = stamp
            self._link_clock.handle_picture(stamp.capture_ns, self._clock.now_ns())
        if not self._link_clock.poll_encode(self._clock.now_ns()):
            return None
        keyframe = self._listener.take(self._clock.now_ns())
        self._follow()
        frame = VideoFrame(self._newest, self._stamp)
        unit = self._encoder.encode(frame, self._clock.now_ns, force_keyframe=keyframe)
        self._link_clock.handle_encoded(unit.encoded_ns)
        self.encoded += 1
        self.encode_ns.add(unit.encoded_ns - unit.stamp.capture_ns)
        packets = self.rtp.video_packets(unit)
        octets = [len(packet) - RTP_HEADER_OCTETS for packet in packets]
        self.pacer.handle_access_unit(packets, octets, self._clock.now_ns())
        return unit.stamp

    def poll_timeout(self) -> int | None:
        """When to step again, whether a picture comes or not."""
        return self._link_clock.poll_timeout()

    def handle_feedback(self, datagram: bytes) -> None:
        """What a receiver says of what it got."""
        now_ns, garbage = self._clock.now_ns(), self._listener.garbage
        self._listener.handle_feedback(datagram, now_ns)
        if self._listener.garbage == garbage:
            self._heard_ns = now_ns

    def _follow(self) -> None:
        hz = self._link_clock.next_rate_hz()
        # Whoever joins and is silent, or becomes so, cannot ask for a whole picture.
        since_ns = self._heard_ns
        slow = since_ns is not None and self._clock.now_ns() - since_ns < _FEEDBACK_SILENCE_NS
        refresh_s = None
        if slow != self._slow_refresh and self._refresh_s is None:
            self._slow_refresh = slow
            refresh_s = SLOW_REFRESH_S if slow else REFRESH_S
        if hz is not None or refresh_s is not None:
            self._encoder.follow(hz=hz, refresh_s=refresh_s)


class _Audio:
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

    def step(self, timeout_ns: int) -> CaptureStamp | None:
        """As that of `_Video`, for a block of sound."""
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
def open_media(args: argparse.Namespace, clock: MonotonicClock) -> Iterator[_Video | _Audio]:
    """The source, encoder, pacer and sender that the options name."""
    cap_bps = round(args.cap_kbps * 1000)
    channel_bps = None if args.channel_kbps is None else round(args.channel_kbps * 1000)
    media: _Video | _Audio
    if args.video is not None:
        width, height = parse_size(args.size)
        coded = None if args.coded_size == "auto" else parse_size(args.coded_size, "--coded-size")
        if args.refresh_s is not None and not 0.1 <= args.refresh_s <= 600:
            raise ConfigError(f"--refresh-s {args.refresh_s:g}: take 0.1 to 600 seconds")
        media = _Video(
            *(args.video, width, height, args.fps, cap_bps, channel_bps),
            *(clock, coded, args.refresh_s),
        )
    else:
        media = _Audio(args.audio, cap_bps, channel_bps, clock)
    try:
        yield media
    finally:
        media.source.close()


def _scenes(kind: str) -> Mapping[str, Any]:
    from telepresence import world

    scenes: Mapping[str, Any] = world.video_scenes() if kind == "video" else world.audio_scenes()
    return scenes


@dataclass(slots=True)
class _Unit:
    """What still has to leave before a capture is sent: up to this packet."""

    capture_ns: int
    last_packet: int


class _Shell:
    """Drives source, pacer and reports in real time."""

    def __init__(
        self,
        media: _Video | _Audio,
        channel: socket.socket,
        address: tuple[str, int],
        clock: MonotonicClock,
    ) -> None:
        self._media = media
        self._socket = channel
        self._address = address
        self._clock = clock
        self._queued: list[_Unit] = []
        self._units_sent = 0
        self._sent_ns = Histogram()
        self._send_errors = 0

    def run(self, seconds: float | None) -> dict[str, Any]:
        """Send until the end; the report."""
        start_ns = self._clock.now_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * NS_PER_S)
        next_line_ns = start_ns + NS_PER_S
        with stopped_by_signals() as stopped:
            while not stopped():
                now_ns = self._clock.now_ns()
                if end_ns is not None and now_ns >= end_ns:
                    break
                if now_ns >= next_line_ns:
                    next_line_ns += NS_PER_S
                    self._line(now_ns, start_ns)
                self._step(now_ns, end_ns, next_line_ns)
            self._drain_rest()
        if (farewell := self._media.rtp.goodbye(self._clock.ntp)) is not None:
            self._send(farewell, control=True)
        return self._report(start_ns)

    def _step(self, now_ns: int, end_ns: int | None, next_line_ns: int) -> None:
        media = self._media
        self._hear()
        due = (
            media.pacer.poll_timeout(),
            media.rtp.poll_timeout(),
            media.poll_timeout(),
            end_ns,
            next_line_ns,
        )
        until_ns = min(instant for instant in due if instant is not None)
        timeout_ns = min(max(until_ns - now_ns, 0), _LONGEST_WAIT_NS)
        stamp = media.step(timeout_ns)
        if stamp is not None:
            self._queued.append(_Unit(stamp.capture_ns, media.rtp.packets_sent))
        self._transmit()

    def _hear(self) -> None:
        # The answer to an earlier datagram that nobody took is no feedback.
        with suppress(BlockingIOError, ConnectionError):
            while True:
                datagram = self._socket.recv(_FEEDBACK_OCTETS, socket.MSG_DONTWAIT)
                self._media.handle_feedback(datagram)

    def _transmit(self) -> None:
        media = self._media
        while (packet := media.pacer.poll_transmit(self._clock.now_ns())) is not None:
            self._send(packet)
        now_ns = self._clock.now_ns()
        while self._queued and self._queued[0].last_packet <= media.pacer.released_packets:
            self._sent_ns.add(now_ns - self._queued.pop(0).capture_ns)
            self._units_sent += 1
        if (report := media.rtp.poll_report(now_ns, self._clock.ntp)) is not None:
            self._send(report, control=True)

    def _drain_rest(self) -> None:
        """Send what is queued, so that the last picture is whole; for a second at most."""
        give_up_ns = self._clock.now_ns() + NS_PER_S
        while (due_ns := self._media.pacer.poll_timeout()) is not None and due_ns < give_up_ns:
            self._clock.sleep_until_ns(due_ns)
            self._transmit()

    def _send(self, datagram: bytes, *, control: bool = False) -> None:
        host, port = self._address
        try:
            self._socket.sendto(datagram, (host, port + control))
        except OSError:
            # A network that goes down and comes back is loss to the receiver, no end to the sender.
            self._send_errors += 1

    def _line(self, now_ns: int, start_ns: int) -> None:
        media = self._media
        print(
            f"{(now_ns - start_ns) / NS_PER_S:6.0f} s  {media.captured} captured, "
            f"{self._units_sent} sent in {media.pacer.released_packets} packets, "
            f"{media.pacer.released.mean_bps(now_ns) / 1000:.1f} of "
            f"{media.pacer.cap_bps / 1000:g} kbit/s, "
            f"capture to sent {self._sent_ns.percentile(95) / NS_PER_MS:.1f} ms (95 %)",
            flush=True,
        )

    def _report(self, start_ns: int) -> dict[str, Any]:
        media, now_ns = self._media, self._clock.now_ns()
        released = media.pacer.released
        report: dict[str, Any] = {
            "stream": media.kind,
            "seconds": (now_ns - start_ns) / NS_PER_S,
            "cap_bps": media.pacer.cap_bps,
            "payload_bps_mean": released.mean_bps(),
            "payload_bps_max_1s": released.max_bps(NS_PER_S),
            "payload_bps_max_100ms": released.max_bps(100 * NS_PER_MS),
            "frames_captured": media.captured,
            "frames_encoded": media.encoded,
            "frames_sent": self._units_sent,
            "pictures_refused": media.refused,
            "rtp_packets": media.pacer.released_packets,
            "rtp_payload_octets": released.octets,
            "send_errors": self._send_errors,
            "latency_ms": {
                "stages": {
                    "capture_to_encoded": media.encode_ns.summary_ms(),
                    "capture_to_sent": self._sent_ns.summary_ms(),
                }
            },
            "source": {"faults": media.source.faults, "last_fault": media.source.last_fault},
            "cpu_s": time.process_time(),
        }
        if isinstance(media, _Video):
            report |= {"size": media.size, "coded_size": media.coded_size}
        failed = []
        if not self._units_sent:
            failed.append(
                f"nothing was captured: {media.source.last_fault or 'the source is mute'}"
            )
        if report["payload_bps_max_1s"] > media.pacer.cap_bps:
            failed.append("the cap was broken")
        if self._send_errors:
            failed.append(f"{self._send_errors} datagrams could not be sent")
        report["failed"] = failed
        return report
