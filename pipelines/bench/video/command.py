"""`kontur-av bench video`: pictures through a thin channel, beside GStreamer.

Each contender is two commands as a user types them, sender and receiver, with real sockets. The
camera writes the pictures of a clip into a pipe, each at its exact instant with its number drawn
into it. The channel is a queue of a fixed rate: RTP headers and RTCP count, nothing is dropped, and
answers of the receiver go back at once. The screen reads full-size pictures from a second pipe and
reads their numbers. So a latency begins at the instant of capture and includes the pipe to the
sender, coding, channel, decoding and scaling. It ends with the last octet in the screen's process.
Both pipes are the same for all. PSNR and SSIM compare the luma with the captured picture of the
same number, without the 16 rows of the number. The first second counts only against the cap.

Clips that settings were tuned on stand apart from all others: a setting may flatter the first.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import cv2
from rich.table import Table

from benchmarks.video.crops import check_crops, shot_numbers, write_crops
from benchmarks.video.groups import (
    OTHERS,
    TUNED_ON,
    GroupRow,
    GroupVerdict,
    group_headlines,
    group_rows,
    group_verdicts,
)
from benchmarks.video.vmaf import vmaf_program
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from pipelines.bench.marks import NUMBERS, check_width
from pipelines.bench.video.clips import CLIPS, Clip, clips
from pipelines.bench.video.contenders import ContenderError, missing
from pipelines.bench.video.figures import ContenderFigures
from pipelines.bench.video.run import CHROMIUM_LEAD_S, Trial, TrialTerms, measure
from pipelines.bench.video.targets import (
    CONTENDERS,
    NARROW,
    STRANGE,
    WIDE,
    VideoVerdict,
    judge,
)
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.console import open_console
from pipelines.report.report_file import check_writable
from pipelines.report.result import Headline, Json, as_json
from pipelines.report.result_file import write_result

_WIDE_KBPS = (512.0, 530.0)
_FPS = 30
_LONGEST_LEAD_S = 60


@dataclass(frozen=True, slots=True)
class ClipResult:
    """One clip at one rate. group: TUNED_ON or OTHERS. measured: by contender."""

    rate: str
    clip: str
    group: str
    measured: Mapping[str, Trial]
    verdicts: Sequence[VideoVerdict]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench video`."""
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each run (default 20)"
    )
    parser.add_argument(
        "--lead-s",
        type=int,
        default=0,
        metavar="S",
        help="before each clip, this much of it backwards, which does not count (default 0; "
        f"Chromium gets at least {CHROMIUM_LEAD_S})",
    )
    parser.add_argument(
        "--cap-kbps", type=float, default=85.0, metavar="K", help="default 85", dest="cap_kbps"
    )
    parser.add_argument("--channel-kbps", type=float, default=88.0, metavar="C", help="default 88")
    parser.add_argument("--wide", action="store_true", help="then the same at 512 in 530 kbit/s")
    parser.add_argument("--only-wide", action="store_true", help="only at 512 in 530 kbit/s")
    parser.add_argument(
        "--clip",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="further video files; larger ones are cropped, not scaled",
    )
    parser.add_argument(
        "--fetch",
        action="store_true",
        help="download clips of packages that are not in the cache yet",
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help=f"of a clip ({', '.join(CLIPS)}, a file's) or of a contender "
        f"({', '.join(CONTENDERS)}); may be given several times",
    )
    parser.add_argument("--size", default="640x480", metavar="WxH", help="default 640x480")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the latencies as a PNG")
    parser.add_argument(
        "--crops",
        type=Path,
        metavar="DIR",
        help="write the same details of each contender's pictures side by side, as PNG",
    )


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
    chosen = frozenset(names - set(CONTENDERS))
    if vmaf_program() is None:
        say("VMAF: left out; pip install imageio-ffmpeg brings an FFmpeg that has libvmaf")
    shots = shot_numbers(count, terms[0].settle_s * _FPS) if args.crops else ()
    results: list[ClipResult] = []
    panels: dict[str, dict[str, list[float]]] = {}
    failed = False
    found = list(
        clips(args.clip, width, height, _FPS, count, say, only=chosen, fetching=args.fetch)
    )
    for name, make in found:
        clip = make()
        for these in terms:
            measured = _measured(contenders, clip, these, shots, say)
            failed |= len(measured) < len(contenders)
            figures = {who: trial.figures for who, trial in measured.items()}
            rate = f"{these.cap_kbps:g} kbit/s through {these.channel_kbps:g}"
            console.print(_table(f"{name}, {rate}", figures))
            for who, result in figures.items():
                for note in _notes(who, result):
                    say(note)
            targets = WIDE if these.wide else NARROW if clip.tuned_on else STRANGE
            verdicts = judge(figures, targets, these.cap_kbps)
            if verdicts:
                console.print(_verdicts(f"{name}, {rate}: kontur-av against its targets", verdicts))
            if args.crops:
                kept = {who: trial.shots for who, trial in measured.items()}
                for path in write_crops(args.crops, clip, these.cap_kbps, kept):
                    say(f"wrote {path}")
            group = TUNED_ON if clip.tuned_on else OTHERS
            results.append(ClipResult(rate, name, group, measured, verdicts))
            # After every clip: a run is long, and may be ended early.
            write_result(args.report, _report(results), _headlines(results), digits=4)
            panels[f"{name}, {rate}: capture to displayed"] = {
                who: trial.latencies_ms for who, trial in measured.items()
            }
            if args.plot is not None:
                save(distributions(panels, axis="capture to displayed, ms"), args.plot)
    for title, rows, group_found in _groups(results):
        console.print(_group_table(title, rows))
        if group_found:
            console.print(_group_targets(f"{title}: kontur-av against its targets", group_found))
    return 1 if failed else 0


def _groups(
    results: Sequence[ClipResult],
) -> list[tuple[str, list[GroupRow], list[GroupVerdict]]]:
    """Title, figures and verdicts of each group at each rate."""
    found = []
    for rate in dict.fromkeys(of.rate for of in results):
        for group in (TUNED_ON, OTHERS):
            these = [of for of in results if (of.rate, of.group) == (rate, group)]
            rows = group_rows(
                [{who: trial.figures for who, trial in of.measured.items()} for of in these]
            )
            if rows:
                verdicts = group_verdicts({of.clip: of.verdicts for of in these})
                found.append((f"{group} ({len(these)}), {rate}", rows, verdicts))
    return found


def _report(results: Sequence[ClipResult]) -> dict[str, Json]:
    """By rate, clip and contender."""
    found: dict[str, dict[str, Json]] = {}
    for of in results:
        clip: dict[str, Json] = {"group": of.group, "targets": as_json(of.verdicts)}
        for who, trial in of.measured.items():
            row = as_json(trial.figures)
            assert isinstance(row, dict)
            clip[who] = row | {"latencies_ms": as_json(trial.latencies_ms)}
        found.setdefault(of.rate, {})[of.clip] = clip
    return {rate: as_json(clips) for rate, clips in found.items()}


def _headlines(results: Sequence[ClipResult]) -> list[Headline]:
    found = []
    for of in results:
        for who, trial in of.measured.items():
            figures = trial.figures
            for what, unit, value in (
                ("capture to displayed, p50", "ms", figures.latency_ms["p50"]),
                ("capture to displayed, p99", "ms", figures.latency_ms["p99"]),
                ("PSNR, mean", "dB", figures.psnr_db.mean),
                ("PSNR, worst 5 %", "dB", figures.psnr_db.worst),
                ("SSIM, mean", "", figures.ssim.mean),
                ("VMAF, mean", "", figures.vmaf.mean if figures.vmaf else None),
                ("VMAF, worst 5 %", "", figures.vmaf.worst if figures.vmaf else None),
                ("displayed", "pictures/s", figures.per_second),
                ("payload, mean", "kbit/s", figures.payload_bps / 1000),
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
    for title, rows, verdicts in _groups(results):
        found += group_headlines(title, rows, verdicts)
    return found


def _checked(args: argparse.Namespace) -> tuple[int, int, list[TrialTerms]]:
    width, height = parse_size(args.size)
    if not check_width(width):
        raise ConfigError(f"--size {args.size}: too narrow for the number drawn into each picture")
    if not 0 <= args.lead_s <= _LONGEST_LEAD_S:
        raise ConfigError(f"--lead-s {args.lead_s}: give 0 to {_LONGEST_LEAD_S}")
    most_s = NUMBERS // _FPS - 1 - max(args.lead_s, CHROMIUM_LEAD_S)
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
    stems = [path.stem for path in args.clip]
    for stem in stems:
        if stem in CLIPS or stems.count(stem) > 1:
            raise ConfigError(f"--clip {stem}: there is another clip of this name: rename the file")
    known = {*CONTENDERS, *CLIPS, *stems}
    for name in args.only:
        if name not in known:
            raise ConfigError(f"--only {name}: choose of {', '.join(sorted(known))}")
    check_writable(args.report)
    check_plot(args.plot)
    check_crops(args.crops)
    terms = []
    if not args.only_wide:
        terms += [
            TrialTerms(
                fps=_FPS,
                cap_kbps=args.cap_kbps,
                channel_kbps=args.channel_kbps,
                lead_s=args.lead_s,
            )
        ]
    if args.wide or args.only_wide:
        cap_kbps, channel_kbps = _WIDE_KBPS
        terms += [
            TrialTerms(
                fps=_FPS,
                cap_kbps=cap_kbps,
                channel_kbps=channel_kbps,
                lead_s=args.lead_s,
                wide=True,
            )
        ]
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
    contenders: Sequence[str],
    clip: Clip,
    terms: TrialTerms,
    shots: Sequence[int],
    say: Callable[[str], None],
) -> dict[str, Trial]:
    """The contenders that could be measured, in turn."""
    found = {}
    for name in contenders:
        try:
            found[name] = measure(name, clip, terms, shot_numbers=shots)
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
    ("VMAF, mean", lambda found: f"{found.vmaf.mean:.1f}" if found.vmaf else "–"),
    ("VMAF, worst 5 %", lambda found: f"{found.vmaf.worst:.1f}" if found.vmaf else "–"),
    ("displayed pictures a second", lambda found: f"{found.per_second:.1f}"),
    ("longest gap, ms", lambda found: f"{found.longest_gap_ms:.0f}"),
    ("payload, mean, kbit/s", lambda found: _kbps(found.payload_bps)),
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


def _group_table(title: str, rows: Sequence[GroupRow]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for name in rows[0].values:
        table.add_column(name, justify="right")
    for row in rows:
        heading = f"{row.what}, {row.unit}" if row.unit else row.what
        digits = 3 if row.what.startswith("SSIM") else 2
        table.add_row(
            heading,
            *(f"{value:.{digits}f}" if isfinite(value) else "–" for value in row.values.values()),
        )
    return table


def _group_targets(title: str, verdicts: Sequence[GroupVerdict]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("", "target", "mean of clips", "worst clip", "clips", ""):
        table.add_column(heading, justify="left" if not heading else "right")
    for verdict in verdicts:
        table.add_row(
            verdict.what,
            verdict.target,
            f"{verdict.mean:.2f}",
            f"{verdict.worst:.2f} ({verdict.clip})",
            f"{verdict.met_on} of {verdict.clips}",
            "met" if verdict.met else "[red]missed[/red]",
        )
    return table
