"""What a running session shows: a live table on a terminal, else one line a second."""

import shutil
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Self

from rich.columns import Columns
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import Histogram
from kontur_av.streams.staleness import State
from pipelines.media.marking import age_words
from pipelines.report.collector import Collector
from pipelines.report.journeys import StreamMetrics
from pipelines.report.link_report import LinkView, peer_words
from pipelines.report.report_file import WordsConsole
from pipelines.report.result import fitted_line, fitted_table
from pipelines.report.sections import clock_lines, recording_line, rtc_line
from pipelines.report.session_report import haptic_cap_bps, latency_ms
from pipelines.report.silence import last_bps, shown_now, silences
from pipelines.report.summary import NO_SAMPLE
from pipelines.session.command_process import OwnOutput, plain, say
from pipelines.session.launcher import Launcher
from pipelines.session.session_switch import Activity
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topology.rows import HapticRow
from telepresence.haptics.haptic_metrics import SamplesReceived
from telepresence.link.link_metrics import PeerMetrics

#: The columns, with the rank by which they are left out on a narrow terminal.
_COLUMNS = {
    "stream": 0,
    "kbit/s": 1,
    "max 1 s": 6,
    "cap": 5,
    "shown": 4,
    "lost": 3,
    "latency ms": 2,
    "p99 ms": 7,
    "age": 2,
}
_COLOURS = {
    State.FRESH: "green",
    State.DAMAGED: "yellow",
    State.FROZEN: "yellow",
    State.STALE: "bold white on red",
}


class LiveView:
    """Shows a launcher's session, whose figures `collector` collects.

    Use it as a context around the run, and pass its `show` to the launcher.
    """

    def __init__(self, collector: Collector, *, quiet: bool = False, verbose: bool = False) -> None:
        self._collector = collector
        self._console = WordsConsole(width=80)
        self._quiet = quiet
        self._verbose = verbose
        # No thread of rich's: the launcher forks.
        self._live = (
            Live(console=self._console, auto_refresh=False)
            if self._console.is_terminal and not quiet
            else None
        )

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        # A closed terminal cannot take a last table, but the report must still be written.
        with suppress(OSError):
            if self._live is not None:
                self._live.stop()

    def show(self, launcher: Launcher) -> None:
        if self._live is not None:
            path = path_line(self._collector)
            self._live.update(
                Group(
                    Text(first_line(launcher, self._collector, self._console.width), "bold"),
                    streams_table(launcher, self._collector, self._console.width),
                    *([Text(path, "bold red" if "NOT PROTECTED" in path else "dim")] * bool(path)),
                    *(Text(line, "dim") for line in clock_lines(self._collector)),
                    *_inputs(launcher, self._collector),
                    *_recording(self._collector),
                    _processes(launcher, verbose=self._verbose),
                ),
                refresh=True,
            )
        elif not self._quiet:
            print(_line(launcher, self._collector), flush=True)


def first_line(launcher: Launcher, collector: Collector, width: int) -> str:
    """The session's name and time, the link's state, radio and camera, as many of them as fit."""
    topology = collector.topology
    link = collector.gateway(topology.segments[0]).link
    state = "starting" if link is None else link.supervision.state
    parts = [
        f"{launcher.session}   {launcher.seconds:.0f} s",
        f"link {state}" if _runs(launcher) else "stopped from a page",
        f"radio {launcher.setup.radio_profile.name}",
    ]
    if topology.runs("selector"):
        parts.append(f"camera {collector.process('selector').selected or NO_SAMPLE}")
    return fitted_line(parts, width)


def path_line(collector: Collector) -> str:
    """The path to the other machine; empty if both ends are here."""
    alone = collector.topology.alone
    if alone is None:
        return ""
    peer = collector.gateway(alone).find(PeerMetrics)
    return f"{alone.value} end alone: {'starting' if peer is None else peer_words(peer)}"


def _runs(launcher: Launcher) -> bool:
    return launcher.switch.activity is Activity.RUNNING


def streams_table(launcher: Launcher, collector: Collector, width: int) -> Table:
    """A row for each stream and each direction of haptics; columns that fit `width`."""
    rows = [
        *(_stream_row(launcher, collector, stream) for stream in launcher.setup.streams),
        *(_haptic_row(launcher, collector, row) for row in collector.topology.haptics),
    ]
    return fitted_table(_COLUMNS, rows, width)


def _stream_row(
    launcher: Launcher, collector: Collector, stream: VideoStream | VoiceStream
) -> list[str | Text]:
    metrics = collector.streams[stream.name]
    row = collector.topology.media(stream.name)
    side = collector.topology.side_here(row)
    newest = latency_ms(metrics)
    largest = metrics.rate.max_bps(NS_PER_S)
    cells: list[str | Text] = [
        stream.name,
        f"{last_bps(metrics.rate, launcher.clock.now_ns()) / 1000:.1f}",
        Text(f"{largest / 1000:.1f}", "bold red" if metrics.above_cap_bps[0] > 0 else "green"),
        f"{stream.cap_bps / 1000:g}",
        str(collector.shown(stream.name).frames_displayed),
        str(collector.received(stream.name).rtp_lost),
        NO_SAMPLE if newest is None else f"{newest:.1f}{_error(metrics)}",
        _percentile_ms(metrics.latency, 99),
        _age(launcher, collector, stream),
    ]
    return _known(cells, sent=(1, 2), came=(4, 5), side=side)


def _known(
    cells: list[str | Text], *, sent: tuple[int, ...], came: tuple[int, ...], side: str | None
) -> list[str | Text]:
    """The cells of a row; a dash for those whose side is on another machine."""
    missing = {None: (), "sender": came, "receiver": sent}[side]
    return [NO_SAMPLE if at in missing else cell for at, cell in enumerate(cells)]


def _haptic_row(launcher: Launcher, collector: Collector, row: HapticRow) -> list[str | Text]:
    metrics = collector.haptics[row.key]
    samples = collector.process(row.receiver).total(SamplesReceived)
    profile = launcher.setup.profile(row.direction)
    cells: list[str | Text] = [
        f"haptic_{row.key}",
        f"{last_bps(metrics.rate, launcher.clock.now_ns()) / 1000:.1f}",
        "",
        f"{haptic_cap_bps(profile) / 1000:g}",
        str(samples.received),
        str(samples.lost),
        _percentile_ms(metrics.latency, 50),
        _percentile_ms(metrics.latency, 99),
        "",
    ]
    return _known(cells, sent=(), came=(1, 4, 5), side=collector.topology.side_here(row))


def _error(metrics: StreamMetrics) -> str:
    """How far a latency between two machines may be wrong, in ms; empty on one machine."""
    return f" ± {metrics.error_ns / NS_PER_MS:.1f}" if metrics.error_ns else ""


def _percentile_ms(histogram: Histogram, percent: float) -> str:
    if not histogram.count:
        return NO_SAMPLE
    return f"{histogram.percentile(percent) / NS_PER_MS:.1f}"


def _age(launcher: Launcher, collector: Collector, stream: VideoStream | VoiceStream) -> Text:
    """How old what is shown is, with a word and a colour."""
    now_ns = launcher.clock.now_ns()
    state, age_ns = shown_now(stream, collector, now_ns)
    if state is State.NOTHING:
        return Text(NO_SAMPLE)
    return Text(f"{age_words(age_ns)} {state.value}", _COLOURS[state])


def _inputs(launcher: Launcher, collector: Collector) -> list[Text]:
    """The inputs that deliver nothing, and those that had a fault and deliver again."""
    setup = launcher.setup
    if not _runs(launcher):
        return []
    silent = silences(collector, launcher.clock.now_ns())
    lines = [Text(str(silence), "dim" if silence.waits else "bold red") for silence in silent]
    for name in setup.inputs:
        process = collector.topology.input(name).process
        fault = collector.process(process).capture.source_fault
        if fault and all(silence.process != process for silence in silent):
            lines.append(Text(f"{process}: {fault}", "yellow"))
    return lines


def _recording(collector: Collector) -> list[Text]:
    partner, line = rtc_line(collector), recording_line(collector)
    lines = [] if partner is None else [Text(partner, "dim")]
    if line is None:
        return lines
    text, bad = line
    return [*lines, Text(text, "bold red" if bad else "dim")]


def _processes(launcher: Launcher, *, verbose: bool) -> Columns:
    texts = []
    seconds = max(launcher.seconds, 1e-9)
    for child in launcher.children:
        text = Text("● ", "green" if child.pid is not None else "bold red")
        text.append(child.row.name, "default")
        if verbose or child.restarts:
            text.append(f" {100 * child.cpu_s() / seconds:.0f} %", "dim")
        if child.restarts:
            text.append(f" ({child.restarts} restarts: {child.last_error})", "yellow")
        texts.append(text)
    return Columns(texts, padding=(0, 2))


def _line(launcher: Launcher, collector: Collector) -> str:
    parts = [f"{launcher.seconds:6.1f} s"]
    topology, now_ns = collector.topology, launcher.clock.now_ns()
    for stream in launcher.setup.streams:
        metrics = collector.streams[stream.name]
        sent = f" {last_bps(metrics.rate, now_ns) / 1000:.1f}/{stream.cap_bps / 1000:g} kbit/s"
        lost = collector.received(stream.name).rtp_lost
        came = f" {collector.shown(stream.name).frames_displayed} shown {lost} lost"
        newest = latency_ms(metrics)
        late = f" {NO_SAMPLE if newest is None else f'{newest:.0f}'}{_error(metrics)} ms"
        known = {None: sent + came + late, "sender": sent, "receiver": came + late}
        parts.append(stream.name + known[topology.side_here(topology.media(stream.name))])
        state, age_ns = shown_now(stream, collector, now_ns)
        if state is State.STALE and _runs(launcher):
            parts[-1] += f" STALE {age_words(age_ns)}"
    for haptic in topology.haptics:
        side = topology.side_here(haptic)
        samples = collector.process(haptic.receiver).total(SamplesReceived)
        late_ms = collector.haptics[haptic.key].latency.percentile(50) / 1e6
        came = f"haptic_{haptic.key} {samples.received} received {samples.lost} lost"
        if side != "sender":
            parts.append(came if side == "receiver" else f"{came} {late_ms:.1f} ms")
    if path := path_line(collector):
        parts.append(path)
    parts += clock_lines(collector)
    if not _runs(launcher):
        return "  ".join([*parts, "stopped from a page"])
    parts += map(str, silences(collector, now_ns))
    if (recording := recording_line(collector)) is not None and recording[1]:
        parts.append(recording[0])
    if down := [child.row.name for child in launcher.children if child.pid is None]:
        parts.append("down: " + ", ".join(down))
    return "  ".join(parts)


class LinkScreen:
    """Standard output: on a terminal the lines of figures are overwritten in place."""

    def __init__(self, view: LinkView, collector: Collector, *, quiet: bool) -> None:
        self._view = view
        self._collector = collector
        self._quiet = quiet
        self._terminal = sys.stdout.isatty()
        self._shown = 0

    def show(self, launcher: Launcher) -> None:
        if self._quiet:
            return
        width = shutil.get_terminal_size().columns - 1 if self._terminal else None
        lines = self._view.lines(self._collector, launcher.seconds, width)
        if not self._terminal:
            print("  ".join(lines), flush=True)
            return
        up = f"\x1b[{self._shown}A" if self._shown else ""
        text = up + "".join(f"\x1b[K{plain(line)[:width]}\n" for line in lines)
        print(text, end="", file=OwnOutput(sys.stdout), flush=True)
        self._shown = len(lines)

    def show_lines(self, lines: Sequence[str]) -> None:
        if not self._quiet:
            say("\n".join(lines))
