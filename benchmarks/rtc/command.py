"""`python -m benchmarks rtc`: the leg to a partner across the Internet.

Three parts, in turn: from the capture to the pixel of the partner's browser (Chromium on a virtual
screen, whose framebuffer another process reads); a partner's media until they are decoded, beside
plain aiortc; and live sessions whose leg to a partner is absent, idle, busy, full or cut.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from benchmarks.page.browser import lacking as browser_lacking
from benchmarks.page.footage import FPS, coded
from benchmarks.rtc.network import lacking as network_lacking
from benchmarks.rtc.pixel import SPARE_S, pixel_run
from benchmarks.rtc.reception import reception_run
from benchmarks.rtc.rtc_metrics import (
    IDLE,
    LEGS,
    NO_LEG,
    OURS,
    PEER,
    PixelRun,
    ReceptionRun,
    RtcResult,
    SessionRun,
    headlines,
)
from benchmarks.rtc.session import session_run
from kontur_av.errors import ConfigError
from pipelines.bench.course.marks import NUMBERS
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline

_PORT = 8390
_PARTS = ("pixel", "reception", "session")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks rtc`."""
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="of each (default 3)")
    parser.add_argument(
        "--seconds", type=float, default=15.0, metavar="S", help="of each run (default 15)"
    )
    parser.add_argument(
        "--only", choices=_PARTS, action="append", help="measure this part; may be repeated"
    )
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of sessions")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure all parts in turn; 1 if a session names a failure."""
    most_s = NUMBERS / FPS - SPARE_S
    if not 1 <= args.seconds <= most_s:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to {most_s:.0f}")
    if not 1 <= args.runs <= 100:
        raise ConfigError(f"--runs {args.runs}: give 1 to 100")
    check_writable(args.report)
    console = open_console(args)
    parts = args.only or _PARTS
    why = {"pixel": browser_lacking(), "session": network_lacking()}
    missing = [text for part, text in why.items() if part in parts and text]
    for text in missing:
        console.print(f"not measured: {text}", soft_wrap=True)
    with console.status("coding the pictures"):
        units = coded(round((args.seconds + SPARE_S) * FPS)) if parts != ["pixel"] else []
    pixels: list[PixelRun] = []
    receptions: list[ReceptionRun] = []
    sessions: list[SessionRun] = []
    for number in range(1, args.runs + 1):
        if "pixel" in parts and not why["pixel"]:
            with console.status(f"run {number}: capture to pixel"):
                pixels.append(pixel_run(args.seconds, _PORT))
        for who in (OURS, PEER) if "reception" in parts else ():
            with console.status(f"run {number}: reception by {who}"):
                receptions.append(reception_run(who, units, args.seconds))
        for leg in LEGS if "session" in parts else ():
            if why["session"] and leg not in (NO_LEG, IDLE):
                continue
            with console.status(f"run {number}: session, {leg}"):
                sessions.append(
                    session_run(
                        leg, units, seconds=args.seconds, base_port=args.base_port, port=_PORT
                    )
                )
    result = RtcResult(
        pixels=tuple(pixels),
        receptions=tuple(receptions),
        sessions=tuple(sessions),
        lacking="; ".join(missing),
    )
    lines = headlines(result)
    console.print(_table(lines, args.runs))
    write_result(args.report, result, lines, digits=6)
    failures = [f"{run.leg}: {one}" for run in sessions for one in run.failures]
    for failure in failures:
        console.print(f"failed: {failure}", soft_wrap=True)
    return 1 if failures else 0


def _table(lines: Sequence[Headline], runs: int) -> Table:
    table = Table(title=f"medians of {runs} runs", title_justify="left")
    for heading in ("", "what", "who"):
        table.add_column(heading)
    for heading in ("value", "unit"):
        table.add_column(heading, justify="right")
    for line in lines:
        value = "–" if line.value is None else f"{line.value:.3g}"
        table.add_row(line.group, line.what, line.who, value, line.unit)
    return table
