"""`kontur-av bench link`: what the link does to its traffic, and what it costs."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from kontur_av.clock import NS_PER_MS, NS_PER_US
from kontur_av.errors import ConfigError
from kontur_av.meters import Histogram
from pipelines.bench.console import open_console
from pipelines.bench.link.cost import slot_cost
from pipelines.bench.link.live import Punctuality, live_punctuality
from pipelines.bench.link.resume import resumptions
from pipelines.bench.link.virtual import (
    FILE,
    VIDEO,
    VOICE,
    goodput,
    haptic_difference,
    header_octets,
    voice_waits,
)
from pipelines.report.report_file import check_writable, write_report
from pipelines.setup.setup_file import load_setup
from telepresence.link.profile import DOWNLINK, UPLINK

#: What is saturated with what: voice and video of `spacejustin`, and files.
_PACKETS = ((VIDEO, 354), (VIDEO, 1000), (VOICE, 19), (FILE, 200), (FILE, 1000))
_DELAY_NS = 3 * NS_PER_MS
_BLACKOUTS_S = (0.1, 1.0, 10.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench link`."""
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each run (default 20)"
    )
    parser.add_argument(
        "--blackouts", type=int, default=100, metavar="N", help="of each length (default 100)"
    )
    parser.add_argument("--setup", default="spacejustin", metavar="NAME", help="of the live runs")
    parser.add_argument("--no-live", action="store_true", help="virtual time and cost only")
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of live runs")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure, and print each table as soon as it is known."""
    if not 1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 3600")
    if not 1 <= args.blackouts <= 10_000:
        raise ConfigError(f"--blackouts {args.blackouts}: give 1 to 10000")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    figures: dict[str, Any] = {}
    for name, table, values in _tables(args):
        console.print(table)
        figures[name] = values
    if args.report is not None:
        write_report(args.report, figures)
    return 0


def _tables(args: argparse.Namespace) -> Iterator[tuple[str, Table, Any]]:
    yield _delays(args.seconds)
    yield _headers(args.seconds)
    yield _goodputs(min(args.seconds, 5.0))
    yield _resumptions(args.blackouts)
    yield _costs(round(1000 * args.seconds))
    if not args.no_live:
        for media in (False, True):
            yield _punctuality(args, media=media)


def _delays(seconds: float) -> tuple[str, Table, Any]:
    table = _table("delays on virtual time", "", "count", "p50", "p99", "max", "unit")
    difference = haptic_difference(seconds, delay_ns=_DELAY_NS)
    table.add_row(
        "haptic sample, all other levels saturated less all off",
        str(difference.samples),
        *("", "", f"{difference.largest_slots:g}", "slots"),
    )
    figures: dict[str, Any] = {"haptic_difference": asdict(difference)}
    for profile in (UPLINK, DOWNLINK):
        waits = voice_waits(seconds, profile)
        summary = _percentiles(waits, NS_PER_MS)
        figures[f"voice_wait_{profile.name}_ms"] = summary
        table.add_row(
            f"{profile.name} voice until its first slot, video and files saturated",
            str(len(waits)),
            *(f"{summary[key]:.2f}" for key in ("p50", "p99", "max")),
            "ms",
        )
    return "delays", table, figures


def _headers(seconds: float) -> tuple[str, Table, Any]:
    table = _table(
        "octets that stand for 40 of IP, UDP and RTP, tag included",
        *("traffic", "packets", "mean", "most", "whole headers"),
    )
    figures = {}
    for traffic, counted in header_octets(seconds).items():
        figures[traffic] = asdict(counted)
        table.add_row(
            traffic,
            str(counted.packets),
            f"{counted.mean:.2f}",
            str(counted.most_compressed),
            str(counted.whole),
        )
    return "headers", table, figures


def _goodputs(seconds: float) -> tuple[str, Table, Any]:
    table = _table(
        "one kind of packet saturated; of the octets left to it",
        *("direction", "packets", "haptics", "left kbit/s", "payloads kbit/s"),
        *("packets %", "framing %", "supervision %", "idle %"),
    )
    figures = []
    for profile in (UPLINK, DOWNLINK):
        for flow, octets in _PACKETS:
            for haptics in (True, False):
                found = goodput(seconds, profile, flow=flow, payload_octets=octets, haptics=haptics)
                figures.append(
                    {"direction": profile.name, "flow": flow, "octets": octets, "haptics": haptics}
                    | asdict(found)
                )
                table.add_row(
                    profile.name,
                    f"{flow}, {octets}",
                    "yes" if haptics else "no",
                    f"{found.zone_bps / 1000:.1f}",
                    f"{found.payload_bps / 1000:.1f}",
                    *(f"{100 * share:.2f}" for share in found.shares()),
                )
    table.caption = (
        "left: all but frame headers, checks and samples; payloads: of UDP, so that RTP counts "
        "its 12 octets of header, of which 1 to 3 travel; packets: with their tags and headers; "
        "framing: M_PDU headers and the lengths of packets that end within a frame"
    )
    return "goodput", table, figures


def _resumptions(blackouts: int) -> tuple[str, Table, Any]:
    table = _table(
        f"{blackouts} blackouts of both directions each; ms from the first good frame on",
        *("blackout", "what came first", "count", "p50", "p99", "max"),
    )
    figures = {}
    for blackout_s in _BLACKOUTS_S:
        found = resumptions(blackout_s, blackouts=blackouts, delay_ns=_DELAY_NS)
        rows = {"loss noticed (from the last good frame)": found.noticed, **found.first}
        summaries = {name: _percentiles(values, NS_PER_MS) for name, values in rows.items()}
        figures[f"{blackout_s:g} s"] = {
            **summaries,
            "packets": found.packets,
            "stale": found.stale,
        }
        for name, summary in summaries.items():
            table.add_row(
                f"{blackout_s:g} s",
                name,
                str(len(rows[name])),
                *(f"{summary[key]:.1f}" for key in ("p50", "p99", "max")),
            )
        table.add_row(
            f"{blackout_s:g} s", f"packets over 100 ms old, of {found.packets}", str(found.stale)
        )
    return "resumption", table, figures


def _costs(slots: int) -> tuple[str, Table, Any]:
    table = _table(
        "cost of a slot on this machine, µs",
        *("direction", "traffic", "what", "p50", "p95", "p99", "max"),
    )
    figures = []
    for profile in (UPLINK, DOWNLINK):
        for busy in (False, True):
            cost = slot_cost(profile, slots=slots, busy=busy)
            for what, histogram in (("send", cost.send), ("receive", cost.receive)):
                summary = _summary_us(histogram)
                traffic = "saturated" if busy else "samples only"
                figures.append(
                    {"direction": profile.name, "traffic": traffic, "what": what, "us": summary}
                )
                table.add_row(
                    profile.name, traffic, what, *(f"{value:.1f}" for value in summary.values())
                )
    return "cost", table, figures


def _punctuality(args: argparse.Namespace, *, media: bool) -> tuple[str, Table, Any]:
    beside = f"the whole session of {args.setup} beside it" if media else "the link alone"
    found = live_punctuality(args.seconds, args.setup, media=media, base_port=args.base_port)
    table = _table(
        f"live, 1 kHz, {beside}; µs after the deadline",
        *("task", "p50", "p99", "p99.9", "max"),
        *("slips", "p99 / cyclictest's"),
    )
    peer = next((task for task in found if task.name == "cyclictest"), None)
    for task in found:
        ratio = ""
        if peer is not None and task is not peer and peer.lateness_us["p99"]:
            ratio = f"{task.lateness_us['p99'] / peer.lateness_us['p99']:.2f}"
        table.add_row(
            task.name,
            *(f"{task.lateness_us[key]:.0f}" for key in ("p50", "p99", "p99.9", "max")),
            "" if task.slips is None else f"{task.slips} of {task.cycles}",
            ratio,
        )
    if peer is None:
        table.caption = "cyclictest is not installed or not permitted (Debian package rt-tests)"
    return f"live_{'with' if media else 'without'}_media", table, _as_dicts(found)


def _as_dicts(tasks: Sequence[Punctuality]) -> list[dict[str, Any]]:
    return [asdict(task) for task in tasks]


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in _WORDS else "right")
    return table


_WORDS = {"", "traffic", "direction", "packets", "what", "what came first", "task", "unit"}


def _percentiles(values: Sequence[int], unit_ns: int) -> Mapping[str, float]:
    """Exact ones, by nearest rank."""
    ordered = sorted(values)
    if not ordered:
        return {"p50": 0.0, "p95": 0.0, "p99": 0.0, "max": 0.0}
    ranks = {
        name: -(-len(ordered) * p // 100) - 1 for name, p in (("p50", 50), ("p95", 95), ("p99", 99))
    }
    return {
        **{name: ordered[rank] / unit_ns for name, rank in ranks.items()},
        "max": ordered[-1] / unit_ns,
    }


def _summary_us(histogram: Histogram) -> dict[str, float]:
    return {
        **{f"p{p}": round(histogram.percentile(p) / NS_PER_US, 2) for p in (50, 95, 99)},
        "max": round(histogram.max / NS_PER_US, 2),
    }
