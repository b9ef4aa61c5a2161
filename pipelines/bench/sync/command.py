"""`kontur-av bench sync`: the skew between sight, hearing and touch, measured by content.

It measures a session, on virtual time or live, or recordings of an LED, a click and a force.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from kontur_av.clock import NS_PER_MS
from kontur_av.detect import Roi
from kontur_av.errors import ConfigError
from pipelines.bench.session import live_session
from pipelines.bench.sync.footage import clicks, joined, lights, steps
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.model import ContentSkew, SyncReport
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json, titled_table
from pipelines.report.sync_figures import PAIRS, SENSES, SensedEvent, skew_summary, skews_ns
from pipelines.report.sync_matching import Matched
from pipelines.session.options import radio_change
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.sources import check_sources
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.simulate import simulate

_WORDS = {
    "video_haptic": "video after force",
    "audio_haptic": "sound after force",
    "audio_video": "sound after video",
}
#: The sense of a recording, by the option that names its file.
_RECORDINGS = {"video": "light", "audio": "click", "haptics": "force"}
_LONGEST_OFFSET_MS = 3_600_000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    session = parser.add_argument_group("a session")
    session.add_argument(
        "--setup", metavar="NAME", help="spacejustin (default), taskboard or FILE.toml"
    )
    session.add_argument(
        "--seconds", type=float, metavar="S", help="how long (default 60; live 30)"
    )
    session.add_argument("--live", action="store_true", help="on this machine, in real time")
    session.add_argument(
        "--radio", metavar="PROFILE", help="cable, clean (default), iss-pass, geo or FILE.toml"
    )
    session.add_argument("--seed", type=int, default=1, metavar="N", help="of the radio's chances")
    session.add_argument(
        "--base-port", type=int, default=27_000, metavar="P", help="of a live session"
    )
    footage = parser.add_argument_group("recordings, at least two, instead of a session")
    footage.add_argument("--video", type=Path, metavar="FILE", help="an LED that lights up")
    footage.add_argument("--audio", type=Path, metavar="FILE", help="a click; may be the same file")
    footage.add_argument("--haptics", type=Path, metavar="FILE", help="CSV: time_s,force_n")
    footage.add_argument(
        "--offset-ms",
        action="append",
        default=[],
        metavar="NAME=MS",
        help="add MS to every instant of video, audio or haptics; may be given several times",
    )
    footage.add_argument(
        "--roi", metavar="X,Y,W,H", help="where the LED is, in pixels of the file; default all"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the skews as PNG")


def run(args: argparse.Namespace) -> int:
    """Measure and print; 1 if the stamps of a session disagree with its content, or it failed."""
    check_writable(args.report)
    check_plot(args.plot)
    console = open_console(args)
    recordings = {name: path for name in _RECORDINGS if (path := getattr(args, name)) is not None}
    if recordings:
        return _run_footage(args, recordings, console)
    return _run_session(args, console)


def _run_session(args: argparse.Namespace, console: Console) -> int:
    if args.offset_ms or args.roi:
        raise ConfigError("--offset-ms and --roi are of recordings: give --video FILE, too")
    seconds = args.seconds
    if seconds is None:
        seconds = 30.0 if args.live else 60.0
    if not 5 <= seconds <= 36_000:
        raise ConfigError(f"--seconds {seconds:g}: give 5 to 36000")
    name, radio = args.setup or "spacejustin", args.radio or "clean"
    setup = load_setup(name, changes=radio_change(radio))
    check_sources(setup, setup.inputs)
    if args.live:
        report = live_session(
            name, seconds=seconds, seed=args.seed, radio=radio, base_port=args.base_port
        )
    else:
        check_virtual_sources(setup)
        report = simulate(setup, seconds=seconds, seed=args.seed)
    sync = report.sync
    if sync is None:
        raise ConfigError(f"--seconds {seconds:g}: no target was touched; give more")
    where = "live" if args.live else "on virtual time"
    console.print(f"{setup.name}, {seconds:g} s {where}, radio {radio}, seed {args.seed}")
    console.print(
        f"{sync.events} touches of a target, {sync.touches_beside_targets} beside one, "
        f"{sync.bounces} bounces"
    )
    console.print(_senses(sync))
    console.print(_skews(sync.skew_ms))
    for failure in report.failures:
        console.print(f"failed: {failure}", style="bold red", markup=False)
    body = as_json(sync)
    assert isinstance(body, dict)
    head: dict[str, Json] = {"setup": setup.name, "radio": radio, "seconds": seconds}
    write_result(args.report, head | body, _headlines(sync))
    if args.plot is not None:
        pairs = {pair: _listed_skews(sync, *senses) for pair, senses in PAIRS.items()}
        _plot(args.plot, pairs, f"{setup.name}, {where}, radio {radio}")
    disagrees = any(of is not None and of.agrees is False for of in sync.senses.values())
    return 1 if disagrees or report.failures else 0


def _listed_skews(sync: SyncReport, first: str, second: str) -> list[float]:
    """Of the events that both senses perceived, in ms."""
    both = (
        (getattr(event, f"{first}_ms"), getattr(event, f"{second}_ms")) for event in sync.listed
    )
    return [one - other for one, other in both if one is not None and other is not None]


def _headlines(sync: SyncReport) -> list[Headline]:
    found = [Headline(what="touches of a target", unit="", value=sync.events)]
    for sense, of in sync.senses.items():
        if of is not None and of.perceived:
            for name, value in (("p50", of.latency_ms.p50), ("p99", of.latency_ms.p99)):
                what = f"contact until {sense} at the operator, {name}"
                found.append(Headline(what=what, unit="ms", value=value))
    for pair, skew in sync.skew_ms.items():
        if skew is not None:
            found.append(Headline(what=f"{_WORDS[pair]}, p95", unit="ms", value=skew.p95))
            what = f"{_WORDS[pair]}, share that is not noticeable"
            found.append(Headline(what=what, unit="%", value=100 * skew.within))
    return found


def _run_footage(args: argparse.Namespace, recordings: Mapping[str, Path], console: Console) -> int:
    for option in ("setup", "seconds", "radio"):
        if getattr(args, option) is not None or args.live:
            raise ConfigError("recordings and a session: give one of them")
    if len(recordings) < 2:
        raise ConfigError("give at least two of --video, --audio and --haptics")
    offsets = _offsets(args.offset_ms, recordings)
    roi = _roi(args.roi)
    found: dict[str, list[Matched]] = {}
    for name, path in recordings.items():
        sense = _RECORDINGS[name]
        if name == "video":
            some = lights(path, roi)
        else:
            some = clicks(path) if name == "audio" else steps(path)
        if not some:
            raise ConfigError(f"{path}: no {'step of the force' if name == 'haptics' else sense}")
        offset_ns = offsets.get(name, 0)
        found[sense] = [replace(one, instant_ns=one.instant_ns + offset_ns) for one in some]
    events = joined(found)
    console.print(_events(events))
    skews = {pair: skew_summary(pair, skews_ns(pair, events)) for pair in PAIRS}
    console.print(_skews(skews))
    # Events: instants in s on the clock of the recordings; null where nothing was found.
    result = {
        "recordings": recordings,
        "offset_ms": {name: ns / NS_PER_MS for name, ns in offsets.items()},
        "events": [
            {**{sense: _instant_s(event, sense) for sense in SENSES}, "number": number}
            for number, event in enumerate(events, 1)
        ],
        "skew_ms": skews,
    }
    write_result(args.report, result, ())
    if args.plot is not None:
        pairs = {pair: [value / NS_PER_MS for value in skews_ns(pair, events)] for pair in PAIRS}
        _plot(args.plot, pairs, "recordings")
    return 0


def _offsets(options: Sequence[str], recordings: Mapping[str, Path]) -> dict[str, int]:
    offsets = {}
    for option in options:
        name, equals, text = option.partition("=")
        try:
            offset_ms = float(text)
        except ValueError:
            offset_ms = float("nan")
        if not equals or name not in recordings or not abs(offset_ms) <= _LONGEST_OFFSET_MS:
            known = ", ".join(recordings)
            raise ConfigError(f"--offset-ms {option}: write NAME=MS with one of {known}")
        offsets[name] = round(offset_ms * NS_PER_MS)
    return offsets


def _roi(text: str | None) -> Roi | None:
    if text is None:
        return None
    try:
        left, top, width, height = (int(part) & ~1 for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--roi {text}: write X,Y,W,H, like 300,200,64,64") from None
    if min(left, top) < 0 or min(width, height) < 16:
        raise ConfigError(f"--roi {text}: X and Y from 0 on, W and H from 16 on")
    return Roi(left, top, width, height)


def _senses(sync: SyncReport) -> Table:
    table = titled_table(
        "from the contact to the operator, ms",
        *("sense", "perceived", "missed", "p50", "p95", "p99", "max", "by stamps p50"),
        *("stamp error", "allowed", "stamps"),
        left=("sense", "stamps"),
        box=SIMPLE_HEAD,
        caption="stamp error: instant by the stamps less instant by the content, p50 of the "
        "clearest; for a light up to one picture period",
        caption_justify="left",
    )
    for sense, of in sync.senses.items():
        if of is None:
            continue
        latency = of.latency_ms
        table.add_row(
            sense,
            str(of.perceived),
            str(of.missed),
            *(_ms(value) for value in (latency.p50, latency.p95, latency.p99, latency.max)),
            _ms(of.stamped_latency_ms.p50),
            _ms(of.judged_error_ms, signed=True),
            _limits(of.allowed_error_ms),
            "too few to say" if of.agrees is None else "agree" if of.agrees else "DISAGREE",
        )
    return table


def _limits(limits: tuple[float, float]) -> str:
    return f"{limits[0]:+.0f} to {limits[1]:+.0f}"


def _skews(skews: Mapping[str, ContentSkew | None]) -> Table:
    table = titled_table(
        "skew at the operator, ms",
        *("skew", "events", "p50", "p95", "p99", "max", "unnoticed", "limits", "of"),
        left=("skew", "of"),
        box=SIMPLE_HEAD,
    )
    for name, of in skews.items():
        if of is None:
            continue
        table.add_row(
            _WORDS[name],
            str(of.events),
            *(_ms(value, signed=True) for value in (of.p50, of.p95, of.p99, of.max)),
            f"{100 * of.within:.0f} %",
            _limits(of.limits_ms),
            of.source,
        )
    return table


def _events(events: Sequence[SensedEvent]) -> Table:
    words = [f"{one}, ms" for one in _WORDS.values()]
    headings = ("number", *SENSES, *words)
    table = titled_table("events, instants in s", *headings, box=SIMPLE_HEAD)
    for number, event in enumerate(events, 1):
        skews = [skews_ns(pair, [event]) for pair in _WORDS]
        instants = [_instant_s(event, sense) for sense in SENSES]
        table.add_row(
            str(number),
            *("-" if instant is None else f"{instant:.4f}" for instant in instants),
            *(_ms(skew[0] / NS_PER_MS if skew else None, signed=True) for skew in skews),
        )
    return table


def _instant_s(event: SensedEvent, sense: str) -> float | None:
    found = event.perceived[sense]
    return None if found is None else round(found.instant_ns / 1e9, 6)


def _ms(value: float | None, *, signed: bool = False) -> str:
    if value is None:
        return "-"
    return f"{value:+.1f}" if signed else f"{value:.1f}"


def _plot(path: Path, pairs: Mapping[str, Sequence[float]], title: str) -> None:
    """Draw the absolute skew of each pair of senses."""
    curves = {
        _WORDS[pair].replace(" after ", " and "): [abs(value) for value in values]
        for pair, values in pairs.items()
        if values
    }
    save(distributions({title: curves}, axis="skew (absolute value), ms"), path)
