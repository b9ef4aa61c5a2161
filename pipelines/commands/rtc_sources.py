"""The options of what is sent to a partner: a source of pictures and one of sound."""

import argparse
from collections.abc import Callable

from kontur_av.clock import MonotonicClock
from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.errors import ConfigError
from kontur_av.media import AccessUnit, CaptureStamp, parse_size
from pipelines.media.sending import (
    add_picture_arguments,
    add_source_arguments,
    check_alone,
    open_pictures,
    open_sound,
)
from pipelines.partner.coded_sources import CodedSources
from pipelines.partner.decisions import LEAST_BPS
from pipelines.partner.description import Kind
from pipelines.session.option_rows import add_options

VIDEO_KBPS, VOICE_KBPS = 1500.0, 32.0


def add_sending_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_arguments(parser)
    add_picture_arguments(parser)
    add_options(
        parser,
        f"--video-kbps K <float={VIDEO_KBPS}>  of the picture, less when the partner can take "
        f"less (default: {VIDEO_KBPS:g})",
        f"--voice-kbps K <float={VOICE_KBPS}>  of the voice (default: {VOICE_KBPS:g})",
    )


def sends_of(args: argparse.Namespace) -> dict[Kind, int]:
    """Return the bit/s of what is sent, by kind. ConfigError for rates that cannot work."""
    check_alone(args.video)
    check_alone(args.audio)
    sends: dict[Kind, int] = {}
    if args.video is not None:
        sends["video"] = _bps(args.video_kbps, "--video-kbps", LEAST_BPS, 50_000_000)
    if args.audio is not None:
        sends["audio"] = _bps(args.voice_kbps, "--voice-kbps", 6_000, 510_000)
    return sends


def _bps(kbps: float, option: str, least: int, most: int) -> int:
    bps = round(kbps * 1000)
    if not least <= bps <= most:
        raise ConfigError(f"{option} {kbps:g}: take {least / 1000:g} to {most / 1000:g}")
    return bps


def coded_sources(
    args: argparse.Namespace,
    clock: MonotonicClock,
    *,
    send_unit: Callable[[AccessUnit], None],
    send_opus: Callable[[bytes, CaptureStamp], None],
) -> CodedSources:
    """Begin to code the sources. ConfigError for those that cannot be opened."""
    sends = sends_of(args)
    most_bps = sends.get("video", LEAST_BPS)
    sources = CodedSources(clock, most_bps=most_bps, send_unit=send_unit, send_opus=send_opus)
    if args.video is not None:
        width, height = parse_size(args.size)
        encoder = H264Encoder(
            width=width, height=height, fps=args.fps, cap_bps=most_bps, refresh_s=SLOW_REFRESH_S
        )
        sources.add_pictures(open_pictures(args, clock), encoder)
    if args.audio is not None:
        sources.add_sound(open_sound(args, clock), OpusEncoder(bitrate_bps=sends["audio"]))
    return sources
