"""The sources of commands that send; for `kontur-av send` with encoder and sender."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.sources import AudioSource, VideoSource, open_audio, open_video
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
    if args.refresh_s is not None and not 0.1 <= args.refresh_s <= 600:
        raise ConfigError(f"--refresh-s {args.refresh_s:g}: take 0.1 to 600 seconds")
    auto = args.coded_size == "auto"
    return PictureFeed(
        open_pictures(args, clock),
        clock,
        size=parse_size(args.size),
        fps=args.fps,
        cap_bps=_bps(args.cap_kbps),
        channel_bps=None if args.channel_kbps is None else _bps(args.channel_kbps),
        coded_size=None if auto else parse_size(args.coded_size, "--coded-size"),
        refresh_s=args.refresh_s,
        search=args.search,
        codec=args.codec,
    )


def _sound(args: argparse.Namespace, clock: MonotonicClock) -> SoundFeed:
    return SoundFeed(
        open_sound(args, clock),
        clock,
        cap_bps=_bps(args.cap_kbps),
        channel_bps=None if args.channel_kbps is None else _bps(args.channel_kbps),
    )


def _bps(kbps: float) -> int:
    return round(kbps * 1000)


def add_picture_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--size", metavar="WxH", default="640x480", help="default: 640x480")
    parser.add_argument("--fps", metavar="N", type=int, default=30, help="default: 30")


def open_pictures(args: argparse.Namespace, clock: MonotonicClock) -> VideoSource:
    """The source of `--video`, of `--size` and `--fps`. ConfigError."""
    scenes = None
    if args.video.startswith("scene:"):
        from telepresence.world import video_scenes

        scenes = video_scenes()
    width, height = parse_size(args.size)
    return open_video(
        args.video,
        name="video",
        width=width,
        height=height,
        fps=args.fps,
        clock=clock,
        scenes=scenes,
    )


def open_sound(args: argparse.Namespace, clock: MonotonicClock) -> AudioSource:
    """The source of `--audio`. ConfigError."""
    scenes = None
    if args.audio.startswith("scene:"):
        from telepresence.world import audio_scenes

        scenes = audio_scenes()
    return open_audio(args.audio, name="audio", clock=clock, scenes=scenes)
