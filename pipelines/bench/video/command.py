"""`kontur-av bench video`: pictures through a thin channel, on this machine.

`kontur-av send` and `kontur-av receive` run as a user types them, with real sockets. The camera
writes the pictures of a clip into a pipe, each at its exact instant with its number drawn into it.
The channel is a queue of a fixed rate: RTP headers and RTCP count, nothing is dropped, and answers
of the receiver go back at once. The screen reads full-size pictures from a second pipe and reads
their numbers. So a latency begins at the instant of capture and includes the pipe to the sender,
coding, channel, decoding and scaling. It ends with the last octet in the screen's process. PSNR and
SSIM compare the luma with the captured picture of the same number, without the 16 rows of the
number. The first second counts only against the cap.

`python -m benchmarks video` in the project's repository compares with GStreamer and Chromium.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2

from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from pipelines.bench.course.marks import NUMBERS, check_width
from pipelines.bench.video.clips import SCENE, Clip, film, scene
from pipelines.bench.video.contenders import KONTUR_AV, ContenderError
from pipelines.bench.video.figures import (
    ALONE,
    OURS,
    headlines,
    judge,
    notes,
)
from pipelines.bench.video.run import TrialTerms, measure
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json, headline_tables

FPS = 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each clip (default 20)"
    )
    parser.add_argument("--cap-kbps", type=float, default=85.0, metavar="K", help="default 85")
    parser.add_argument("--channel-kbps", type=float, default=88.0, metavar="C", help="default 88")
    parser.add_argument(
        "--clip",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="video files, cropped to the size, instead of the built-in scene",
    )
    parser.add_argument("--size", default="640x480", metavar="WxH", help="default 640x480")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the latencies as a PNG")


def run(args: argparse.Namespace) -> int:
    """Measure, and print each table as soon as it is known; 1 if sender or receiver failed."""
    width, height = check_options(args)
    terms = TrialTerms(fps=FPS, cap_kbps=args.cap_kbps, channel_kbps=args.channel_kbps)
    # Threads of OpenCV would not survive the forks, and one is enough.
    cv2.setNumThreads(1)
    console = open_console(args)
    say = partial(console.print, highlight=False, markup=False, soft_wrap=True)
    rate = f"{args.cap_kbps:g} kbit/s through {args.channel_kbps:g}"
    body: dict[str, Json] = {}
    found: list[Headline] = []
    panels: dict[str, dict[str, list[float]]] = {}
    for name, make in _clips(args.clip, width, height, round((args.seconds + 1) * FPS)).items():
        clip = make()
        try:
            trial = measure(KONTUR_AV, clip, terms)
        except ContenderError as error:
            say(f"{name}: {error}")
            return 1
        measured = {OURS: trial.figures}
        title = f"{name}, {rate}"
        for note in notes(OURS, trial.figures):
            say(note)
        verdicts = judge(measured, ALONE, args.cap_kbps)
        lines = headlines(title, measured, verdicts)
        console.print(*headline_tables(lines))
        row = as_json(trial.figures)
        assert isinstance(row, dict)
        latencies: dict[str, Json] = {"latencies_ms": as_json(trial.latencies_ms)}
        body[name] = {"targets": as_json(verdicts), OURS: row | latencies}
        found += lines
        write_result(args.report, {rate: body}, found, digits=4)
        panels[f"{title}: capture to displayed"] = {OURS: trial.latencies_ms}
    if args.plot is not None:
        save(distributions(panels, axis="capture to displayed, ms"), args.plot)
    return 0


def check_options(
    args: argparse.Namespace, *, lead_s: int = 0, taken: tuple[str, ...] = ()
) -> tuple[int, int]:
    """Width and height; ConfigError for an option that cannot be.

    lead_s: before each clip. taken: names that no file's may be.
    """
    width, height = parse_size(args.size)
    if not check_width(width):
        raise ConfigError(f"--size {args.size}: too narrow for the number drawn into each picture")
    most_s = NUMBERS // FPS - 1 - lead_s
    if not 1 <= args.seconds <= most_s:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to {most_s}")
    if not 10 <= args.cap_kbps <= 10_000:
        raise ConfigError(f"--cap-kbps {args.cap_kbps:g}: give 10 to 10000")
    if not args.cap_kbps <= args.channel_kbps <= 20_000:
        raise ConfigError(
            f"--channel-kbps {args.channel_kbps:g}: give the cap of {args.cap_kbps:g} or more"
        )
    stems = [path.stem for path in args.clip]
    for path in args.clip:
        if not path.is_file():
            raise ConfigError(f"--clip {path}: there is no such file")
        if path.stem in taken or stems.count(path.stem) > 1:
            raise ConfigError(
                f"--clip {path.stem}: there is another clip of this name: rename the file"
            )
    check_writable(args.report)
    check_plot(args.plot)
    return width, height


def _clips(files: list[Path], width: int, height: int, count: int) -> dict[str, Callable[[], Clip]]:
    if not files:
        return {SCENE: partial(scene, width, height, FPS, count)}
    return {path.stem: partial(film, path, path.stem, width, height, count) for path in files}
