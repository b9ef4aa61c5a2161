"""`kontur-av bench latency`: the latency of every stream of a setup, end to end and by stage."""

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from rich.box import SIMPLE_HEAD
from rich.table import Table

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ConfigError
from pipelines.bench.session import busy_programs, live_session
from pipelines.report.charts import check_plot, lead_chart, save
from pipelines.report.journeys import STAGES
from pipelines.report.model import ContentSkew, Ranks, SessionReport, SkewReport, Spread, VideoLead
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, titled_table
from pipelines.report.sync_metrics import LIMITS
from pipelines.report.terms import TERMS
from pipelines.session.option_rows import add_options
from pipelines.session.options import (
    add_session_options,
    asked_setup,
    setup_changes,
    stream_options,
)
from pipelines.session.setup.setup_file import BUILT_IN, load_setup
from pipelines.session.setup.table import Setup
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.simulate import simulate

#: In ms. Force: p99.9, above the delay of the radio. Pictures and voice: p99, the delay of the
#: radio included. Skew: p95.
FORCE_MS, VIDEO_MS, VOICE_MS, SKEW_MS = 3.0, 45.0, 60.0, 45.0
#: Setup and radio for which the bounds are meant.
MEANT_FOR = ("spacejustin", "clean")


@dataclass(frozen=True, slots=True)
class LatencyVerdict:
    """One target. bound, found: in words. value: what was found, in `unit`."""

    what: str
    bound: str
    found: str
    met: bool
    unit: str
    value: float

    def headline(self, kind: str, *, judged: bool) -> Headline:
        """As a figure of a `kind` of session. judged: whether the target is meant for it."""
        return Headline(
            what=self.what,
            who=kind,
            unit=self.unit,
            value=self.value,
            target=self.bound if judged else "",
            met=self.met if judged else None,
        )


def judge(report: SessionReport) -> list[LatencyVerdict]:
    """A verdict on each target of which the report of a run has a figure."""
    verdicts = []
    force, radio = report.haptic["up"].latency_ms, report.gateways["ground"].radio
    if radio is not None and force.count:
        above_ms = force.p99_9 - radio.delay_max_ns / NS_PER_MS
        what = "force, one way, above the radio's delay, p99.9"
        verdicts.append(_at_most(what, FORCE_MS, above_ms))
    for name, stream in report.streams.items():
        video = name.endswith("video")
        if stream.latency_ms.count:
            bound_ms = VIDEO_MS if video else VOICE_MS
            what = f"{name}, {'capture to display' if video else 'mouth to ear'}, p99"
            verdicts.append(_at_most(what, bound_ms, stream.latency_ms.p99))
    skew = report.skew_ms.get("video_haptic")
    if skew is not None:
        verdicts.append(_at_most("video after force, p95", SKEW_MS, skew.p95))
    if report.lip_sync is not None:
        within = report.lip_sync.within
        verdicts.append(
            LatencyVerdict(
                "sound -45 to +125 ms after picture (ITU-R BT.1359)",
                "always",
                f"{100 * within:.3f} % of time",
                within == 1,
                "% of time",
                100 * within,
            )
        )
    return verdicts


def _at_most(what: str, bound_ms: float, found_ms: float) -> LatencyVerdict:
    met = found_ms <= bound_ms
    return LatencyVerdict(what, f"<= {bound_ms:g} ms", f"{found_ms:.1f} ms", met, "ms", found_ms)


_PERCENTILES = ("p50", "p95", "p99", "p99.9", "max")
_NOTHING = [""] * (1 + len(_PERCENTILES))
#: A longer lead of the force over its picture is noticeable.
_NOTICED_MS = LIMITS["video_haptic"].most_ns / NS_PER_MS
_HISTOGRAM_PERCENT = 0.4
_table = partial(titled_table, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))

_LEAD_NOTE = (
    "of an event at any instant of the camera's period; see docs/experiments/latency.md\n"
    f"noticeable from {_NOTICED_MS:g} ms ({LIMITS['video_haptic'].source}); force is never delayed"
)
_SKEWS = {
    "video_haptic": ("video", "force"),
    "audio_haptic": ("audio", "force"),
    "audio_video": ("audio", "video"),
}


@dataclass(frozen=True, slots=True)
class ClockMethod:
    """How instants were compared.

    method: in words. error_us: the largest error of a difference of two instants.
    """

    method: str
    error_us: float


VIRTUAL_CLOCK = ClockMethod("one virtual clock for all", 0.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session_options(parser, "setup=spacejustin")
    add_options(parser, "--seconds S <float=20.0>  of virtual time (default 20)")
    live = parser.add_mutually_exclusive_group()
    add_options(
        live,
        "--live-seconds S <float=20.0>  of real time (default 20)",
        "--no-live  virtual time only",
    )
    add_session_options(parser, "radio=clean", "deadband")
    add_options(
        parser,
        "--load N <int=0>  busy programs beside the live run",
        "--seed N <int=1>  of the radio's losses",
        "--base-port P <int=27000>  of the live run",
        "--report",
        "--plot FILE <Path>  draw the lead's terms as PNG",
    )


def run(args: argparse.Namespace) -> int:
    """Measure and print the page; 1 if a session failed. A missed target is no failure."""
    for name in ("seconds", "live_seconds"):
        if not 1 <= getattr(args, name) <= 3600:
            option = f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option} {getattr(args, name):g}: give 1 to 3600")
    if not 0 <= args.load <= 64:
        raise ConfigError(f"--load {args.load}: give 0 to 64")
    check_writable(args.report)
    check_plot(args.plot)
    setups = _setups(args)
    console = open_console(args)
    setup = setups[0]
    console.print(_heading(args, setup), markup=False, highlight=False)
    runs = {"virtual": simulate(setup, seconds=args.seconds, seed=args.seed)}
    clocks = {"virtual": VIRTUAL_CLOCK}
    live = None if args.no_live else _live(args)
    if live is not None:
        runs["live"], clocks["live"] = live, live_clock(live)
    console.print(_latencies(runs))
    console.print(_clocks(runs, clocks), markup=False, highlight=False)
    verdicts = judge(runs["virtual"])
    console.print(_targets(setup, args.radio, verdicts, live))
    others = {
        other.name: simulate(other, seconds=args.seconds, seed=args.seed) for other in setups[1:]
    }
    leads = {f"{setup.name}, {kind}": report.video_lead for kind, report in runs.items()}
    leads |= {f"{name}, virtual": report.video_lead for name, report in others.items()}
    console.print(_leads(leads))
    console.print(_LEAD_NOTE, markup=False, highlight=False)
    failures = [
        f"{name} session failed: {failure}"
        for name, report in runs.items()
        for failure in report.failures
    ]
    for failure in failures:
        console.print(failure, markup=False)
    if args.plot is not None:
        shown = {
            label: {term: getattr(lead.lead_ms, term) for term in (*TERMS, "total")}
            for label, lead in leads.items()
            if lead is not None
        }
        limits = {f"noticeable from {_NOTICED_MS:g} ms": _NOTICED_MS}
        save(lead_chart(shown, limits), args.plot)
    # Clocks of each session; the section `video_lead` of each report; whole reports.
    result = {
        "setup": setup.name,
        "radio": setup.radio_profile.name,
        "seed": args.seed,
        "clocks": clocks,
        "targets": verdicts,
        "leads": leads,
        "virtual": runs["virtual"],
        "live": live,
        "other_setups": others,
    }
    judged = (setup.name, args.radio) == MEANT_FOR
    write_result(args.report, result, _headlines(verdicts, live, runs, judged=judged))
    return 1 if failures else 0


def _live(args: argparse.Namespace) -> SessionReport:
    try:
        with busy_programs(args.load):
            return live_session(
                args.setup,
                seconds=args.live_seconds,
                seed=args.seed,
                radio=args.radio,
                base_port=args.base_port,
                deadband=args.deadband,
            )
    except ConfigError as error:
        raise ConfigError(f"live: {error} (or leave it out with --no-live)") from None


def _headlines(
    verdicts: Sequence[LatencyVerdict],
    live: SessionReport | None,
    runs: Mapping[str, SessionReport],
    *,
    judged: bool,
) -> list[Headline]:
    found = [verdict.headline("virtual time", judged=judged) for verdict in verdicts]
    if live is not None:
        found += [verdict.headline("live", judged=False) for verdict in judge(live)]
    for kind, report in runs.items():
        name = "virtual time" if kind == "virtual" else kind
        if report.video_lead is not None:
            lead_ms = report.video_lead.lead_ms.total
            what = "force before the picture of the same event, mean"
            found.append(Headline(what=what, who=name, unit="ms", value=lead_ms))
    return found


def _setups(args: argparse.Namespace) -> list[Setup]:
    """The chosen setup first, then the other built-in ones, all with the chosen radio."""
    options = stream_options(args)
    first, changes = asked_setup(options), setup_changes(options)
    check_virtual_sources(first)
    return [first, *(load_setup(name, changes=changes) for name in BUILT_IN if name != first.name)]


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


def _latencies(runs: Mapping[str, SessionReport]) -> Table:
    headings = [heading for name in runs for heading in (f"{name}\nn", *_PERCENTILES)]
    title = "latency, ms: capture to display, mouth to ear, sample to sample"
    table = _table(title, "", *headings)
    table.columns[0].no_wrap = True
    for label, found in _rows(runs):
        table.add_row(label, *(cell for cells in found for cell in cells))
    return table


def _clocks(runs: Mapping[str, SessionReport], clocks: Mapping[str, ClockMethod]) -> str:
    lines = [
        f"{name}: {report.seconds:.0f} s; radio {_range(radio_delay_ms(report))} ms "
        f"one way; {clocks[name].method}, error <= {clocks[name].error_us:g} µs"
        for name, report in runs.items()
    ]
    return "\n".join([*lines, f"max is exact, percentiles to {_HISTOGRAM_PERCENT} %\n"])


def _cells(
    of: Spread | Ranks | SkewReport | ContentSkew, count: int, *, sign: str = ""
) -> list[str]:
    if not count:
        return _NOTHING
    names = ("p50", "p95", "p99", "p99_9", "max")
    return [str(count), *(_digits(getattr(of, name, None), sign) for name in names)]


def _digits(value: float | None, sign: str) -> str:
    if value is None:
        return ""
    return f"{value:{sign}.1f}" if abs(value) < 100 else f"{value:{sign}.0f}"


def _range(limits: tuple[float, float]) -> str:
    least, most = limits
    return f"{most:.1f}" if most - least < 0.05 else f"{least:.1f} to {most:.1f}"


def _rows(runs: Mapping[str, SessionReport]) -> Iterator[tuple[str, list[list[str]]]]:
    reports = list(runs.values())
    for direction in ("up", "down"):
        name = "force (haptic_up)" if direction == "up" else "command (haptic_down)"
        yield name, [_spread_cells(report.haptic[direction].latency_ms) for report in reports]
    for name in reports[0].streams:
        latencies = [report.streams[name].latency_ms for report in reports]
        yield name, [_spread_cells(latency) for latency in latencies]
        for stage in STAGES:
            label = f"  {stage.replace('_', ' ')}"
            yield label, [_spread_cells(getattr(latency.stages, stage)) for latency in latencies]
    found = [report.sync for report in reports]
    for sense, word in (("force", "felt"), ("light", "seen"), ("click", "heard")):
        senses = [None if sync is None else sync.senses.get(sense) for sync in found]
        if any(of is not None and of.perceived for of in senses):
            cells = [_cells(of.latency_ms, of.perceived) if of else _NOTHING for of in senses]
            yield f"contact until {word} (content)", cells
    for name, (first_sense, second) in _SKEWS.items():
        label = f"{first_sense} after {second}"
        stamps = [report.skew_ms.get(name) for report in reports]
        if any(stamps):
            cells = [_cells(of, of.count, sign="+") if of else _NOTHING for of in stamps]
            yield f"{label} (stamps)", cells
        content = [None if sync is None else sync.skew_ms.get(name) for sync in found]
        if any(content):
            cells = [_cells(of, of.events, sign="+") if of else _NOTHING for of in content]
            yield f"{label} (content)", cells


def _spread_cells(of: Spread) -> list[str]:
    return _cells(of, of.count)


def _targets(
    setup: Setup, radio: str, verdicts: Sequence[LatencyVerdict], live: SessionReport | None
) -> Table:
    headings = ["", "bound", "found", "", *["live, for information"] * (live is not None)]
    title = f"targets of {MEANT_FOR[0]} on {MEANT_FOR[1]}, virtual time"
    table = _table(title, *headings, left=headings)
    beside = {} if live is None else {verdict.what: verdict.found for verdict in judge(live)}
    for verdict in verdicts:
        cells = [verdict.what, verdict.bound, verdict.found, "met" if verdict.met else "MISSED"]
        table.add_row(*cells, *([] if live is None else [beside.get(verdict.what, "")]))
    if (setup.name, radio) != MEANT_FOR:
        table.caption = f"these targets are not meant for {setup.name} on {radio}"
    return table


def _leads(leads: Mapping[str, VideoLead | None]) -> Table:
    found = {label: lead for label, lead in leads.items() if lead is not None}
    headings = ["term"]
    for label in found:
        setup, _, kind = label.rpartition(", ")
        headings += [f"{setup}\n{kind}: video", "\nforce", "\nlead"]
    title = "by how much force comes before the picture of the same event: means, ms"
    table = _table(title, *headings, left=("term",))
    for term in (*TERMS, "total"):
        if term == "total":
            table.add_section()
        cells = [
            f"{getattr(terms, term):.1f}"
            for lead in found.values()
            for terms in (lead.video_ms, lead.force_ms, lead.lead_ms)
        ]
        table.add_row(term, *cells)
    return table


_READINGS = 2000


def live_clock(report: SessionReport) -> ClockMethod:
    """The clock of a live session, and the largest error of a difference of two readings.

    The error is the time that a reading takes (p99) or the clock's resolution, whichever is
    longer. For media, add the error of the capture time that RTCP carried.
    """
    readings = [time.monotonic_ns() for _ in range(_READINGS)]
    steps = sorted(after - before for before, after in pairwise(readings))
    resolution_ns = time.get_clock_info("monotonic").resolution * NS_PER_S
    reading_us = max(resolution_ns, steps[len(steps) * 99 // 100]) / NS_PER_US
    stamps = [of.capture_stamp_error_us for of in report.streams.values()]
    error_us = reading_us + max(stamps, default=0.0)
    return ClockMethod("CLOCK_MONOTONIC, one for all processes of the host", round(error_us, 2))


def radio_delay_ms(report: SessionReport) -> tuple[float, float]:
    """The least and the largest delay of the radio, ground to space."""
    radio = report.gateways["ground"].radio
    if radio is None:
        return 0.0, 0.0
    return radio.delay_min_ns / NS_PER_MS, radio.delay_max_ns / NS_PER_MS
