"""The source of `kontur-av send`, with its encoder and the sender of its stream."""

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.sources import open_audio, open_video
from kontur_av.streams.encoding_thread import switch_threads_often
from kontur_av.streams.feeds import PictureFeed, SoundFeed


@contextmanager
def open_feed(args: argparse.Namespace, clock: MonotonicClock) -> Iterator[PictureFeed | SoundFeed]:
    """The source, encoder and sender that the options name."""
    feed = _pictures(args, clock) if args.video is not None else _sound(args, clock)
    try:
        yield feed
    finally:
        feed.close()


def _pictures(args: argparse.Namespace, clock: MonotonicClock) -> PictureFeed:
    switch_threads_often()
    width, height = parse_size(args.size)
    if args.refresh_s is not None and not 0.1 <= args.refresh_s <= 600:
        raise ConfigError(f"--refresh-s {args.refresh_s:g}: take 0.1 to 600 seconds")
    source = open_video(
        args.video,
        name="video",
        width=width,
        height=height,
        fps=args.fps,
        clock=clock,
        scenes=_scenes("video") if args.video.startswith("scene:") else None,
    )
    auto = args.coded_size == "auto"
    return PictureFeed(
        source,
        clock,
        size=(width, height),
        fps=args.fps,
        cap_bps=_bps(args.cap_kbps),
        channel_bps=None if args.channel_kbps is None else _bps(args.channel_kbps),
        coded_size=None if auto else parse_size(args.coded_size, "--coded-size"),
        refresh_s=args.refresh_s,
        search=args.search,
    )


def _sound(args: argparse.Namespace, clock: MonotonicClock) -> SoundFeed:
    scenes = _scenes("audio") if args.audio.startswith("scene:") else None
    return SoundFeed(
        open_audio(args.audio, name="audio", clock=clock, scenes=scenes),
        clock,
        cap_bps=_bps(args.cap_kbps),
        channel_bps=None if args.channel_kbps is None else _bps(args.channel_kbps),
    )


def _bps(kbps: float) -> int:
    return round(kbps * 1000)


def _scenes(kind: str) -> Mapping[str, Any]:
    from telepresence import world

    scenes: Mapping[str, Any] = world.video_scenes() if kind == "video" else world.audio_scenes()
    return scenes
