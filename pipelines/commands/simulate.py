"""`kontur-av simulate`: a session on virtual time, as fast as the machine goes."""

import argparse
import gc
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.commands.common import output_that_may_fail, stopped_by_signals
from pipelines.commands.session_options import (
    add_deadband_argument,
    add_hand_argument,
    add_radio_arguments,
    add_setup_argument,
    deadband_changes,
    hand_changes,
    radio_changes,
)
from pipelines.commands.stream import check_sources, parse_sources
from pipelines.report.model import SessionReport
from pipelines.report.report_file import check_writable, write_report
from pipelines.report.summary import print_summary
from pipelines.setup.setup_file import load_setup
from pipelines.setup.table import Setup
from pipelines.simulation.costs import CodingCosts
from pipelines.simulation.inputs import check_sources as check_virtual_sources
from pipelines.simulation.session import Selection, Simulation
from pipelines.simulation.workers import Workers

#: The virtual time between two checks whether to stop.
_STRIDE_NS = 50 * NS_PER_MS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av simulate`."""
    add_setup_argument(parser)
    parser.add_argument("--seconds", type=float, required=True, metavar="S", help="of virtual time")
    add_radio_arguments(parser)
    add_deadband_argument(parser)
    add_hand_argument(parser)
    parser.add_argument(
        "--source",
        action="append",
        default=[],
        metavar="NAME=SPEC",
        help="what an input captures: scene:NAME, a media file or mcap:FILE#CHANNEL; may be given "
        "several times",
    )
    parser.add_argument(
        "--select",
        action="append",
        default=[],
        metavar="T=CAMERA",
        help="the operator selects CAMERA at second T; may be given several times",
    )
    parser.add_argument(
        "--no-media", action="store_true", help="haptics and telecommands alone: much faster"
    )
    for cost in fields(CodingCosts):
        what = cost.name.removesuffix("_ms").replace("_", " ")
        parser.add_argument(
            _option(cost.name),
            type=float,
            default=cost.default,
            metavar="MS",
            help=f"what it takes on virtual time to {what} ({cost.default} ms)",
        )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    parser.add_argument("-q", "--quiet", action="store_true", help="show nothing but mistakes")


def run(args: argparse.Namespace) -> int:
    """Run the simulation; 1 if its report names a failure.

    Ctrl-C and SIGTERM end it early; the report then covers the time until then.
    """
    if not 0 < args.seconds < 1e6:
        raise ConfigError(f"--seconds {args.seconds:g}: give a number above 0 and below 1000000")
    changes = {**radio_changes(args), **deadband_changes(args), **hand_changes(args)}
    setup = load_setup(
        args.setup,
        sources=parse_sources(args.source),
        changes=changes,
        radio_start_s=args.radio_start,
    )
    check_virtual_sources(setup)
    check_sources(setup)
    check_writable(args.report)
    selections = parse_selections(args.select, setup, args.seconds)
    costs = CodingCosts(**{cost.name: getattr(args, cost.name) for cost in fields(CodingCosts)})
    with stopped_by_signals() as stopped:
        report = simulate(
            setup,
            seconds=args.seconds,
            seed=args.seed,
            media=not args.no_media,
            selections=selections,
            costs=costs,
            stopped=stopped,
        )
    if args.report is not None:
        write_report(args.report, report)
    if not args.quiet:
        with output_that_may_fail():
            print_summary(report)
    return 1 if report.failures else 0


def simulate(
    setup: Setup,
    *,
    seconds: float,
    seed: int,
    media: bool = True,
    selections: Sequence[Selection] = (),
    costs: CodingCosts | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> SessionReport:
    """Simulate `seconds` of virtual time. The same arguments give the same report.

    stopped: called again and again; True ends the simulation early.
    """
    with Workers() as workers:
        simulation = Simulation(
            setup, workers, seed=seed, media=media, selections=selections, costs=costs
        )
        # The present objects stay until the end, so the garbage collector need not visit them.
        gc.collect()
        gc.freeze()
        try:
            now_ns, end_ns = 0, round(seconds * NS_PER_S)
            while now_ns < end_ns and not stopped():
                now_ns = min(now_ns + _STRIDE_NS, end_ns)
                simulation.run(now_ns)
        finally:
            gc.unfreeze()
        return simulation.report()


def parse_selections(options: Sequence[str], setup: Setup, seconds: float) -> list[Selection]:
    """Parse T=CAMERA options.

    Raises ConfigError for an instant outside of the session's `seconds`, or an unknown camera.
    """
    selections = []
    for option in options:
        instant, equals, camera = option.partition("=")
        try:
            instant_ns = round(float(instant) * NS_PER_S)
        except (ValueError, OverflowError):
            instant_ns = -1
        if not equals or instant_ns < 0:
            raise ConfigError(f"--select {option}: write T=CAMERA, like 10=static for second 10")
        if instant_ns >= seconds * NS_PER_S:
            raise ConfigError(f"--select {option}: the session ends at second {seconds:g}")
        if camera not in setup.cameras:
            known = ", ".join(setup.cameras)
            raise ConfigError(f"--select {option}: unknown camera {camera}: choose one of {known}")
        selections.append(Selection(instant_ns, camera))
    return selections


def _option(cost: str) -> str:
    return f"--{cost.replace('_', '-')}"
