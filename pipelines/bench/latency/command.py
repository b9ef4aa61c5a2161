"""`kontur-av bench latency`: one page of what each stream of a setup takes, and of what."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.bench.charts import check_plot, save
from pipelines.bench.console import open_console
from pipelines.bench.latency.charts import lead_chart
from pipelines.bench.latency.runs import (
    VIRTUAL_CLOCK,
    Clock,
    live_clock,
    live_run,
    radio_delay_ms,
    virtual_run,
)
from pipelines.bench.latency.targets import MEANT_FOR, Verdict, judge
from pipelines.commands.session_options import (
    add_deadband_argument,
    add_radio_argument,
    add_setup_argument,
    deadband_changes,
)
from pipelines.commands.stream import check_sources
from pipelines.report.report_file import check_writable, write_report
from pipelines.report.sync.limits import LIMITS
from pipelines.report.terms import TERMS
from pipelines.setup.built_in import BUILT_IN
from pipelines.setup.setup_file import load_setup
from pipelines.setup.table import Setup
from pipelines.simulation.inputs import check_sources as check_virtual_sources

_PERCENTILES = ("p50", "p95", "p99", "p99.9", "max")
#: Force that comes before its picture by more is noticed.
_NOTICED_MS = LIMITS["video_haptic"].most_ns / NS_PER_MS
_HISTOGRAM_PERCENT = 0.4

_LEAD_NOTE = (
    "of an event at any instant of the camera's period; docs/latency.md says how each is obtained\n"
    f"noticed from {_NOTICED_MS:g} ms on ({LIMITS['video_haptic'].source}); force is never delayed"
)
_SKEWS = {
    "video_haptic": ("video", "force"),
    "audio_haptic": ("audio", "force"),
    "audio_video": ("audio", "video"),
}

Report = Mapping[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench latency`."""
    add_setup_argument(parser, default="spacejustin")
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of virtual time (default 20)"
    )
    live = parser.add_mutually_exclusive_group()
    live.add_argument(
        "--live-seconds", type=float, default=20.0, metavar="S", help="of real time (default 20)"
    )
    live.add_argument("--no-live", action="store_true", help="virtual time only")
    add_radio_argument(parser, default="clean")
    add_deadband_argument(parser)
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the radio's chances")
    parser.add_argument(
        "--base-port", type=int, default=27_000, metavar="P", help="of the live run"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the lead's terms as PNG")


def run(args: argparse.Namespace) -> int:
    """Measure, and print the page."""
    for name in ("seconds", "live_seconds"):
        if not 1 <= getattr(args, name) <= 3600:
            option = f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option} {getattr(args, name):g}: give 1 to 3600")
    check_writable(args.report)
    check_plot(args.plot)
    setups = _setups(args)
    console = open_console(args)
    setup = setups[0]
    console.print(_heading(args, setup), markup=False, highlight=False)
    virtual = virtual_run(setup, seconds=args.seconds, seed=args.seed)
    live = None
    if not args.no_live:
        live = live_run(
            args.setup,
            seconds=args.live_seconds,
            seed=args.seed,
            radio=args.radio,
            base_port=args.base_port,
            deadband=args.deadband,
        )
    clocks = {"virtual": VIRTUAL_CLOCK} | ({} if live is None else {"live": live_clock(live)})
    runs: dict[str, Report] = {"virtual": virtual} | ({} if live is None else {"live": live})
    console.print(_latencies(runs))
    console.print(_clocks(runs, clocks), markup=False, highlight=False)
    verdicts = judge(virtual)
    console.print(_targets(setup, args.radio, verdicts, live))
    leads = {f"{setup.name}, virtual": virtual["video_lead"]}
    if live is not None:
        leads[f"{setup.name}, live"] = live["video_lead"]
    others = {}
    for other in setups[1:]:
        others[other.name] = virtual_run(other, seconds=args.seconds, seed=args.seed)
        leads[f"{other.name}, virtual"] = others[other.name]["video_lead"]
    console.print(_leads(leads))
    console.print(_LEAD_NOTE, markup=False, highlight=False)
    failures = [
        f"{name} session failed: {failure}"
        for name, report in runs.items()
        for failure in report["failures"]
    ]
    for failure in failures:
        console.print(failure, markup=False)
    if args.plot is not None:
        shown = {label: lead["lead_ms"] for label, lead in leads.items() if lead is not None}
        limits = {f"noticeable from {_NOTICED_MS:g} ms": _NOTICED_MS}
        save(lead_chart(shown, limits), args.plot)
    if args.report is not None:
        figures = {
            "setup": setup.name,
            "radio": setup.radio_profile.name,
            "seed": args.seed,
            "clocks": {name: asdict(clock) for name, clock in clocks.items()},
            "targets": [asdict(verdict) for verdict in verdicts],
            "leads": leads,
            "virtual": virtual,
            "live": live,
            "other_setups": others,
        }
        write_report(args.report, figures)
    missed = (setup.name, args.radio) == MEANT_FOR and not all(of.met for of in verdicts)
    return 1 if missed or failures else 0


def _setups(args: argparse.Namespace) -> list[Setup]:
    """The chosen one, and the built-in ones to compare it with, all with the chosen radio."""
    chosen = load_setup(args.setup)
    others = [setup for name, setup in BUILT_IN.items() if name != chosen.name]
    changes = {"radio": args.radio, "radio_delay_ms": 0.0, **deadband_changes(args)}
    # The live run's port, checked before anything is measured.
    first = replace(chosen, base_port=args.base_port, **changes)
    check_virtual_sources(first)
    check_sources(first)
    return [first, *(replace(setup, **changes) for setup in others)]


def _heading(args: argparse.Namespace, setup: Setup) -> str:
    links = (
        f"{profile.name} {profile.capacity_bps / 1000:g} kbit/s, {profile.frame_octets} octets "
        f"each {profile.slot_ns / NS_PER_S * 1000:g} ms"
        for profile in (setup.uplink, setup.downlink)
    )
    radio = setup.radio_profile
    described = f" ({radio.description})" if radio.description else ""
    left_out = "" if setup.deadband == "off" else f", deadband for the {setup.deadband}"
    return (
        f"{setup.name}{left_out}; radio {radio.name}{described}, seed {args.seed}\n"
        f"link: {'; '.join(links)}\n"
    )


def _latencies(runs: Mapping[str, Report]) -> Table:
    table = Table(
        title="latency, ms: capture to display, mouth to ear, sample to sample",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for name in runs:
        table.add_column(f"{name}\nn", justify="right")
        for percentile in _PERCENTILES:
            table.add_column(percentile, justify="right")
    for label, found in _rows(runs):
        cells: list[str] = []
        for latency in found:
            cells += _cells(latency, sign="+" if " after " in label else "")
        table.add_row(label, *cells)
    return table


def _clocks(runs: Mapping[str, Report], clocks: Mapping[str, Clock]) -> str:
    lines = [
        f"{name}: {report['seconds']:.0f} s; radio {_range(radio_delay_ms(report))} ms one way; "
        f"{clocks[name].method}, error <= {clocks[name].error_us:g} µs"
        for name, report in runs.items()
    ]
    return "\n".join([*lines, f"max is exact, percentiles to {_HISTOGRAM_PERCENT} %\n"])


def _cells(summary: Mapping[str, Any] | None, *, sign: str) -> list[str]:
    if not summary or summary.get("count") == 0:
        return [""] * (1 + len(_PERCENTILES))
    count = summary.get("count", summary.get("events", ""))
    return [str(count), *(_digits(summary.get(p), sign) for p in _PERCENTILES)]


def _digits(value: float | None, sign: str) -> str:
    if value is None:
        return ""
    return f"{value:{sign}.1f}" if abs(value) < 100 else f"{value:{sign}.0f}"


def _range(limits: tuple[float, float]) -> str:
    least, most = limits
    return f"{most:.1f}" if most - least < 0.05 else f"{least:.1f} to {most:.1f}"


def _rows(
    runs: Mapping[str, Report],
) -> Iterator[tuple[str, Sequence[Mapping[str, Any] | None]]]:
    first = next(iter(runs.values()))
    for direction in ("up", "down"):
        name = "force (haptic_up)" if direction == "up" else "command (haptic_down)"
        yield name, [report["haptic"][direction]["latency_ms"] for report in runs.values()]
    for name, stream in first["streams"].items():
        latencies = [report["streams"][name]["latency_ms"] for report in runs.values()]
        yield name, latencies
        for stage in stream["latency_ms"]["stages"]:
            label = f"  {stage.replace('_', ' ')}"
            yield label, [latency["stages"][stage] for latency in latencies]
    contacts = [report.get("sync") or {"senses": {}, "skew_ms": {}} for report in runs.values()]
    for sense, word in (("force", "felt"), ("light", "seen"), ("click", "heard")):
        told = [of["senses"].get(sense) for of in contacts]
        if any(of and of["perceived"] for of in told):
            yield (
                f"contact until {word} (content)",
                [of and {**of["latency_ms"], "count": of["perceived"]} for of in told],
            )
    for name, (first_sense, second) in _SKEWS.items():
        label = f"{first_sense} after {second}"
        for words, skews in (
            (f"{label} (stamps)", [report["skew_ms"].get(name) for report in runs.values()]),
            (f"{label} (content)", [of["skew_ms"].get(name) for of in contacts]),
        ):
            if any(skews):
                yield words, skews


def _targets(setup: Setup, radio: str, verdicts: Sequence[Verdict], live: Report | None) -> Table:
    table = Table(
        title=f"targets of {MEANT_FOR[0]} on {MEANT_FOR[1]}, virtual time",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for heading in ("", "bound", "found", ""):
        table.add_column(heading)
    if live is not None:
        table.add_column("live, for information")
    beside = {} if live is None else {verdict.what: verdict.found for verdict in judge(live)}
    for verdict in verdicts:
        cells = [verdict.what, verdict.bound, verdict.found, "met" if verdict.met else "MISSED"]
        table.add_row(*cells, *([] if live is None else [beside.get(verdict.what, "")]))
    if (setup.name, radio) != MEANT_FOR:
        table.caption = f"this is {setup.name} on {radio}: they are not meant for it"
    return table


def _leads(leads: Mapping[str, Mapping[str, Any] | None]) -> Table:
    table = Table(
        title="by how much force comes before the picture of the same event: means, ms",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("term")
    found = {label: lead for label, lead in leads.items() if lead is not None}
    for label in found:
        setup, _, kind = label.rpartition(", ")
        table.add_column(f"{setup}\n{kind}: video", justify="right")
        table.add_column("\nforce", justify="right")
        table.add_column("\nlead", justify="right")
    for term in (*TERMS, "total"):
        if term == "total":
            table.add_section()
        cells = [
            f"{lead[key][term]:.1f}"
            for lead in found.values()
            for key in ("video_ms", "force_ms", "lead_ms")
        ]
        table.add_row(term, *cells)
    return table
