"""A report as a table for people."""

from collections.abc import Iterator, Mapping

from rich.console import Console
from rich.table import Table
from rich.text import Text

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.staleness import State
from pipelines.media.marking import age_words
from pipelines.report import model
from pipelines.report.link_report import clock_lines, direction_lines, end_line, peer_lines
from pipelines.report.result import fitted_line, fitted_table
from pipelines.report.terms import TERMS
from pipelines.session.task_journal import TaskRow

#: What stands where there is no sample.
NO_SAMPLE = "–"
#: The columns at the end, with the rank by which they are left out on a narrow terminal.
COLUMNS = {
    "stream": 0,
    "cap": 4,
    "mean": 5,
    "max 1 s": 3,
    "max 0.1 s": 9,
    "shown/s": 1,
    "lost": 2,
    "p50": 0,
    "p95": 7,
    "p99": 6,
    "max ms": 8,
}
#: Those of a running session.
LIVE_COLUMNS = {
    "stream": 0,
    "kbit/s": 1,
    "max 1 s": 6,
    "cap": 5,
    "shown": 4,
    "lost": 3,
    "latency ms": 2,
    "p99": 7,
    "age": 2,
}
#: What only a sender knows, and what only a receiver does.
_SENT = ("kbit/s", "mean", "max 1 s", "max 0.1 s")
_CAME = ("shown", "shown/s", "lost")
_COLOURS = {
    State.NOTHING: "",
    State.FRESH: "green",
    State.DAMAGED: "yellow",
    State.FROZEN: "yellow",
    State.STALE: "bold white on red",
}


def task_line(run: TaskRow) -> str:
    took = "" if run.seconds is None else f" after {run.seconds:.1f} s"
    why = f": {run.reason}" if run.reason else ""
    return f"task {run.name}, run {run.run}: {run.result.replace('_', ' ')}{took}{why}"


def silence_line(name: str, process: model.ProcessReport) -> str:
    """An input that gives nothing."""
    fault = f" ({process.source_fault})" if process.source_fault else ""
    return f"{name}: gave nothing in the last {process.silent_s or 0:.0f} s{fault}"


def print_summary(report: model.SessionReport | model.LinkReport, console: Console) -> None:
    """The streams, the link, the senses and the cost."""
    console.print(Text(first_line(report, console.width), "bold"))
    if isinstance(report, model.SessionReport):
        console.print(streams_table(report, console.width))
    lines = [*_link_lines(report)]
    if isinstance(report, model.SessionReport):
        lines += [*_senses_lines(report), *_session_lines(report)]
    for line in [*lines, *_cost_lines(report)]:
        console.print(Text(line), soft_wrap=True)
    for warning in report.warnings:
        line = f"{warning.where}: {warning.measured}; {warning.fix}"
        console.print(Text.assemble(("warning: ", "bold yellow"), line), soft_wrap=True)
    for failure in report.failures:
        console.print(Text.assemble(("failed: ", "bold red"), failure), soft_wrap=True)


def _link_lines(report: model.SessionReport | model.LinkReport) -> Iterator[str]:
    for direction, link in report.link.items():
        yield from direction_lines(direction, link)
    for end, gateway in report.gateways.items():
        yield end_line(end, gateway)
        yield from peer_lines(end, gateway)
    yield from clock_lines(report.gateways)


def _senses_lines(report: model.SessionReport) -> Iterator[str]:
    errors_ms = [stream.latency_error_ms or 0.0 for stream in report.streams.values()]
    if any(errors_ms):
        yield f"latencies between the machines may be wrong by {max(errors_ms):.2f} ms"
    if skews := _skews(report.skew_ms):
        yield f"skew at the operator, ms: {skews}"
    if stages := stages_line(report):
        yield stages
    if (sync := report.sync) is not None:
        senses = ", ".join(
            f"{sense} {metrics.latency_ms.p50:.1f} ({metrics.perceived})"
            for sense, metrics in sync.senses.items()
            if metrics is not None and metrics.perceived
        )
        line = f"by content, ms after each of {sync.events} contacts: {senses}"
        if senses:
            yield f"{line}; skew: {skews}" if (skews := _skews(sync.skew_ms)) else line
    yield from map(task_line, report.tasks or ())
    if (together := report.lip_sync) is not None:
        yield (
            f"lip-sync (ITU-R BT.1359): {100 * together.within:.1f} % of the time within, sound "
            f"too early {100 * together.early:.1f} %, too late {100 * together.late:.1f} %"
        )


def _session_lines(report: model.SessionReport) -> Iterator[str]:
    for name, stream in report.streams.items():
        shown = stream.display
        intervals = ", ".join(
            f"{word} {lasted_ns / NS_PER_MS:.0f} ms ({episodes} times)"
            for word, lasted_ns, episodes in (
                ("stale", shown.stale_ns, shown.stale_episodes),
                ("frozen", shown.frozen_ns, shown.frozen_episodes),
                ("damaged", shown.damaged_ns, shown.damaged_episodes),
            )
            if lasted_ns and (stream.video or word == "stale")
        )
        if intervals:
            yield f"{name}: {intervals}"
    if report.stopped_s:
        stopped_s = report.seconds - report.running_s
        yield f"stopped on request: {stopped_s:.1f} s ({len(report.stopped_s)} times)"
    for name, process in report.processes.items():
        if process.silent_s is not None:
            yield silence_line(name, process)
    if (recorded := report.recorder) is not None:
        parts = f" in {recorded.parts} parts" if recorded.parts > 1 else ""
        yield f"recorded: {recorded.messages} messages, {recorded.octets / 1e6:.1f} MB{parts}"


def _cost_lines(report: model.SessionReport | model.LinkReport) -> Iterator[str]:
    cpu = report.cpu
    restarted = [name for name, process in report.processes.items() if process.restarts]
    if cpu.total_s:  # virtual time costs nothing
        yield (
            f"CPU: {cpu.total_s:.1f} s, {cpu.cores_used:.2f} of a core in "
            f"{len(report.processes)} processes"
            + (f"; restarted: {', '.join(restarted)}" if restarted else "")
        )


def first_line(report: model.SessionReport | model.LinkReport, width: int) -> str:
    """The setup, how long the session ran, its radio, and the link's last state."""
    end, first = next(iter(report.gateways.items()))
    parts = [f"{report.setup}, {report.seconds:.1f} s"]
    if len(report.gateways) == 1:
        parts.insert(1, f"the {end} end alone")
    if first.supervision is not None:
        parts.append(f"link {first.supervision.state}")
    if radio := report.radio if isinstance(report, model.LinkReport) else first.channel:
        parts.append(f"radio {radio.profile}")
    return fitted_line(parts, width)


def streams_table(
    report: model.SessionReport, width: int, columns: Mapping[str, int] = COLUMNS
) -> Table:
    """A row for each stream and each direction of haptics; columns that fit `width`."""
    rows = [
        *(_stream_cells(name, stream) for name, stream in report.streams.items()),
        *(
            _haptic_cells(f"haptic_{name}", haptic, report.running_s)
            for name, haptic in report.haptic.items()
        ),
    ]
    return fitted_table(columns, [[row[name] for name in columns] for row in rows], width)


def _stream_cells(name: str, stream: model.StreamReport) -> dict[str, str | Text]:
    error = f" ± {stream.latency_error_ms:.1f}" if stream.latency_error_ms else ""
    newest = NO_SAMPLE if stream.newest_ms is None else f"{stream.newest_ms:.1f}{error}"
    state, age_ns = stream.display.state, stream.display.age_ns
    age = NO_SAMPLE if state is State.NOTHING else f"{age_words(age_ns)} {state.value}"
    largest = Text(kbps(stream.payload_bps_max_1s), "bold red" if stream.above_cap_bps else "green")
    return {
        "stream": name,
        "cap": f"{stream.cap_bps / 1000:g}",
        "kbit/s": kbps(stream.rate_bps),
        "mean": kbps(stream.payload_bps_mean),
        "max 1 s": largest,
        "max 0.1 s": kbps(stream.payload_bps_max_100ms),
        "shown": str(stream.display.frames_displayed),
        "shown/s": f"{stream.displayed_hz:.1f}",
        "lost": str(stream.rtp.rtp_lost),
        "latency ms": newest,
        "age": Text(age, _COLOURS[state]),
        **_percentiles(stream.latency_ms),
        **_unknown(stream.side),
    }


def _haptic_cells(name: str, haptic: model.HapticReport, seconds: float) -> dict[str, str | Text]:
    percentiles = _percentiles(haptic.latency_ms)
    return {
        "stream": name,
        "cap": f"{haptic.cap_bps / 1000:g}",
        "kbit/s": kbps(haptic.rate_bps),
        "mean": kbps(haptic.payload_bps_mean),
        "shown": str(haptic.receiver.received),
        "shown/s": f"{haptic.receiver.received / max(seconds, 1e-9):.1f}",
        "lost": str(haptic.receiver.lost),
        "latency ms": percentiles["p50"],
        **percentiles,
        # Rates are those of received samples.
        **({} if haptic.side != "sender" else dict.fromkeys((*_SENT, *_CAME), NO_SAMPLE)),
        **dict.fromkeys(("max 1 s", "max 0.1 s", "age"), ""),
    }


def _unknown(side: str | None) -> dict[str, str]:
    """The cells that only the other machine knows."""
    missing = {None: (), "sender": _CAME, "receiver": _SENT}[side]
    return dict.fromkeys(missing, NO_SAMPLE)


def _percentiles(latency: model.Spread) -> dict[str, str]:
    values = {"p50": latency.p50, "p95": latency.p95, "p99": latency.p99, "max ms": latency.max}
    return {name: f"{ms:.1f}" if latency.count else NO_SAMPLE for name, ms in values.items()}


def kbps(bps: float | None) -> str:
    return NO_SAMPLE if bps is None else f"{bps / 1000:.1f}"


def stages_line(report: model.SessionReport) -> str:
    """Where the time of the uplink's picture goes, mean of an event; empty without pictures."""
    if report.video_lead is None:
        return ""
    video = report.video_lead.video_ms
    terms = ((name, getattr(video, name)) for name in TERMS)
    parts = ", ".join(f"{name} {ms:.0f}" for name, ms in terms if round(ms))
    return f"uplink picture {video.total:.0f} ms: {parts}"


def _skews(skews: Mapping[str, model.SkewReport | model.ContentSkew | None]) -> str:
    return ", ".join(
        f"{name.replace('_', ' to ')} {skew.p50:+.1f} (p95 {skew.p95:+.1f})"
        for name, skew in skews.items()
        if skew is not None
    )
