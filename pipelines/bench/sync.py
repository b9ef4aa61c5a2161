"""`kontur-av bench sync`: the skew between sight, hearing and touch, measured by content.

It measures a session, on virtual time or live, or recordings of an LED, a click and a force.
"""

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import isfinite
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.detect import ClickDetector, LightDetector, Roi
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ
from pipelines.bench.session import live_session
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.model import ContentSkew, SyncReport
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json, titled_table
from pipelines.report.sync_matching import Matched, match_around
from pipelines.report.sync_metrics import PAIRS, SENSES, SensedEvent, skew_summary, skews_ns
from pipelines.session.option_rows import add_options
from pipelines.session.options import StreamOptions, setup_changes
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.sources import check_sources
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.simulate import simulate
from telepresence.haptics.step_detector import StepDetector

#: Whole pictures are scaled down to this width at most, and searched in this many columns of cells:
#: a real LED may be small.
_WIDEST = 1280
_COLUMNS = 160
#: A light or a click lies at most this far from the step that it belongs to.
_AROUND_NS = 750 * NS_PER_MS
#: A time stamp that differs by more than this from the count of samples is a jump in the recording.
_JUMP_NS = 5 * NS_PER_MS


def lights(path: Path, roi: Roi | None) -> list[Matched]:
    """The lights that come on in a video file. roi: pixels of the file's pictures.

    ConfigError if it cannot be read.
    """
    eye = LightDetector(roi=roi, columns=_COLUMNS)
    found: list[Matched] = []
    instants: set[int] = set()
    for instant_ns, frame in _decoded(path, "video"):
        assert isinstance(frame, av.VideoFrame)
        widest = _WIDEST
        if roi is not None:
            if roi.left + roi.width > frame.width or roi.top + roi.height > frame.height:
                size = f"{frame.width}x{frame.height}"
                raise ConfigError(f"--roi: the picture of {path} has {size} pixels")
            # A region is searched at the full resolution.
            widest = frame.width
        width = max(16, min(widest, frame.width) // 4 * 4)
        height = max(16, round(frame.height * width / frame.width) // 4 * 4)
        picture = frame.reformat(width=width, height=height, format="yuv420p").to_ndarray()
        eye.handle_picture(np.asarray(picture, np.uint8), instant_ns, instant_ns)
        instants.add(instant_ns)
        for light in iter(eye.next_event, None):
            slack_ns = light.instant_ns - light.previous_tag
            found.append(Matched(light.instant_ns, light.strength, slack_ns=slack_ns))
    if len(instants) < 4:
        raise ConfigError(f"{path}: it has fewer than 4 pictures with a time stamp")
    return found


def clicks(path: Path) -> list[Matched]:
    """The clicks in a file with sound. ConfigError if it cannot be read."""
    ear = ClickDetector()
    resampler = av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
    found: list[Matched] = []
    due_ns: int | None = None

    def hear(piece: av.AudioFrame) -> None:
        nonlocal due_ns
        at_ns = due_ns
        if piece.time is not None:
            told_ns = round(piece.time * NS_PER_S)
            if due_ns is None or abs(told_ns - due_ns) > _JUMP_NS:
                at_ns = told_ns
        samples = piece.to_ndarray().reshape(-1).astype(np.int16, copy=False)
        at_ns = at_ns or 0
        ear.handle_block(samples, at_ns, at_ns)
        due_ns = at_ns + len(samples) * NS_PER_S // AUDIO_CLOCK_HZ
        found.extend(
            Matched(click.instant_ns, click.strength) for click in iter(ear.next_event, None)
        )

    for _, frame in _decoded(path, "audio"):
        assert isinstance(frame, av.AudioFrame)
        for piece in resampler.resample(frame):
            hear(piece)
    for piece in resampler.resample(None):
        hear(piece)
    if due_ns is None:
        raise ConfigError(f"{path}: there is no sound in it")
    # Silence, so that a click at the very end is complete.
    ear.handle_block(np.zeros(AUDIO_CLOCK_HZ // 20, np.int16), due_ns, due_ns)
    found.extend(Matched(click.instant_ns, click.strength) for click in iter(ear.next_event, None))
    return found


def steps(path: Path) -> list[Matched]:
    """The steps in a table `time_s,force_n`. ConfigError, with the line, for a wrong table."""
    detector = StepDetector()
    rows = list(_rows(path))
    if len(rows) < 2:
        raise ConfigError(f"{path}: it has fewer than 2 rows of time_s,force_n")
    for (_, before_s, _), (line, after_s, _) in pairwise(rows):
        if after_s <= before_s:
            raise ConfigError(f"{path}: line {line}: time does not increase after {before_s:g} s")
    found: list[Matched] = []
    for _, time_s, force_n in rows:
        detector.handle_sample(round(time_s * NS_PER_S), force_n)
        while (step := detector.next_event()) is not None:
            found.append(Matched(step.instant_ns, step.rise_n))
    return found


def joined(found: dict[str, list[Matched]]) -> list[SensedEvent]:
    """Join what belongs to one event. found: by sense, at least two of light, click and force.

    Lights and clicks are joined to the force, or clicks to the light if there is no force; each to
    the nearest one.
    """
    reference = "force" if "force" in found else "light"
    instants = [one.instant_ns for one in found[reference]]
    matched = {
        sense: list(some)
        if sense == reference
        else match_around(instants, some, around_ns=_AROUND_NS)
        for sense, some in found.items()
    }
    return [
        SensedEvent(
            one.instant_ns,
            -1,
            {
                sense: matched[sense][index] if sense in matched else None
                for sense in ("light", "click", "force")
            },
        )
        for index, one in enumerate(found[reference])
    ]


def _decoded(path: Path, kind: str) -> Iterator[tuple[int, av.VideoFrame | av.AudioFrame]]:
    """Frames of the file's first stream of that kind, each with its instant (ns)."""
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    try:
        with av.open(str(path)) as container:
            streams = container.streams.video if kind == "video" else container.streams.audio
            if not streams:
                what = "picture" if kind == "video" else "sound"
                raise ConfigError(f"{path}: there is no {what} in it")
            for frame in container.decode(streams[0]):
                if isinstance(frame, av.VideoFrame | av.AudioFrame) and frame.time is not None:
                    yield round(frame.time * NS_PER_S), frame
    except (FFmpegError, OSError) as error:
        raise ConfigError(f"{path}: not a media file that can be read ({error.strerror})") from None


def _rows(path: Path) -> Iterator[tuple[int, float, float]]:
    """(line, time in s, force in N) of each row after the heading."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.reader(file)
            heading = next(table, [])
            if [name.strip() for name in heading[:2]] != ["time_s", "force_n"]:
                raise ConfigError(f"{path}: line 1: begin with the heading time_s,force_n")
            for row in table:
                if not row:
                    continue
                try:
                    time_s, force_n = float(row[0]), float(row[1])
                except (ValueError, IndexError):
                    time_s = force_n = float("nan")
                if not (isfinite(time_s) and isfinite(force_n)):
                    raise ConfigError(f"{path}: line {table.line_num}: give two numbers")
                yield table.line_num, time_s, force_n
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "no table of text"
        raise ConfigError(f"{path}: {reason}") from None


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
    add_options(
        session,
        "--setup NAME  spacejustin (default), taskboard or FILE.toml",
        "--seconds S <float>  how long (default 60; live 30)",
        "--live  on this machine, in real time",
        "--radio PROFILE  cable, clean (default), iss-pass, geo or FILE.toml",
        "--seed N <int=1>  of the radio's chances",
        "--base-port P <int=27000>  of a live session",
    )
    footage = parser.add_argument_group("recordings, at least two, instead of a session")
    add_options(
        footage,
        "--video FILE <Path>  an LED that lights up",
        "--audio FILE <Path>  a click; may be the same file",
        "--haptics FILE <Path>  CSV: time_s,force_n",
        "--offset-ms NAME=MS <*>  add MS to every instant of video, audio or haptics; may be "
        "given several times",
        "--roi X,Y,W,H  where the LED is, in pixels of the file; default all",
    )
    add_options(parser, "--report", "--plot FILE <Path>  draw the skews as PNG")


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
    setup = load_setup(name, changes=setup_changes(StreamOptions(radio=radio)))
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
    words = [f"{word}, ms" for word in _WORDS.values()]
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
