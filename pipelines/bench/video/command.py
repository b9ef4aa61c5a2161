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
import os
import resource
import socket
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from pipelines.bench.course.ends import Carried, Filmed, Watched, carry, film_to, watch
from pipelines.bench.course.marks import MARK_ROWS, NUMBERS, check_width, read_all, read_number
from pipelines.bench.video.clips import SCENE, Clip, film, led_in, scene, shared_array
from pipelines.bench.video.contenders import KONTUR_AV, Contender, ContenderError, Course
from pipelines.bench.video.quality import (
    ALONE,
    OURS,
    ContenderMetrics,
    Luma,
    headlines,
    judge,
    largest_bps,
    latest,
    mean_bps,
    notes,
    percentiles,
    psnr_db,
    shown,
    ssim,
    summarise,
)
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json, headline_tables
from pipelines.session.command_process import ended_alike

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
        measured = {OURS: trial.metrics}
        title = f"{name}, {rate}"
        for note in notes(OURS, trial.metrics):
            say(note)
        verdicts = judge(measured, ALONE, args.cap_kbps)
        lines = headlines(title, measured, verdicts)
        console.print(*headline_tables(lines))
        row = as_json(trial.metrics)
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


_START_S = 30.0
#: After the end of the camera, the last pictures have this long to arrive.
_REST_S = 1.5


#: Scores of pairs of picture and original, in order of time; empty for no measure.
Score = Callable[[Iterable[tuple[Luma, Luma]]], list[float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialTerms:
    """The same for all contenders.

    settle_s: length of the beginning that counts only against the cap. lead_s: before that, this
    much of the clip backwards, or more for a contender that needs it. wide: of the wide channel.
    """

    fps: int = 30
    cap_kbps: float
    channel_kbps: float
    settle_s: int = 1
    lead_s: int = 0
    wide: bool = False


@dataclass(frozen=True, slots=True)
class Trial:
    """What one contender did on one clip.

    latencies_ms: of each picture that counts, in order of arrival. shots: what the screen showed
    when the pictures of those numbers were due there, and the number of the picture shown.
    """

    metrics: ContenderMetrics
    latencies_ms: list[float]
    shots: dict[int, tuple[int, Luma]]


def measure(
    contender: Contender,
    clip: Clip,
    terms: TrialTerms,
    *,
    shot_numbers: Sequence[int] = (),
    score: Score = lambda _: [],
) -> Trial:
    """Measure one contender.

    shot_numbers: of the pictures to keep. score: another measure of quality, as VMAF. Raises
    ContenderError when the contender does not run, EndError when the bench itself fails.
    """
    lead_s = max(terms.lead_s, contender.lead_s)
    lead = lead_s * terms.fps
    clip = led_in(clip, lead)
    terms = replace(terms, settle_s=terms.settle_s + lead_s)
    _, rows, width = clip.pictures.shape
    height = rows * 2 // 3
    lumas = shared_array(len(clip.order), height, width)
    meter = _Machine()
    with ended_alike(), ExitStack() as stack:
        directory = Path(stack.enter_context(TemporaryDirectory(prefix="kontur-av-bench-")))
        entrance, exit_port = free_ports(), free_ports()
        course = Course(
            width=width,
            height=height,
            fps=terms.fps,
            cap_kbps=terms.cap_kbps,
            channel_kbps=terms.channel_kbps,
            entrance=entrance,
            exit=exit_port,
            directory=directory,
        )
        channel = carry(
            entrance, exit_port, round(terms.channel_kbps * 1000), muxed=contender.muxed
        )
        stack.callback(channel.close)
        screen = watch(str(course.screen), lumas)
        stack.callback(screen.close)
        sender, receiver = stack.enter_context(contender.started(course))
        camera = film_to(clip, str(course.film), terms.fps, _START_S)
        stack.callback(camera.close)
        filmed: Filmed = camera.result(_START_S + 2 * len(clip.order) / terms.fps + 10)
        time.sleep(_REST_S)
        sender_cpu_s = sender.stop(0)
        receiver_cpu_s = receiver.stop(0)
        screen.end()
        channel.end()
        watched: Watched = screen.result(10)
        carried: Carried = channel.result(10)
    return _metrics(
        clip,
        terms,
        lumas,
        filmed,
        watched,
        carried,
        (sender_cpu_s, receiver_cpu_s),
        meter.others(),
        {number: number + lead for number in shot_numbers},
        score,
    )


def _metrics(
    clip: Clip,
    terms: TrialTerms,
    lumas: NDArray[np.uint8],
    filmed: Filmed,
    watched: Watched,
    carried: Carried,
    cpu_s: tuple[float, float],
    others_cores: float,
    shot_numbers: Mapping[int, int],
    score: Score,
) -> Trial:
    first = terms.settle_s * terms.fps
    numbers = _numbers(filmed, watched)
    shown_ns = {
        number: at
        for number, at in zip(numbers, watched.shown_ns, strict=True)
        if number is not None
    }
    seen = shown(filmed.captured_ns, shown_ns, first=first, fps=terms.fps)
    compared = [
        (lumas[index, MARK_ROWS:], clip.luma(number)[MARK_ROWS:])
        for index, number in enumerate(numbers)
        if number is not None and number >= first
    ]
    scores = score(compared)
    counted_ns = filmed.captured_ns[first:]
    unreadable = sum(number is None for number in numbers)
    payload_1s_bps, payload_100ms_bps = largest_bps(carried.came_ns, carried.payload_octets)
    rtp_1s_bps, rtp_100ms_bps = largest_bps(carried.came_ns, carried.octets)
    metrics = ContenderMetrics(
        latency_ms=percentiles(seen.latency_ms),
        psnr_db=summarise([psnr_db(*pair) for pair in compared]),
        ssim=summarise([ssim(*pair) for pair in compared]),
        vmaf=summarise(scores) if scores else None,
        per_second=seen.per_second,
        longest_gap_ms=seen.longest_gap_ms,
        payload_1s_bps=payload_1s_bps,
        payload_100ms_bps=payload_100ms_bps,
        rtp_1s_bps=rtp_1s_bps,
        rtp_100ms_bps=rtp_100ms_bps,
        payload_bps=mean_bps(
            carried.came_ns,
            carried.payload_octets,
            begin_ns=int(counted_ns[counted_ns > 0].min(initial=counted_ns.max(initial=0))),
            seconds=len(counted_ns) / terms.fps,
        ),
        rtcp_octets=carried.control_octets,
        answers=carried.returned,
        sender_cpu_s=cpu_s[0],
        receiver_cpu_s=cpu_s[1],
        guessed=sum(read_number(squares) is None for squares in watched.squares) - unreadable,
        unreadable=unreadable,
        left_out_by_camera=int((filmed.captured_ns == 0).sum()),
        camera_latest_us=filmed.latest_ns / NS_PER_US,
        channel_late_us=percentiles([late / NS_PER_US for late in carried.late_ns]),
        channel_longest_wait_ms=carried.longest_wait_ns / NS_PER_MS,
        realtime=filmed.realtime and watched.realtime and carried.realtime,
        others_cores=others_cores,
    )
    shots = {}
    for wanted, drawn in shot_numbers.items():
        index, number = latest(numbers, drawn)
        if number is not None:
            shots[wanted] = (number + wanted - drawn, lumas[index].copy())
    return Trial(metrics, seen.latency_ms, shots)


def _numbers(filmed: Filmed, watched: Watched) -> list[int | None]:
    captured = np.flatnonzero(filmed.captured_ns)
    counts = np.searchsorted(filmed.captured_ns[captured], watched.shown_ns)
    numbers = captured.tolist()
    return read_all(watched.squares, [numbers[:count] for count in counts])


class _Machine:
    """The cores that all other programs use, since this was made."""

    def __init__(self) -> None:
        self._start = self._read()

    def others(self) -> float:
        """In cores. Call it after all children of this process have been waited for."""
        start_ns, start_s = self._start
        now_ns, now_s = self._read()
        return max(now_s - start_s, 0.0) * NS_PER_S / (now_ns - start_ns)

    @staticmethod
    def _read() -> tuple[int, float]:
        # proc(5): user, nice, system, idle, iowait, irq, softirq, steal, in ticks.
        words = Path("/proc/stat").read_text().split(maxsplit=9)
        user, nice, system, _, _, irq, soft, steal = (int(word) for word in words[1:9])
        busy_s = (user + nice + system + irq + soft + steal) / os.sysconf("SC_CLK_TCK")
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return time.monotonic_ns(), busy_s - sum(one.ru_utime + one.ru_stime for one in used)


def free_ports() -> int:
    """A UDP port of the loopback that is free, as is the next one."""
    for _ in range(100):
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second,
        ):
            first.bind(("127.0.0.1", 0))
            port: int = first.getsockname()[1]
            with suppress(OSError, OverflowError):
                second.bind(("127.0.0.1", port + 1))
                return port
    raise ConfigError("no two neighbouring UDP ports of the loopback are free: end what uses them")
