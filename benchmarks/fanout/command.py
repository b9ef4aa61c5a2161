"""`kontur-av bench fanout`: one picture to many processes, its cost and its delay.

Each way carries 640x480 pictures (I420, 460800 octets) to 1, 4, 8 and 16 reading processes in turn.
The publisher sends 30 pictures a second, and then as many as it can. The ways are: this project's
topics, with a picture that is copied into shared memory and with one that is drawn there;
GStreamer's shmsink and shmsrc; and one `multiprocessing.Queue` for each reader.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import isnan
from operator import attrgetter
from pathlib import Path

from rich.table import Table

from benchmarks.fanout.gstreamer import ShmSinkWay, lacking
from benchmarks.fanout.run import PICTURES_HZ, FanOut, fan_out
from benchmarks.fanout.ways import HEIGHT, WIDTH, QueueWay, TopicWay, Way
from kontur_av.clock import NS_PER_MS, NS_PER_US
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import MAX_READERS
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.console import open_console
from pipelines.report.report_file import check_writable
from pipelines.report.result import Headline, Percentiles, spread
from pipelines.report.result_file import write_result

_READERS = (1, 4, 8, 16)
#: As fast as possible: long enough for thousands of pictures.
_FAST_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FanOutRow:
    """One way with one number of readers; see `FanOut`. fast_*: as fast as possible."""

    way: str
    readers: int
    publish_us: Percentiles
    publish_cpu_us: Percentiles
    delivery_us: Percentiles
    missed: int
    torn: int
    publisher_cpu_s: float
    readers_cpu_s: float
    fast_publish_us: Percentiles
    fast_cpu_us: float
    fast_hz: float


@dataclass(frozen=True, slots=True)
class FanOutResult:
    """skipped: why GStreamer was not measured; None if it was."""

    runs: Sequence[FanOutRow]
    skipped: str | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench fanout`."""
    parser.add_argument(
        "--seconds", type=float, default=10.0, metavar="S", help="of each run (default 10)"
    )
    parser.add_argument(
        "--readers", default=",".join(map(str, _READERS)), metavar="N,N", help="how many at once"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw both times as PNG")


def run(args: argparse.Namespace) -> int:
    """Measure all ways with one number of readers after the other, and print two tables."""
    if not 0.1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 0.1 to 3600")
    readers = _parse_readers(args.readers)
    check_writable(args.report)
    check_plot(args.plot)
    ways: list[Way] = [TopicWay(in_place=False), TopicWay(in_place=True)]
    missing = lacking()
    if missing is None:
        ways.append(ShmSinkWay())
    ways.append(QueueWay())
    console = open_console(args)
    fast_s = min(_FAST_S, args.seconds)
    found = []
    for way, number in product(ways, readers):
        with console.status(f"{way.name}, {number} readers"):
            found.append(fan_out(way, number, seconds=args.seconds, fast_s=fast_s))
    figures = [_figures(one) for one in found]
    for table in _tables(figures):
        console.print(table)
    if missing is not None:
        console.print(f"not measured: {missing}", soft_wrap=True)
    write_result(args.report, FanOutResult(figures, missing), _headlines(figures))
    if args.plot is not None:
        panels = _panels(found, readers)
        save(distributions(panels, axis="ms", columns=2, logarithmic=True), args.plot)
    return 0


def _parse_readers(text: str) -> list[int]:
    parts = text.split(",")
    if not all(part.isdecimal() and 1 <= int(part) <= MAX_READERS for part in parts):
        raise ConfigError(f"--readers {text}: give numbers from 1 to {MAX_READERS}, like 1,4,16")
    return [int(part) for part in parts]


def _panels(
    found: Sequence[FanOut], readers: Sequence[int]
) -> dict[str, dict[str, Sequence[float]]]:
    """For each number of readers both times, one curve a way."""
    return {
        f"{what}, readers: {number}": {
            one.way: [value / NS_PER_MS for value in values_ns(one)]
            for one in found
            if one.readers == number
        }
        for what, values_ns in (
            ("time to publish", attrgetter("publish_ns")),
            ("until a reader has it", attrgetter("delivery_ns")),
        )
        for number in readers
    }


def _headlines(figures: Sequence[FanOutRow]) -> list[Headline]:
    found = []
    for row in figures:
        group = f"readers: {row.readers}"
        for what, unit, value in (
            ("time to publish, p50", "µs", row.publish_us.p50),
            ("until a reader has the picture, p50", "µs", row.delivery_us.p50),
            ("until a reader has the picture, p99", "µs", row.delivery_us.p99),
            ("as fast as possible", "pictures/s", row.fast_hz),
        ):
            found.append(Headline(group=group, what=what, who=row.way, unit=unit, value=value))
    return found


def _tables(figures: Sequence[FanOutRow]) -> Iterator[Table]:
    paced = _table(
        f"{WIDTH}x{HEIGHT} pictures, {PICTURES_HZ} a second; µs: p50/p99/max",
        *("time to\npublish", "of it\nCPU", "until a\nreader has it", "missed"),
        *("CPU s\npublisher", "CPU s\nreaders"),
    )
    fast = _table(
        "as fast as the publisher can; µs: p50/p99/max",
        *("time to publish", "CPU a picture", "pictures a second"),
    )
    for one in figures:
        name = one.way, str(one.readers)
        paced.add_row(
            *name,
            *(_joined(of) for of in (one.publish_us, one.publish_cpu_us, one.delivery_us)),
            str(one.missed),
            *(f"{cpu_s:.2f}" for cpu_s in (one.publisher_cpu_s, one.readers_cpu_s)),
        )
        fast.add_row(
            *name,
            _joined(one.fast_publish_us),
            f"{one.fast_cpu_us:.0f}",
            f"{one.fast_hz:.0f}",
        )
    yield paced
    yield fast


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("way", no_wrap=True)
    for heading in ("readers", *headings):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _joined(of: Percentiles) -> str:
    return "/".join("–" if isnan(value) else f"{value:.0f}" for value in (of.p50, of.p99, of.max))


def _figures(one: FanOut) -> FanOutRow:
    """One run, in microseconds and seconds."""
    return FanOutRow(
        way=one.way,
        readers=one.readers,
        publish_us=spread(one.publish_ns, per_unit=NS_PER_US),
        publish_cpu_us=spread(one.publish_cpu_ns, per_unit=NS_PER_US),
        delivery_us=spread(one.delivery_ns, per_unit=NS_PER_US),
        missed=one.missed,
        torn=one.torn,
        publisher_cpu_s=one.publisher_cpu_s,
        readers_cpu_s=one.readers_cpu_s,
        fast_publish_us=spread(one.fast_publish_ns, per_unit=NS_PER_US),
        fast_cpu_us=1e6 * one.fast_cpu_s / len(one.fast_publish_ns),
        fast_hz=len(one.fast_publish_ns) / one.fast_s,
    )
