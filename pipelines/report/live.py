"""What a running session shows: a live table on a terminal, else one line a second."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Self

from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.staleness import State
from pipelines.media.marking import age_words
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.report.collector import Collector
from pipelines.report.link_report import build_link_report, clock_lines, peer_words, state_words
from pipelines.report.model import LinkReport, SessionReport
from pipelines.report.report_file import WordsConsole
from pipelines.report.result import fitted_line
from pipelines.report.session_feed import SessionFeed, processes_now
from pipelines.report.silence import NO_PAGE
from pipelines.report.summary import LIVE_COLUMNS, NO_SAMPLE, kbps, silence_line, streams_table
from pipelines.session.launcher import Launcher, launcher_cpu_s
from pipelines.session.session_switch import Activity
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Next, Situation, Why, of_both
from pipelines.session.topology.topics import CONSOLE, SELECTOR

#: The keys of the ledger whose rates stand in a line of the link.
_LEVELS = ("haptic", "tmtc", "voice", "video", "maintenance")


class LiveView:
    """Shows what a launcher runs, once a second.

    Use it as a context around the run, and pass its `show` to the launcher.
    table: what a terminal shows, of a width. line: what is printed where there is no terminal.
    """

    def __init__(
        self,
        table: Callable[[Launcher, int], RenderableType],
        line: Callable[[Launcher], str],
        *,
        quiet: bool = False,
    ) -> None:
        self._table, self._line, self._quiet = table, line, quiet
        self._console = console = WordsConsole(width=80)
        # No thread of rich's: the launcher forks.
        shown = console.is_terminal and not quiet
        self._live = Live(console=console, auto_refresh=False) if shown else None

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
            self._live.update(self._table(launcher, self._console.width), refresh=True)
        elif not self._quiet:
            print(self._line(launcher), flush=True)


def session_view(feed: SessionFeed, *, quiet: bool = False, verbose: bool = False) -> LiveView:
    """The view of a session whose reports `feed` makes."""
    return LiveView(
        lambda launcher, width: session_table(
            launcher, feed.report(launcher), width, verbose=verbose
        ),
        lambda launcher: session_line(launcher, feed.report(launcher)),
        quiet=quiet,
    )


def session_table(
    launcher: Launcher, report: SessionReport, width: int, *, verbose: bool = False
) -> Group:
    """The streams, the path to the other machine, inputs, recording and processes."""
    path, now = path_line(report), situation_line(report)
    return Group(
        Text(first_line(launcher, report, width), "bold"),
        *([Text(now, "yellow")] * bool(now and _runs(launcher))),
        streams_table(report, width, LIVE_COLUMNS),
        *([Text(path, "bold red" if "NOT PROTECTED" in path else "dim")] * bool(path)),
        *(Text(line, "dim") for line in clock_lines(report.gateways)),
        *(_inputs(report) if _runs(launcher) else ()),
        *(Text(line, "bold red" if bad else "dim") for line, bad in _outlets(report)),
        _processes(launcher, verbose=verbose),
    )


def first_line(launcher: Launcher, report: SessionReport, width: int) -> str:
    """The session's name and time, the link's state, radio and camera, as many of them as fit."""
    link = next(iter(report.gateways.values())).supervision
    parts = [
        f"{launcher.session}   {report.seconds:.0f} s",
        f"link {'starting' if link is None else link.state}"
        if _runs(launcher)
        else "stopped from a page",
        f"radio {launcher.setup.radio_profile.name}",
    ]
    if "selector" in report.processes:
        selected = report.processes["selector"].newest.get("selected", NO_SAMPLE)
        parts.append(f"camera {selected}")
    return fitted_line(parts, width)


def path_line(report: SessionReport) -> str:
    """The path to the other machine; empty if both ends are here."""
    if report.end is None:
        return ""
    peer = report.gateways[report.end].peer
    return f"{report.end} end alone: {'starting' if peer is None else peer_words(peer)}"


def situation_line(report: SessionReport) -> str:
    """What keeps the hand from moving the robot, and what to do next; empty if nothing does."""
    told = of_both(*(_situation(report, process) for process in (CONSOLE, SELECTOR)))
    return "" if told is None or told.may else told.words


def _situation(report: SessionReport, process: str) -> Situation | None:
    newest = report.processes[process].newest if process in report.processes else {}
    if not newest.get("situation"):
        return None
    why, reason, advice = (str(newest[name]) for name in ("situation", "reason", "advice"))
    return Situation(Why(why), reason, Next.WAIT, advice)


def _runs(launcher: Launcher) -> bool:
    return launcher.switch.activity is Activity.RUNNING


def _inputs(report: SessionReport) -> Iterator[Text]:
    """The inputs that deliver nothing, and those that had a fault and deliver again."""
    for name, process in report.processes.items():
        if process.silent_s is not None:
            waits = process.source_fault == NO_PAGE
            yield Text(silence_line(name, process), "dim" if waits else "bold red")
        elif process.source_fault:
            yield Text(f"{name}: {process.source_fault}", "yellow")


def _outlets(report: SessionReport) -> Iterator[tuple[str, bool]]:
    """A line of the leg to a partner and of the recording, and whether it is bad news."""
    if report.rtc is not None and (leg := report.rtc.metrics).partners:
        trip_ns = leg.round_trip_ns
        trip = "" if trip_ns is None else f", round trip {trip_ns / NS_PER_MS:.0f} ms"
        route = "" if leg.route is None else f" by {leg.route}"
        rate = f"{leg.rate_bps / 1000:g} kbit/s"
        yield f"partner: {leg.partners} connections{route}{trip}, picture at {rate}", False
    if report.recorder is not None and report.recorder.recording:
        yield _recording(report.recorder), _is_bad(report.recorder)


def _recording(recorder: RecorderMetrics) -> str:
    line = f"recording to {recorder.file}, {recorder.octets / 1e6:.1f} MB"
    line += f", {recorder.lost} messages lost" if recorder.lost else ""
    return line + (f": {recorder.fault}" if recorder.fault else "")


def _is_bad(recorder: RecorderMetrics) -> bool:
    return bool(recorder.recording and (recorder.lost or recorder.fault))


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


def session_line(launcher: Launcher, report: SessionReport) -> str:
    """One line of the same, for a log."""
    parts, runs = [f"{report.seconds:6.1f} s"], _runs(launcher)
    for name, stream in report.streams.items():
        sent = f" {kbps(stream.rate_bps)}/{stream.cap_bps / 1000:g} kbit/s"
        came = f" {stream.display.frames_displayed} shown {stream.rtp.rtp_lost} lost"
        error = f" ± {stream.latency_error_ms:.1f}" if stream.latency_error_ms else ""
        newest = NO_SAMPLE if stream.newest_ms is None else f"{stream.newest_ms:.0f}"
        came += f" {newest}{error} ms"
        parts.append(name + {None: sent + came, "sender": sent, "receiver": came}[stream.side])
        if stream.display.state is State.STALE and runs:
            parts[-1] += f" STALE {age_words(stream.display.age_ns)}"
    for name, haptic in report.haptic.items():
        samples = haptic.receiver
        came = f"haptic_{name} {samples.received} received {samples.lost} lost"
        if haptic.side != "sender":
            late = "" if haptic.side else f" {haptic.latency_ms.p50:.1f} ms"
            parts.append(came + late)
    if path := path_line(report):
        parts.append(path)
    parts += clock_lines(report.gateways)
    if not runs:
        return "  ".join([*parts, "stopped from a page"])
    if now := situation_line(report):
        parts.append(now)
    silent = report.processes.items()
    parts += [silence_line(name, each) for name, each in silent if each.silent_s is not None]
    if report.recorder is not None and _is_bad(report.recorder):
        parts.append(_recording(report.recorder))
    if down := [child.row.name for child in launcher.children if child.pid is None]:
        parts.append("down: " + ", ".join(down))
    return "  ".join(parts)


class LinkLines:
    """For each end of a link its state, what it sends by level, and what it lost.

    Rates are those since the lines before.
    """

    def __init__(self) -> None:
        #: By end: its octets at the last line, by what they carried.
        self._seen: dict[str, Mapping[str, int]] = {}

    def lines(self, report: LinkReport, width: int | None = None) -> list[str]:
        """width: a line's length in characters; parts without room are left out."""
        head, found = f"{report.seconds:6.1f} s  ", []
        for end in report.ends:
            found.append(head + self._end(report, Segment(end), width and width - len(head)))
            head = " " * len(head)
        return found

    def _end(self, report: LinkReport, end: Segment, width: int | None) -> str:
        gateway = report.gateways[end.value]
        if gateway.supervision is None:
            return f"{end.value}: starting"
        out = report.link[end.transmits.value]
        received = report.link[end.peer.transmits.value].receiver
        before, octets = self._seen.get(end.value, {}), out.sender.octets
        self._seen[end.value] = octets
        # Every slot has a frame, so shares of its octets are exact even if the figures come late.
        passed = max(1, sum(octets.values()) - sum(before.values()))
        kbps_an_octet = out.sender.capacity_bps / 1000 / passed
        rates = {name: octets.get(name, 0) - before.get(name, 0) for name in _LEVELS}
        levels = [f"{name} {count * kbps_an_octet:.1f}" for name, count in rates.items()]
        unknown_senders = sum(gateway.sockets.unknown_senders.values())
        parts = [
            f"{end.value} {state_words(gateway.supervision)}",
            *([] if gateway.peer is None else [peer_words(gateway.peer)]),
            f"heard {received.frames_received} frames, {received.frames_lost} lost",
            f"{out.loop.slips} slips",
            *([f"{unknown_senders} unknown senders"] if unknown_senders else []),
            f"sends kbit/s {' '.join(levels)}",
            *clock_lines({end.value: gateway}),
        ]
        return fitted_line(parts, width, gap=", ")


def link_view(
    collector: Collector, ends: Sequence[Segment], *, seed: int, quiet: bool = False
) -> LiveView:
    """The view of `kontur-av link`."""
    shown = LinkLines()

    def lines(launcher: Launcher, width: int | None = None) -> list[str]:
        report = link_report_of(launcher, collector, ends, seed=seed)
        return shown.lines(report, width)

    return LiveView(
        lambda launcher, width: Group(*map(Text, lines(launcher, width - 1))),
        lambda launcher: "  ".join(lines(launcher)),
        quiet=quiet,
    )


def link_report_of(
    launcher: Launcher, collector: Collector, ends: Sequence[Segment], *, seed: int
) -> LinkReport:
    """The report of the link that `launcher` runs or has run, until now."""
    return build_link_report(
        collector,
        ends,
        seconds=launcher.seconds,
        seed=seed,
        processes=processes_now(launcher, collector, most_restarts=0),
        launcher_cpu_s=launcher_cpu_s(),
    )
