"""`python -m benchmarks video`: pictures through a thin channel, beside GStreamer.

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

from benchmarks.video.clips import CLIPS, clips
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
from benchmarks.video.peers import CHROMIUM_LEAD_S, CONTENDERS
from benchmarks.video.targets import NARROW, STRANGE, WIDE
from benchmarks.video.vmaf import vmaf, vmaf_program
from kontur_av.errors import ConfigError
from pipelines.bench.video.clips import Clip
from pipelines.bench.video.command import FPS, Trial, TrialTerms, check_options, measure
from pipelines.bench.video.contenders import Contender, ContenderError
from pipelines.bench.video.quality import VideoVerdict, headlines, judge, notes
from pipelines.report.charts import distributions, save
from pipelines.report.report_file import open_console, write_result
from pipelines.report.result import Headline, Json, as_json, headline_tables

_WIDE_KBPS = (512.0, 530.0)
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
    """The options of `python -m benchmarks video`."""
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

    count = round((args.seconds + terms[0].settle_s) * FPS)
    names = set(args.only)
    contenders = _contenders(names & set(CONTENDERS), say)
    chosen = frozenset(names - set(CONTENDERS))
    if vmaf_program() is None:
        say("VMAF: left out; pip install imageio-ffmpeg brings an FFmpeg that has libvmaf")
    shots = shot_numbers(count, terms[0].settle_s * FPS) if args.crops else ()
    results: list[ClipResult] = []
    panels: dict[str, dict[str, list[float]]] = {}
    failed = False
    found = list(clips(args.clip, width, height, FPS, count, say, only=chosen, fetching=args.fetch))
    for name, make in found:
        clip = make()
        for these in terms:
            measured = _measured(contenders, clip, these, shots, say)
            failed |= len(measured) < len(contenders)
            metrics = {who: trial.metrics for who, trial in measured.items()}
            rate = f"{these.cap_kbps:g} kbit/s through {these.channel_kbps:g}"
            for who, result in metrics.items():
                for note in notes(who, result):
                    say(note)
            targets = WIDE if these.wide else NARROW if clip.tuned_on else STRANGE
            verdicts = judge(metrics, targets, these.cap_kbps)
            console.print(*headline_tables(headlines(f"{name}, {rate}", metrics, verdicts)))
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
                [{who: trial.metrics for who, trial in of.measured.items()} for of in these]
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
            row = as_json(trial.metrics)
            assert isinstance(row, dict)
            clip[who] = row | {"latencies_ms": as_json(trial.latencies_ms)}
        found.setdefault(of.rate, {})[of.clip] = clip
    return {rate: as_json(clips) for rate, clips in found.items()}


def _headlines(results: Sequence[ClipResult]) -> list[Headline]:
    found: list[Headline] = []
    for of in results:
        metrics = {who: trial.metrics for who, trial in of.measured.items()}
        found += headlines(f"{of.clip}, {of.rate}", metrics, of.verdicts)
    for title, rows, verdicts in _groups(results):
        found += group_headlines(title, rows, verdicts)
    return found


def _checked(args: argparse.Namespace) -> tuple[int, int, list[TrialTerms]]:
    if not 0 <= args.lead_s <= _LONGEST_LEAD_S:
        raise ConfigError(f"--lead-s {args.lead_s}: give 0 to {_LONGEST_LEAD_S}")
    size = check_options(args, lead_s=max(args.lead_s, CHROMIUM_LEAD_S), taken=CLIPS)
    stems = [path.stem for path in args.clip]
    known = {*CONTENDERS, *CLIPS, *stems}
    for name in args.only:
        if name not in known:
            raise ConfigError(f"--only {name}: choose of {', '.join(sorted(known))}")
    check_crops(args.crops)
    terms = []
    if not args.only_wide:
        terms += [
            TrialTerms(
                fps=FPS,
                cap_kbps=args.cap_kbps,
                channel_kbps=args.channel_kbps,
                lead_s=args.lead_s,
            )
        ]
    if args.wide or args.only_wide:
        cap_kbps, channel_kbps = _WIDE_KBPS
        terms += [
            TrialTerms(
                fps=FPS,
                cap_kbps=cap_kbps,
                channel_kbps=channel_kbps,
                lead_s=args.lead_s,
                wide=True,
            )
        ]
    return *size, terms


def _contenders(chosen: set[str], say: Callable[[str], None]) -> list[Contender]:
    here = []
    for name, contender in CONTENDERS.items():
        if chosen and name not in chosen:
            continue
        reason = contender.missing()
        if reason is None:
            here.append(contender)
        else:
            say(f"{name}: skipped; {reason}")
    return here


def _measured(
    contenders: Sequence[Contender],
    clip: Clip,
    terms: TrialTerms,
    shots: Sequence[int],
    say: Callable[[str], None],
) -> dict[str, Trial]:
    """The contenders that could be measured, in turn."""
    found = {}
    for contender in contenders:
        name = contender.name
        try:
            found[name] = measure(contender, clip, terms, shot_numbers=shots, score=vmaf)
        except ContenderError as error:
            say(f"{name} on {clip.name}: {error}")
    return found


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
