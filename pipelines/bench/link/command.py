"""`kontur-av bench link`: delays, header sizes, goodput, recovery, punctuality and CPU cost."""

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from pipelines.bench.link.live import Cost, LoopPunctuality, live_punctuality, slot_costs
from pipelines.bench.link.paired import WAYS, headlines
from pipelines.bench.link.protected import paired_run
from pipelines.bench.link.resume import Resumptions, resumptions
from pipelines.bench.link.virtual import (
    FILE,
    VIDEO,
    VOICE,
    Goodput,
    HapticDifference,
    HeaderOctets,
    goodput,
    haptic_difference,
    header_octets,
    voice_waits,
)
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, Percentiles, as_json, spread, titled_table
from pipelines.session.setup.setup_file import load_setup
from telepresence.link.profile import DOWNLINK, UPLINK

#: Kinds of packets that saturate the link, and the octets of their payloads: voice and video of
#: `spacejustin`, and files.
_PACKETS = ((VIDEO, 354), (VIDEO, 1000), (VOICE, 19), (FILE, 200), (FILE, 1000))
_DELAY_NS = 3 * NS_PER_MS
#: Headings of columns with words.
_WORDS = {"", "traffic", "direction", "packets", "what", "first event", "task", "unit"}
_table = partial(titled_table, left=_WORDS)
_BLACKOUTS_S = (0.1, 1.0, 10.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each run (default 20)"
    )
    parser.add_argument(
        "--blackouts", type=int, default=100, metavar="N", help="of each length (default 100)"
    )
    parser.add_argument("--setup", default="spacejustin", metavar="NAME", help="of the live runs")
    parser.add_argument("--no-live", action="store_true", help="virtual time and cost only")
    parser.add_argument(
        "--protected",
        action="store_true",
        help="instead, live only: two ends over loopback in turns, --insecure, protected, and "
        "protected with new keys every 2 s",
    )
    parser.add_argument(
        "--runs", type=int, default=3, metavar="N", help="with --protected: of each (default 3)"
    )
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of live runs")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    if not 1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 3600")
    if not 1 <= args.blackouts <= 10_000:
        raise ConfigError(f"--blackouts {args.blackouts}: give 1 to 10000")
    if not 1 <= args.runs <= 1000:
        raise ConfigError(f"--runs {args.runs}: give 1 to 1000")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    if args.protected:
        return _run_protected(args, console)
    difference = haptic_difference(args.seconds, delay_ns=_DELAY_NS)
    #: Of a voice packet until its first slot, by direction.
    waits_ms = {
        profile.name: spread(voice_waits(args.seconds, profile), per_unit=NS_PER_MS)
        for profile in (UPLINK, DOWNLINK)
    }
    console.print(_delay_table(difference, waits_ms, args.seconds))
    headers = header_octets(args.seconds)
    console.print(_header_table(headers))
    goodputs = _measure_goodputs(min(args.seconds, 5.0))
    console.print(_goodput_table(goodputs))
    resumed = {
        f"{length_s:g} s": resumptions(length_s, blackouts=args.blackouts, delay_ns=_DELAY_NS)
        for length_s in _BLACKOUTS_S
    }
    console.print(_resumption_table(resumed, args.blackouts))
    costs = [
        cost
        for profile in (UPLINK, DOWNLINK)
        for busy in (False, True)
        for cost in slot_costs(profile, slots=round(1000 * args.seconds), busy=busy)
    ]
    console.print(_cost_table(costs))
    figures: dict[str, Json] = {
        "delays": {
            "haptic_difference": as_json(difference),
            **{f"voice_wait_{name}_ms": as_json(of) for name, of in waits_ms.items()},
        },
        "headers": as_json(headers),
        "goodput": as_json(goodputs),
        "resumption": {
            length: as_json({**of.times_ms, "packets": of.packets, "stale": of.stale})
            for length, of in resumed.items()
        },
        "cost": as_json(costs),
    }
    live: dict[str, Sequence[LoopPunctuality]] = {}
    for media in () if args.no_live else (False, True):
        name = "with" if media else "without"
        live[name] = live_punctuality(
            args.seconds, args.setup, media=media, base_port=args.base_port
        )
        console.print(_punctuality_table(live[name], args.setup, media=media))
        figures[f"live_{name}_media"] = as_json(live[name])
    found = _headlines(difference, waits_ms, headers, resumed, costs, live)
    write_result(args.report, figures, found)
    return 0


def _run_protected(args: argparse.Namespace, console: Console) -> int:
    """Run the ways in turn, so that a change of the machine's load falls on all."""
    runs = []
    for number in range(1, args.runs + 1):
        for way in WAYS:
            run = paired_run(way, setup=args.setup, seconds=args.seconds, base_port=args.base_port)
            runs.append(run)
            cpu = ", ".join(f"{end} {one.cpu_percent:.1f} %" for end, one in run.ends.items())
            late = ", ".join(
                f"{name} {of['p99']:.0f} µs" for name, of in run.delay_us.items() if of
            )
            console.print(
                f"run {number}, {way}: p99 {late}; CPU {cpu}; {run.frames_lost} frames lost",
                highlight=False,
            )
    found = headlines(runs)
    table = _table(f"{args.runs} runs of {args.seconds:g} s each", "what", *WAYS)
    for what in dict.fromkeys(line.what for line in found if line.who):
        cells = {line.who: line for line in found if line.what == what}
        table.add_row(what, *(_cell(cells[way]) for way in WAYS))
    console.print(table)
    for line in found:
        if not line.who:
            console.print(f"{line.what}: {_cell(line)}{_verdict(line)}", highlight=False)
    write_result(args.report, {"runs": as_json(runs)}, found)
    return 0


def _verdict(line: Headline) -> str:
    if line.met is None:
        return ""
    return f"; {line.target} {line.unit}: {'met' if line.met else 'missed'}"


def _cell(line: Headline) -> str:
    return "–" if line.value is None else f"{line.value:.1f} {line.unit}".strip()


def _headlines(
    difference: HapticDifference,
    waits_ms: Mapping[str, Percentiles],
    headers: Mapping[str, HeaderOctets],
    resumed: Mapping[str, Resumptions],
    costs: Sequence[Cost],
    live: Mapping[str, Sequence[LoopPunctuality]],
) -> list[Headline]:
    virtual = partial(Headline, group="on virtual time")
    what = "delay that saturated media add to a haptic sample, largest"
    found = [virtual(what=what, unit="slots", value=difference.largest_slots)]
    for name, of in waits_ms.items():
        what = f"voice until its first slot, {name} saturated, max"
        found.append(virtual(what=what, unit="ms", value=of.max))
    for traffic, counted in headers.items():
        what = f"header octets of {traffic} (of 40), mean"
        found.append(virtual(what=what, unit="octets", value=counted.mean))
    group = "from the first good frame after a blackout, p99"
    for length, recovery in resumed.items():
        for event, of in recovery.times_ms.items():
            who = f"of {length}"
            found.append(Headline(group=group, what=event, who=who, unit="ms", value=of.p99))
    for cost in costs:
        what, group = f"{cost.direction}, {cost.traffic}", "cost of a slot, p50"
        found.append(Headline(group=group, what=what, who=cost.what, unit="µs", value=cost.us.p50))
    for name, tasks in live.items():
        for task in tasks:
            who, late_us = f"{name} media", task.lateness_us["p99"]
            what = f"{task.name}: after the deadline, p99"
            found.append(Headline(group="live", what=what, who=who, unit="µs", value=late_us))
            if task.slips is not None and task.cycles:
                what, share = f"{task.name}: slots left out", 100 * task.slips / task.cycles
                found.append(Headline(group="live", what=what, who=who, unit="%", value=share))
    return found


def _delay_table(
    difference: HapticDifference, waits_ms: Mapping[str, Percentiles], seconds: float
) -> Table:
    table = _table(f"delays on virtual time, {seconds:g} s", "", "p50", "p99", "max", "unit")
    table.add_row(
        f"haptic sample: saturated link less idle link, {difference.samples} samples",
        *("", "", f"{difference.largest_slots:g}", "slots"),
    )
    for name, waits in waits_ms.items():
        table.add_row(
            f"{name} voice until its first slot, video and files saturated",
            *(f"{value:.2f}" for value in (waits.p50, waits.p99, waits.max)),
            "ms",
        )
    return table


def _header_table(headers: Mapping[str, HeaderOctets]) -> Table:
    table = _table(
        "octets that replace the 40 of IP, UDP and RTP, tag included",
        *("traffic", "packets", "mean", "most", "whole headers"),
    )
    for traffic, counted in headers.items():
        table.add_row(
            traffic,
            str(counted.packets),
            f"{counted.mean:.2f}",
            str(counted.most_compressed),
            str(counted.whole),
        )
    return table


def _measure_goodputs(seconds: float) -> list[Goodput]:
    return [
        goodput(seconds, profile, flow=flow, payload_octets=octets, haptics=haptics)
        for profile in (UPLINK, DOWNLINK)
        for flow, octets in _PACKETS
        for haptics in (True, False)
    ]


def _goodput_table(goodputs: Sequence[Goodput]) -> Table:
    table = _table(
        "one kind of packet saturates the link; shares of the octets left to it",
        *("direction", "packets", "haptics", "left kbit/s", "payloads kbit/s"),
        *("packets %", "framing %", "supervision %", "idle %"),
    )
    for of in goodputs:
        table.add_row(
            of.direction,
            f"{of.flow}, {of.octets}",
            "yes" if of.haptics else "no",
            f"{of.zone_bps / 1000:.1f}",
            f"{of.payload_bps / 1000:.1f}",
            *(f"{100 * share:.2f}" for share in of.shares()),
        )
    table.caption = (
        "left: all but frame headers, checks and samples; payloads: of UDP, so RTP counts "
        "its 12 octets of header, of which 1 to 3 travel; packets: with their tags and headers; "
        "framing: M_PDU headers and the lengths of packets that end within a frame"
    )
    return table


def _resumption_table(found: Mapping[str, Resumptions], blackouts: int) -> Table:
    table = _table(
        f"{blackouts} blackouts of both directions each; ms from the first good frame",
        *("blackout", "first event", "count", "p50", "p99", "max"),
    )
    for length, of in found.items():
        counts = (len(of.noticed), *map(len, of.first.values()))
        for count, (name, times) in zip(counts, of.times_ms.items(), strict=True):
            values = (f"{value:.1f}" for value in (times.p50, times.p99, times.max))
            table.add_row(length, name, str(count), *values)
        table.add_row(length, f"packets over 100 ms old, of {of.packets}", str(of.stale))
    return table


def _cost_table(costs: Sequence[Cost]) -> Table:
    table = _table(
        "cost of a slot on this machine, µs",
        *("direction", "traffic", "what", "p50", "p95", "p99", "max"),
    )
    for cost in costs:
        times = (cost.us.p50, cost.us.p95, cost.us.p99, cost.us.max)
        cells = (f"{value:.1f}" for value in times)
        table.add_row(cost.direction, cost.traffic, cost.what, *cells)
    return table


def _punctuality_table(found: Sequence[LoopPunctuality], setup: str, *, media: bool) -> Table:
    beside = f"the whole session of {setup} beside it" if media else "the link alone"
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
    return table
