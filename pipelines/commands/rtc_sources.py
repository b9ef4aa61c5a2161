"""What is sent to a partner: a source of pictures and one of sound, coded in threads of their own.

A source waits for its device, and coding takes milliseconds: neither may hold up the event loop.
"""

import argparse
import asyncio
import threading
from collections.abc import Callable
from typing import Any

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.closing import Closing
from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.h264 import H264Encoder
from kontur_av.codecs.opus import OpusEncoder, heard_stamp
from kontur_av.errors import ConfigError
from kontur_av.media import AccessUnit, CaptureStamp, VideoFrame, empty_picture, parse_size
from kontur_av.meters import RateMeter
from kontur_av.sources.page import FILLED_BY_OTHERS
from pipelines.commands.send import add_picture_arguments, open_pictures, open_sound
from pipelines.partner.decisions import LEAST_BPS, PicturePlan, RateFollower
from pipelines.partner.description import Kind

VIDEO_KBPS, VOICE_KBPS = 1500.0, 32.0
_PATIENCE_NS = 50 * NS_PER_MS
_LAST_S = 2.0


def add_source_arguments(parser: argparse.ArgumentParser) -> None:
    spec = "FILE, pipe:PATH, v4l2:DEVICE or scene:NAME"
    parser.add_argument("--video", metavar="SPEC", help=f"the picture to send: {spec}")
    parser.add_argument(
        "--audio", metavar="SPEC", help=f"the voice to send: {spec.replace('v4l2', 'alsa')}"
    )
    add_picture_arguments(parser)
    parser.add_argument(
        "--video-kbps",
        metavar="K",
        type=float,
        default=VIDEO_KBPS,
        help=f"of the picture, less when the partner can take less (default: {VIDEO_KBPS:g})",
    )
    parser.add_argument(
        "--voice-kbps",
        metavar="K",
        type=float,
        default=VOICE_KBPS,
        help=f"of the voice (default: {VOICE_KBPS:g})",
    )


def sends_of(args: argparse.Namespace) -> dict[Kind, int]:
    """Return the bit/s of what is sent, by kind. ConfigError for rates that cannot work."""
    sends: dict[Kind, int] = {}
    if args.video is not None:
        sends["video"] = _bps(args.video_kbps, "--video-kbps", LEAST_BPS, 50_000_000)
    if args.audio is not None:
        sends["audio"] = _bps(args.voice_kbps, "--voice-kbps", 6_000, 510_000)
    for spec in (args.video, args.audio):
        if spec in FILLED_BY_OTHERS:
            raise ConfigError(f"only a session has the source {spec}: give another one")
    return sends


def _bps(kbps: float, option: str, least: int, most: int) -> int:
    bps = round(kbps * 1000)
    if not least <= bps <= most:
        raise ConfigError(f"{option} {kbps:g}: take {least / 1000:g} to {most / 1000:g}")
    return bps


class CodedSources(Closing):
    """Codes the sources while somebody takes what comes. A context manager.

    send_unit, send_opus: called on the event loop. ConfigError for sources that cannot be opened.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        clock: MonotonicClock,
        *,
        send_unit: Callable[[AccessUnit], None],
        send_opus: Callable[[bytes, CaptureStamp], None],
    ) -> None:
        self._clock = clock
        self._send_unit, self._send_opus = send_unit, send_opus
        self._loop = asyncio.get_running_loop()
        self._ended = threading.Event()
        #: Whether anybody takes what is coded.
        self.wanted = False
        sends = sends_of(args)
        self.rate = RateFollower(most_bps=sends.get("video", LEAST_BPS))
        self.sent = RateMeter()
        self._keys = 0
        self.coded = {"video": 0, "audio": 0}
        #: Why a source has ended; "" if none has.
        self.fault = ""
        self._threads: list[threading.Thread] = []
        if args.video is not None:
            width, height = parse_size(args.size)
            encoder = H264Encoder(
                width=width,
                height=height,
                fps=args.fps,
                cap_bps=sends["video"],
                refresh_s=SLOW_REFRESH_S,
            )
            video, plan = open_pictures(args, clock), PicturePlan(bps=sends["video"])
            self._begin("pictures", self._pictures, video, encoder, plan)
        if args.audio is not None:
            audio, voice = open_sound(args, clock), OpusEncoder(bitrate_bps=sends["audio"])
            self._begin("sound", self._sound, audio, voice)

    def want_key(self) -> None:
        self._keys += 1

    def close(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(_LAST_S)

    def handle_wish(self, wish_bps: int | None) -> None:
        """Follow what the partners can take (REMB). Call it a few times a second."""
        now_ns = self._clock.now_ns()
        self.rate.handle_wish(wish_bps, self.sent.last_bps(now_ns), now_ns)

    def _count_and_send(self, unit: AccessUnit) -> None:
        self.sent.add(self._clock.now_ns(), len(unit.data))
        self._send_unit(unit)

    def _begin(self, name: str, run: Callable[..., None], source: Any, *rest: Any) -> None:
        def guarded() -> None:
            try:
                run(source, *rest)
            except Exception as error:
                self.fault = f"{name}: {error}"
                raise
            finally:
                source.close()

        thread = threading.Thread(target=guarded, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _pictures(self, source: Any, encoder: H264Encoder, plan: PicturePlan) -> None:
        picture = empty_picture(encoder.width, encoder.height)
        answered = 0
        while not self._ended.is_set():
            stamp = source.read(picture, _PATIENCE_NS)
            if stamp is None or not self.wanted:
                continue
            if self._keys != answered:
                answered = self._keys
                plan.handle_key_request()
            plan.handle_rate(self.rate.bps)
            coding = plan.handle_picture(self._clock.now_ns())
            if coding is None:
                continue
            unit = encoder.encode(VideoFrame(picture, stamp), coding)
            now_ns = self._clock.now_ns()
            plan.handle_coded(len(unit.data), now_ns)
            self.coded["video"] += 1
            self._hand_over(self._count_and_send, unit)

    def _sound(self, source: Any, encoder: OpusEncoder) -> None:
        while not self._ended.is_set():
            block = source.read(_PATIENCE_NS)
            if block is None or not self.wanted:
                continue
            opus = encoder.encode(block.samples)
            self.coded["audio"] += 1
            self._hand_over(self._send_opus, opus, heard_stamp(block.stamp))

    def _hand_over(self, send: Callable[..., None], *what: Any) -> None:
        if not self._ended.is_set():
            self._loop.call_soon_threadsafe(send, *what)
