"""`kontur-av bench sync`: how far sight, hearing and touch lie apart, from content.

Of a session on virtual time or live, or of recordings of a real LED, a real click and a real force.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from kontur_av.clock import NS_PER_MS
from kontur_av.detect import Roi
from kontur_av.errors import ConfigError
from pipelines.bench.charts import check_plot, distributions, save
from pipelines.bench.console import open_console
from pipelines.bench.latency.runs import live_run
from pipelines.bench.sync.footage import clicks, joined, lights, steps
from pipelines.commands.simulate import simulate
from pipelines.commands.stream import check_sources
from pipelines.report.report_file import check_writable, write_report
from pipelines.report.sync.figures import PAIRS, SENSES, Event, skew_summary, skews_ns
from pipelines.report.sync.matching import Found
from pipelines.setup.setup_file import load_setup
from pipelines.simulation.inputs import check_sources as check_virtual_sources

_WORDS = {
    "video_haptic": "video after force",
    "audio_haptic": "sound after force",
    "audio_video": "sound after video",
}
#: By the option that names the recording.
_RECORDINGS = {"video": "light", "audio": "click", "haptics": "force"}
_LONGEST_OFFSET_MS = 3_600_000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench sync`."""
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
    """Measure and print; 1 if the stamps of a session disagree with its content."""
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
    setup = replace(load_setup(name), radio=radio, radio_delay_ms=0.0)
    check_sources(setup)
    if args.live:
        report = live_run(
            name, seconds=seconds, seed=args.seed, radio=radio, base_port=args.base_port
        )
    else:
        check_virtual_sources(setup)
        report = simulate(setup, seconds=seconds, seed=args.seed)
    sync = report["sync"]
    if sync is None:
        raise ConfigError(f"--seconds {seconds:g}: no target was touched; give more")
    where = "live" if args.live else "on virtual time"
    console.print(f"{setup.name}, {seconds:g} s {where}, radio {radio}, seed {args.seed}")
    console.print(
        f"{sync['events']} touches of a target, {sync['touches_beside_targets']} beside one, "
        f"{sync['bounces']} bounces"
    )
    console.print(_senses(sync["senses"]))
    console.print(_skews(sync["skew_ms"]))
    for failure in report["failures"]:
        console.print(f"failed: {failure}", style="bold red", markup=False)
    if args.report is not None:
        write_report(args.report, {"setup": setup.name, "radio": radio, "seconds": seconds, **sync})
    if args.plot is not None:
        listed = sync["listed"]
        pairs = {
            pair: [
                event[f"{first}_ms"] - event[f"{second}_ms"]
                for event in listed
                if None not in (event[f"{first}_ms"], event[f"{second}_ms"])
            ]
            for pair, (first, second) in PAIRS.items()
        }
        _plot(args.plot, pairs, f"{setup.name}, {where}, radio {radio}")
    disagrees = any(
        sense is not None and sense["agrees"] is False for sense in sync["senses"].values()
    )
    return 1 if disagrees or report["failures"] else 0


def _run_footage(args: argparse.Namespace, recordings: Mapping[str, Path], console: Console) -> int:
    for option in ("setup", "seconds", "radio"):
        if getattr(args, option) is not None or args.live:
            raise ConfigError("recordings and a session: give one of them")
    if len(recordings) < 2:
        raise ConfigError("give at least two of --video, --audio and --haptics")
    offsets = _offsets(args.offset_ms, recordings)
    roi = _roi(args.roi)
    found: dict[str, list[Found]] = {}
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
    if args.report is not None:
        figures = [
            {sense: _instant_s(event, sense) for sense in SENSES} | {"number": number}
            for number, event in enumerate(events, 1)
        ]
        write_report(
            args.report,
            {
                "recordings": {name: str(path) for name, path in recordings.items()},
                "offset_ms": {name: ns / NS_PER_MS for name, ns in offsets.items()},
                "events": figures,
                "skew_ms": skews,
            },
        )
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


def _senses(senses: Mapping[str, Mapping[str, Any] | None]) -> Table:
    table = Table(
        title="from the contact to the operator, ms",
        title_justify="left",
        box=SIMPLE_HEAD,
        caption="stamp error: when the stamps say that it happened, less when it did, p50 of the "
        "clearest; of a light up to a picture's period",
        caption_justify="left",
    )
    table.add_column("sense")
    for heading in ("perceived", "missed", "p50", "p95", "p99", "max", "by stamps p50"):
        table.add_column(heading, justify="right")
    table.add_column("stamp error", justify="right")
    table.add_column("allowed", justify="right")
    table.add_column("stamps")
    for sense, figures in senses.items():
        if figures is None:
            continue
        least, most = figures["allowed_error_ms"]
        verdict = {True: "agree", False: "DISAGREE", None: "too few to say"}[figures["agrees"]]
        table.add_row(
            sense,
            str(figures["perceived"]),
            str(figures["missed"]),
            *(_ms(figures["latency_ms"].get(key)) for key in ("p50", "p95", "p99", "max")),
            _ms(figures["stamped_latency_ms"].get("p50")),
            _ms(figures["judged_error_ms"], signed=True),
            f"{least:+.0f} to {most:+.0f}",
            verdict,
        )
    return table


def _skews(skews: Mapping[str, Mapping[str, Any] | None]) -> Table:
    table = Table(title="skew at the operator, ms", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("skew")
    for heading in ("events", "p50", "p95", "p99", "max", "unnoticed", "limits"):
        table.add_column(heading, justify="right")
    table.add_column("of")
    for name, figures in skews.items():
        if figures is None:
            continue
        least, most = figures["limits_ms"]
        table.add_row(
            _WORDS[name],
            str(figures["events"]),
            *(_ms(figures[key], signed=True) for key in ("p50", "p95", "p99", "max")),
            f"{100 * figures['within']:.0f} %",
            f"{least:+.0f} to {most:+.0f}",
            figures["source"],
        )
    return table


def _events(events: Sequence[Event]) -> Table:
    table = Table(title="events, instants in s", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("number", justify="right")
    for sense in SENSES:
        table.add_column(sense, justify="right")
    for words in _WORDS.values():
        table.add_column(f"{words}, ms", justify="right")
    for number, event in enumerate(events, 1):
        skews = [skews_ns(pair, [event]) for pair in _WORDS]
        instants = [_instant_s(event, sense) for sense in SENSES]
        table.add_row(
            str(number),
            *("-" if instant is None else f"{instant:.4f}" for instant in instants),
            *(_ms(skew[0] / NS_PER_MS if skew else None, signed=True) for skew in skews),
        )
    return table


def _instant_s(event: Event, sense: str) -> float | None:
    found = event.perceived[sense]
    return None if found is None else round(found.instant_ns / 1e9, 6)


def _ms(value: float | None, *, signed: bool = False) -> str:
    if value is None:
        return "-"
    return f"{value:+.1f}" if signed else f"{value:.1f}"


def _plot(path: Path, pairs: Mapping[str, Sequence[float]], title: str) -> None:
    """How far apart the senses are, whichever comes first."""
    curves = {
        _WORDS[pair].replace(" after ", " and "): [abs(value) for value in values]
        for pair, values in pairs.items()
        if values
    }
    save(distributions({title: curves}, axis="skew (absolute value), ms"), path)
