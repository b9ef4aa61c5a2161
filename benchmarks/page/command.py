"""`python -m benchmarks page`: the browser pages, from topic to pixel, and from the pointer back.

Chromium draws on a virtual screen (Xvfb) without a frame limit; a process of its own reads the
numbers of the pictures from the framebuffer. The peer is aiortc with a <video> and no playout
delay, in turn with the page. Live sessions run without pages, with nobody looking, with one reader
that draws nothing, and with the operator's page open on this machine.
"""

import argparse
from pathlib import Path

from rich.table import Table

from benchmarks.page.browser import lacking
from benchmarks.page.footage import FPS, coded
from benchmarks.page.heap import heap_run
from benchmarks.page.page_metrics import ALONE, LIVE, DelayRun, PageResult, headlines
from benchmarks.page.pointer import pointer_run
from benchmarks.page.session import PAGES, session_run
from benchmarks.page.views import CONTENDERS, measured
from benchmarks.page.voice import voice_run
from kontur_av.errors import ConfigError
from pipelines.bench.course.marks import NUMBERS
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, spread

#: For Chromium to start, beside the measured time.
_SPARE_S = 60
_MOST_OPEN_S = 86_400.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks page`."""
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="of each (default 3)")
    parser.add_argument(
        "--seconds", type=float, default=15.0, metavar="S", help="of each run (default 15)"
    )
    parser.add_argument(
        "--open-s", type=float, metavar="S", help="also keep each seat open for S seconds: its heap"
    )
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of sessions")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the delays as PNG")


def run(args: argparse.Namespace) -> int:
    """Measure all contenders in turn, then the pointer, then sessions with and without pages."""
    most_s = NUMBERS / FPS - _SPARE_S
    if not 1 <= args.seconds <= most_s:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to {most_s:.0f}")
    if not 1 <= args.runs <= 100:
        raise ConfigError(f"--runs {args.runs}: give 1 to 100")
    if args.open_s is not None and not 1 <= args.open_s <= _MOST_OPEN_S:
        raise ConfigError(f"--open-s {args.open_s:g}: give 1 to {_MOST_OPEN_S:g}")
    check_writable(args.report)
    check_plot(args.plot)
    console = open_console(args)
    missing = lacking()
    if missing:
        console.print(f"not measured: {missing}", soft_wrap=True)
        write_result(args.report, PageResult(), [])
        return 0
    with console.status("coding the pictures"):
        units = coded(round((args.seconds + _SPARE_S) * FPS))
    views, pointer, voice, sessions = [], [], [], []
    curves: dict[str, list[float]] = {}
    for number in range(1, args.runs + 1):
        for who, count in CONTENDERS:
            name = f"{who}, {count} view{'s' * (count > 1)}"
            with console.status(f"run {number}: {name}"):
                found, delays_ms = measured(who, count, units, args.seconds)
            views.append(found)
            curves.setdefault(name, []).extend(delays_ms)
        for where, shown in ((ALONE, units), (LIVE, None)):
            with console.status(f"run {number}: pointer, {where}"):
                moved = pointer_run(shown, seconds=args.seconds, base_port=args.base_port)
            pointer.append(DelayRun(where=where, delay_ms=spread(moved)))
        with console.status(f"run {number}: voice"):
            heard = voice_run(seconds=args.seconds, base_port=args.base_port)
        voice.append(DelayRun(where=LIVE, delay_ms=spread(heard)))
        for page in PAGES:
            with console.status(f"run {number}: session, page: {page}"):
                sessions.append(session_run(page, seconds=args.seconds, base_port=args.base_port))
    heaps = []
    for seat in ("space", "ground") if args.open_s is not None else ():
        with console.status(f"/{seat} stays open"):
            heaps.append(heap_run(seat, seconds=args.open_s, base_port=args.base_port))
    result = PageResult(
        views=tuple(views),
        sessions=tuple(sessions),
        pointer=tuple(pointer),
        voice=tuple(voice),
        heaps=tuple(heaps),
    )
    lines = headlines(result)
    console.print(_table(lines, args.runs))
    write_result(args.report, result, lines)
    if args.plot is not None:
        save(distributions({"topic to pixel, 640x480 at 30 Hz": curves}, axis="ms"), args.plot)
    return 0


def _table(lines: list[Headline], runs: int) -> Table:
    table = Table(title=f"medians of {runs} runs", title_justify="left")
    for heading in ("", "what", "who"):
        table.add_column(heading)
    for heading in ("value", "unit", "target", "met"):
        table.add_column(heading, justify="right")
    for line in lines:
        table.add_row(
            line.group,
            line.what,
            line.who,
            "–" if line.value is None else f"{line.value:.3g}",
            line.unit,
            line.target,
            "" if line.met is None else "yes" if line.met else "no",
        )
    return table
