"""`kontur-av bench fanout`: one picture for many processes, what it costs and how soon it is there.

Each way is measured with 1, 4, 8 and 16 readers in turn, all of them processes: 640x480 pictures
(I420, 460800 octets) 30 times a second, and then as fast as the publisher can. The ways are this
project's topics, with a picture that is copied into shared memory and with one that is drawn
there; GStreamer's shmsink and shmsrc; and a multiprocessing.Queue for each reader.
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.table import Table

from kontur_av.clock import NS_PER_MS, NS_PER_US
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import MAX_READERS
from pipelines.bench.charts import check_plot, distributions, save
from pipelines.bench.console import open_console
from pipelines.bench.fanout.gstreamer import ShmSinkWay, lacking
from pipelines.bench.fanout.run import PICTURES_HZ, FanOut, fan_out
from pipelines.bench.fanout.ways import HEIGHT, WIDTH, QueueWay, TopicWay, Way
from pipelines.report.report_file import check_writable, write_report

_READERS = (1, 4, 8, 16)
#: As fast as possible: long enough for thousands of pictures.
_FAST_S = 1.0


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
    if args.report is not None:
        write_report(args.report, {"runs": figures, "skipped": missing})
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


def _tables(figures: Sequence[dict[str, Any]]) -> Iterator[Table]:
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
        name = one["way"], str(one["readers"])
        paced.add_row(
            *name,
            *(_joined(one[key]) for key in ("publish_us", "publish_cpu_us", "delivery_us")),
            str(one["missed"]),
            *(f"{one[key]:.2f}" for key in ("publisher_cpu_s", "readers_cpu_s")),
        )
        fast.add_row(
            *name,
            _joined(one["fast_publish_us"]),
            f"{one['fast_cpu_us']:.0f}",
            f"{one['fast_hz']:.0f}",
        )
    yield paced
    yield fast


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("way", no_wrap=True)
    for heading in ("readers", *headings):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _joined(summary: dict[str, float]) -> str:
    return "/".join(f"{value:.0f}" for value in summary.values())


def _figures(one: FanOut) -> dict[str, Any]:
    """One run, in microseconds and seconds."""
    return {
        "way": one.way,
        "readers": one.readers,
        "publish_us": _summary_us(one.publish_ns),
        "publish_cpu_us": _summary_us(one.publish_cpu_ns),
        "delivery_us": _summary_us(one.delivery_ns),
        "missed": one.missed,
        "torn": one.torn,
        "publisher_cpu_s": one.publisher_cpu_s,
        "readers_cpu_s": one.readers_cpu_s,
        "fast_publish_us": _summary_us(one.fast_publish_ns),
        "fast_cpu_us": 1e6 * one.fast_cpu_s / len(one.fast_publish_ns),
        "fast_hz": len(one.fast_publish_ns) / one.fast_s,
    }


def _summary_us(values_ns: Sequence[int]) -> dict[str, float]:
    """Exact percentiles, by nearest rank; zeros where there is nothing."""
    ordered = sorted(values_ns) or [0]
    ranks = {f"p{p}": -(-len(ordered) * p // 100) - 1 for p in (50, 99)}
    return {
        **{name: ordered[rank] / NS_PER_US for name, rank in ranks.items()},
        "max": ordered[-1] / NS_PER_US,
    }
