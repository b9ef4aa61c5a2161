"""`kontur-av bench video`: pictures through a thin channel, beside GStreamer.

Each contender is two commands as a user types them, sender and receiver, with real sockets. The
camera writes the pictures of a clip into a pipe, each at its exact instant with its number drawn
into it. The channel is a queue of a fixed rate: RTP headers and RTCP count, nothing is dropped, and
answers of the receiver go back at once. The screen reads full-size pictures from a second pipe and
reads their numbers. So a latency begins at the instant of capture and includes the pipe to the
sender, coding, channel, decoding and scaling. It ends with the last octet in the screen's process.
Both pipes are the same for all. PSNR and SSIM compare the luma with the captured picture of the
same number, without the 16 rows of the number. The first second counts only against the cap.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
from rich.table import Table

from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from pipelines.bench.charts import check_plot, distributions, save
from pipelines.bench.console import open_console
from pipelines.bench.result import Headline, Json, as_json
from pipelines.bench.result_file import write_result
from pipelines.bench.video.clips import FOOTAGE, SCENE, Clip, clips
from pipelines.bench.video.contenders import ContenderError, missing
from pipelines.bench.video.figures import ContenderFigures
from pipelines.bench.video.marks import NUMBERS, check_width
from pipelines.bench.video.run import TrialTerms, measure
from pipelines.bench.video.targets import CONTENDERS, NARROW, WIDE, VideoVerdict, judge
from pipelines.report.report_file import check_writable

_WIDE_KBPS = (512.0, 530.0)
_FPS = 30


@dataclass(frozen=True, slots=True)
class ClipResult:
    """One clip at one rate. measured: figures and latencies (ms) of each contender."""

    rate: str
    clip: str
    measured: Mapping[str, tuple[ContenderFigures, list[float]]]
    verdicts: Sequence[VideoVerdict]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench video`."""
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each run (default 20)"
    )
    parser.add_argument(
        "--cap-kbps", type=float, default=85.0, metavar="K", help="default 85", dest="cap_kbps"
    )
    parser.add_argument("--channel-kbps", type=float, default=88.0, metavar="C", help="default 88")
    parser.add_argument("--wide", action="store_true", help="then the same at 512 in 530 kbit/s")
    parser.add_argument(
        "--clip", type=Path, action="append", default=[], metavar="FILE", help="another clip"
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help=f"of a clip ({', '.join((*FOOTAGE, SCENE))}, a file's) or of a contender "
        f"({', '.join(CONTENDERS)}); may be given several times",
    )
    parser.add_argument("--size", default="640x480", metavar="WxH", help="default 640x480")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the latencies as a PNG")


def run(args: argparse.Namespace) -> int:
    """Measure, and print each table as soon as it is known; 1 if a contender failed."""
    width, height, terms = _checked(args)
    # Threads of OpenCV would not survive the forks, and one is enough.
    cv2.setNumThreads(1)
    console = open_console(args)

    def say(line: str) -> None:
        """Print a line unwrapped."""
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    count = round((args.seconds + terms[0].settle_s) * _FPS)
    names = set(args.only)
    contenders = _contenders(names & set(CONTENDERS), say)
    chosen = names - set(CONTENDERS)
    results: list[ClipResult] = []
    panels: dict[str, dict[str, list[float]]] = {}
    failed = False
    found = [
        (name, make)
        for name, make in clips(args.clip, width, height, _FPS, count, say)
        if not chosen or name in chosen
    ]
    for name, make in found:
        clip = make()
        for these in terms:
            measured = _measured(contenders, clip, these, say)
            failed |= len(measured) < len(contenders)
            figures = {who: result for who, (result, _) in measured.items()}
            rate = f"{these.cap_kbps:g} kbit/s through {these.channel_kbps:g}"
            console.print(_table(f"{name}, {rate}", figures))
            for who, result in figures.items():
                for note in _notes(who, result):
                    say(note)
            verdicts = judge(figures, WIDE if these is not terms[0] else NARROW, these.cap_kbps)
            if verdicts:
                console.print(_verdicts(f"{name}, {rate}: kontur-av against its targets", verdicts))
            results.append(ClipResult(rate, name, measured, verdicts))
            # After every clip: a run is long, and may be ended early.
            write_result(args.report, _report(results), _headlines(results), digits=4)
            panels[f"{name}, {rate}: capture to displayed"] = {
                who: latencies for who, (_, latencies) in measured.items()
            }
            if args.plot is not None:
                save(distributions(panels, axis="capture to displayed, ms"), args.plot)
    return 1 if failed else 0


def _report(results: Sequence[ClipResult]) -> dict[str, Json]:
    """By rate, clip and contender."""
    found: dict[str, dict[str, Json]] = {}
    for of in results:
        clip: dict[str, Json] = {"targets": as_json(of.verdicts)}
        for who, (figures, latencies) in of.measured.items():
            row = as_json(figures)
            assert isinstance(row, dict)
            clip[who] = row | {"latencies_ms": as_json(latencies)}
        found.setdefault(of.rate, {})[of.clip] = clip
    return {rate: as_json(clips) for rate, clips in found.items()}


def _headlines(results: Sequence[ClipResult]) -> list[Headline]:
    found = []
    for of in results:
        for who, (figures, _) in of.measured.items():
            for what, unit, value in (
                ("capture to displayed, p50", "ms", figures.latency_ms["p50"]),
                ("capture to displayed, p99", "ms", figures.latency_ms["p99"]),
                ("PSNR, mean", "dB", figures.psnr_db.mean),
                ("PSNR, worst 5 %", "dB", figures.psnr_db.worst),
                ("displayed", "pictures/s", figures.per_second),
                ("CPU of both ends", "s", figures.cpu_s),
            ):
                group = f"{of.clip}, {of.rate}"
                found.append(Headline(group=group, what=what, who=who, unit=unit, value=value))
        found += [
            Headline(
                group=f"targets: {of.clip}, {of.rate}",
                what=verdict.what,
                unit=verdict.unit,
                value=verdict.value,
                target=verdict.target,
                met=verdict.met,
            )
            for verdict in of.verdicts
        ]
    return found


def _checked(args: argparse.Namespace) -> tuple[int, int, list[TrialTerms]]:
    width, height = parse_size(args.size)
    if not check_width(width):
        raise ConfigError(f"--size {args.size}: too narrow for the number drawn into each picture")
    most_s = NUMBERS // _FPS - 1
    if not 1 <= args.seconds <= most_s:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to {most_s}")
    if not 10 <= args.cap_kbps <= 10_000:
        raise ConfigError(f"--cap-kbps {args.cap_kbps:g}: give 10 to 10000")
    if not args.cap_kbps <= args.channel_kbps <= 20_000:
        raise ConfigError(
            f"--channel-kbps {args.channel_kbps:g}: give the cap of {args.cap_kbps:g} or more"
        )
    for path in args.clip:
        if not path.is_file():
            raise ConfigError(f"--clip {path}: there is no such file")
    known = {*CONTENDERS, *FOOTAGE, SCENE, *(path.stem for path in args.clip)}
    for name in args.only:
        if name not in known:
            raise ConfigError(f"--only {name}: choose of {', '.join(sorted(known))}")
    check_writable(args.report)
    check_plot(args.plot)
    terms = [TrialTerms(fps=_FPS, cap_kbps=args.cap_kbps, channel_kbps=args.channel_kbps)]
    if args.wide:
        terms.append(TrialTerms(fps=_FPS, cap_kbps=_WIDE_KBPS[0], channel_kbps=_WIDE_KBPS[1]))
    return width, height, terms


def _contenders(chosen: set[str], say: Callable[[str], None]) -> list[str]:
    here = []
    for name in CONTENDERS:
        if chosen and name not in chosen:
            continue
        reason = missing(name)
        if reason is None:
            here.append(name)
        else:
            say(f"{name}: skipped; {reason}")
    return here


def _measured(
    contenders: Sequence[str], clip: Clip, terms: TrialTerms, say: Callable[[str], None]
) -> dict[str, tuple[ContenderFigures, list[float]]]:
    """The contenders that could be measured, in turn."""
    found = {}
    for name in contenders:
        try:
            found[name] = measure(name, clip, terms)
        except ContenderError as error:
            say(f"{name} on {clip.name}: {error}")
    return found


#: Heading of a row, and its text from the figures.
_ROWS: tuple[tuple[str, Callable[[ContenderFigures], str]], ...] = (
    *(
        (f"capture to displayed, {key}, ms", lambda found, key=key: f"{found.latency_ms[key]:.1f}")
        for key in ("p50", "p95", "p99", "max")
    ),
    ("PSNR, mean, dB", lambda found: f"{found.psnr_db.mean:.2f}"),
    ("PSNR, worst 5 %, dB", lambda found: f"{found.psnr_db.worst:.2f}"),
    ("SSIM, mean", lambda found: f"{found.ssim.mean:.3f}"),
    ("SSIM, worst 5 %", lambda found: f"{found.ssim.worst:.3f}"),
    ("displayed pictures a second", lambda found: f"{found.per_second:.1f}"),
    ("longest gap, ms", lambda found: f"{found.longest_gap_ms:.0f}"),
    ("largest 1 s of payload, kbit/s", lambda found: _kbps(found.payload_1s_bps)),
    ("largest 1 s with RTP headers", lambda found: _kbps(found.rtp_1s_bps)),
    ("largest 0.1 s of payload", lambda found: _kbps(found.payload_100ms_bps)),
    ("largest 0.1 s with RTP headers", lambda found: _kbps(found.rtp_100ms_bps)),
    ("CPU of the sender, s", lambda found: f"{found.sender_cpu_s:.2f}"),
    ("CPU of the receiver, s", lambda found: f"{found.receiver_cpu_s:.2f}"),
)


def _kbps(rate_bps: float) -> str:
    return f"{rate_bps / 1000:.1f}"


def _table(title: str, measured: Mapping[str, ContenderFigures]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for name in measured:
        table.add_column(name, justify="right")
    for heading, value in _ROWS:
        table.add_row(heading, *(value(found) for found in measured.values()))
    return table


def _notes(name: str, found: ContenderFigures) -> list[str]:
    """What disturbed this run."""
    notes = []
    if found.guessed or found.unreadable:
        notes.append(
            f"{name}: {found.guessed} numbers known only from their neighbours, "
            f"{found.unreadable} not at all"
        )
    if found.left_out_by_camera:
        notes.append(
            f"{name}: {found.left_out_by_camera} pictures left out by the camera, "
            "because the sender had not read the ones before"
        )
    if found.others_cores > 0.1:
        notes.append(
            f"{name}: other programs used {found.others_cores:.1f} cores: "
            "an idle machine has lower latencies and higher rates"
        )
    if not found.realtime or found.camera_latest_us > 1000 or found.channel_late_us["p99"] > 500:
        notes.append(
            f"{name}: this machine was busy: camera up to {found.camera_latest_us / 1000:.1f} ms "
            f"late, channel {found.channel_late_us['p99'] / 1000:.2f} ms at p99"
            + ("" if found.realtime else ", without real-time priority")
        )
    return notes


def _verdicts(title: str, verdicts: Sequence[VideoVerdict]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("", "target", "found", "against", ""):
        table.add_column(heading, justify="left" if not heading else "right")
    for verdict in verdicts:
        table.add_row(
            verdict.what,
            verdict.target,
            verdict.found,
            verdict.against,
            "met" if verdict.met else "[red]missed[/red]",
        )
    return table
