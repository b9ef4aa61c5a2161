"""`kontur-av bench link`: delays, header sizes, goodput, recovery, punctuality and CPU cost."""

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from pipelines.bench.link.live import Cost, LoopPunctuality, live_punctuality, slot_costs
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
from pipelines.report.result import (
    Headline,
    Json,
    Percentiles,
    as_json,
    headline_tables,
    spread,
)
from pipelines.session.setup.setup_file import load_setup
from telepresence.link.profile import DOWNLINK, UPLINK

#: Kinds of packets that saturate the link, and the octets of their payloads: voice and video of
#: `spacejustin`, and files.
_PACKETS = ((VIDEO, 354), (VIDEO, 1000), (VOICE, 19), (FILE, 200), (FILE, 1000))
_DELAY_NS = 3 * NS_PER_MS
#: With their tags and headers; the rest is framing, supervision and fill.
GOODPUT = "one kind of packet saturates the link: its share of the octets left to it"
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
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of live runs")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    if not 1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 3600")
    if not 1 <= args.blackouts <= 10_000:
        raise ConfigError(f"--blackouts {args.blackouts}: give 1 to 10000")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    difference = haptic_difference(args.seconds, delay_ns=_DELAY_NS)
    #: Of a voice packet until its first slot, by direction.
    waits_ms = {
        profile.name: spread(voice_waits(args.seconds, profile), per_unit=NS_PER_MS)
        for profile in (UPLINK, DOWNLINK)
    }
    headers = header_octets(args.seconds)
    goodputs = _measure_goodputs(min(args.seconds, 5.0))
    resumed = {
        f"{length_s:g} s": resumptions(length_s, blackouts=args.blackouts, delay_ns=_DELAY_NS)
        for length_s in _BLACKOUTS_S
    }
    costs = [
        cost
        for profile in (UPLINK, DOWNLINK)
        for busy in (False, True)
        for cost in slot_costs(profile, slots=round(1000 * args.seconds), busy=busy)
    ]
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
        figures[f"live_{name}_media"] = as_json(live[name])
    found = _headlines(difference, waits_ms, headers, goodputs, resumed, costs, live)
    console.print(*headline_tables(found))
    if live and not any(task.name == "cyclictest" for tasks in live.values() for task in tasks):
        console.print("cyclictest is not installed or not permitted (Debian package rt-tests)")
    write_result(args.report, figures, found)
    return 0


def _headlines(
    difference: HapticDifference,
    waits_ms: Mapping[str, Percentiles],
    headers: Mapping[str, HeaderOctets],
    goodputs: Sequence[Goodput],
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
    found += [
        Headline(
            group=GOODPUT,
            what=f"{of.direction}, {of.flow} of {of.octets} octets",
            who="with samples" if of.haptics else "without",
            unit="%",
            value=100 * of.packets,
        )
        for of in goodputs
    ]
    group = "from the first good frame after a blackout, p99"
    for length, recovery in resumed.items():
        for event, of in recovery.times_ms.items():
            who = f"of {length}"
            found.append(Headline(group=group, what=event, who=who, unit="ms", value=of.p99))
        what, who = f"packets over 100 ms old, of {recovery.packets}", f"of {length}"
        found.append(Headline(group=group, what=what, who=who, unit="", value=recovery.stale))
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


def _measure_goodputs(seconds: float) -> list[Goodput]:
    return [
        goodput(seconds, profile, flow=flow, payload_octets=octets, haptics=haptics)
        for profile in (UPLINK, DOWNLINK)
        for flow, octets in _PACKETS
        for haptics in (True, False)
    ]
