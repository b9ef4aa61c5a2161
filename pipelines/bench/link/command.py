"""`kontur-av bench link`: punctuality and CPU cost of the link on this machine."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.bench.link.live import Cost, LoopPunctuality, live_punctuality, slot_costs
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json, headline_tables
from pipelines.session.setup.setup_file import load_setup
from telepresence.link.profile import DOWNLINK, UPLINK


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each run (default 20)"
    )
    parser.add_argument("--setup", default="spacejustin", metavar="NAME", help="of the live runs")
    parser.add_argument("--no-live", action="store_true", help="the cost of a slot only")
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of live runs")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    if not 1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 3600")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    costs = [
        cost
        for profile in (UPLINK, DOWNLINK)
        for busy in (False, True)
        for cost in slot_costs(profile, slots=round(1000 * args.seconds), busy=busy)
    ]
    figures: dict[str, Json] = {"cost": as_json(costs)}
    live: dict[str, Sequence[LoopPunctuality]] = {}
    for media in () if args.no_live else (False, True):
        name = "with" if media else "without"
        live[name] = live_punctuality(
            args.seconds, args.setup, media=media, base_port=args.base_port
        )
        figures[f"live_{name}_media"] = as_json(live[name])
    found = _headlines(costs, live)
    console.print(*headline_tables(found))
    if live and not any(task.name == "cyclictest" for tasks in live.values() for task in tasks):
        console.print("cyclictest is not installed or not permitted (Debian package rt-tests)")
    write_result(args.report, figures, found)
    return 0


def _headlines(
    costs: Sequence[Cost], live: Mapping[str, Sequence[LoopPunctuality]]
) -> list[Headline]:
    found = []
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
