"""A report as a table for people."""

from collections.abc import Mapping

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from kontur_av.clock import NS_PER_MS
from pipelines.report import model
from pipelines.report.link_report import end_line, ledger_line, peer_lines
from pipelines.report.result import fitted_line, fitted_table
from pipelines.report.sections import clock_words
from pipelines.report.terms import TERMS
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import TaskRow

#: What stands where there is no sample.
NO_SAMPLE = "–"
#: The columns, with the rank by which they are left out on a narrow terminal.
_COLUMNS = {
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


def task_line(run: TaskRow) -> str:
    took = "" if run.seconds is None else f" after {run.seconds:.1f} s"
    why = f": {run.reason}" if run.reason else ""
    return f"task {run.name}, run {run.run}: {run.result.replace('_', ' ')}{took}{why}"


def print_summary(report: model.SessionReport, console: Console) -> None:
    """The streams, the senses and the cost."""
    console.print(Text(first_line(report, console.width), "bold"))
    console.print(streams_table(report, console.width))
    for direction, link in report.link.items():
        if report.end is None:
            line = f"{link.sender.frames} frames, {link.receiver.frames_lost} lost, "
            line += f"{link.loop.slips} slips"
            console.print(f"{direction}: {line}; {ledger_line(link)}")
        elif link.sender.frames:
            line = f"{link.sender.frames} frames sent, {link.loop.slips} slips"
            console.print(f"{direction}: {line}; {ledger_line(link)}")
        else:
            console.print(f"{direction}: {link.receiver.frames_lost} frames lost")
    for end, gateway in report.gateways.items():
        console.print(end_line(end, gateway))
        for line in peer_lines(end, gateway):
            console.print(line, highlight=False)
        if gateway.clock is not None:
            console.print(clock_words(Segment(end).peer.value, gateway.clock), highlight=False)
    errors_ms = [
        stream.latency_error_ms
        for stream in report.streams.values()
        if stream.latency_error_ms is not None
    ]
    if errors_ms:
        console.print(f"latencies between the machines may be wrong by {max(errors_ms):.2f} ms")
    skews = _skews(report.skew_ms)
    if skews:
        console.print("skew at the operator, ms: " + ", ".join(skews))
    stages = stages_line(report)
    if stages:
        console.print(stages, highlight=False)
    _print_content(console, report.sync)
    for run in report.tasks or ():
        console.print(task_line(run), highlight=False)
    together = report.lip_sync
    if together is not None:
        console.print(
            f"lip-sync (ITU-R BT.1359): {100 * together.within:.1f} % of the time within, sound "
            f"too early {100 * together.early:.1f} %, too late {100 * together.late:.1f} %"
        )
    for name, stream in report.streams.items():
        spells = ", ".join(
            f"{word} {spell_ns / NS_PER_MS:.0f} ms ({episodes} times)"
            for word, spell_ns, episodes in (
                ("stale", stream.display.stale_ns, stream.display.stale_episodes),
                ("frozen", stream.display.frozen_ns, stream.display.frozen_episodes),
                ("damaged", stream.display.damaged_ns, stream.display.damaged_episodes),
            )
            if spell_ns and (stream.video or word == "stale")
        )
        if spells:
            console.print(f"{name}: {spells}")
    if report.stopped_s:
        stopped_s = report.seconds - report.running_s
        console.print(f"stopped on request: {stopped_s:.1f} s ({len(report.stopped_s)} times)")
    if report.simulation is None:  # virtual time costs nothing
        cpu = report.cpu
        restarted = [name for name, entry in report.processes.items() if entry.restarts]
        console.print(
            f"CPU: {cpu.total_s:.1f} s, {cpu.cores_used:.2f} of a core in "
            f"{len(report.processes)} processes"
            + (f"; restarted: {', '.join(restarted)}" if restarted else "")
        )
    for name, entry in report.processes.items():
        if entry.silent_s is not None:
            fault = f" ({entry.source_fault})" if entry.source_fault else ""
            console.print(f"{name}: gave nothing in the last {entry.silent_s} s{escape(fault)}")
    recorded = report.recorder
    if recorded is not None:
        parts = f" in {recorded.parts} parts" if recorded.parts > 1 else ""
        console.print(
            f"recorded: {recorded.messages} messages, {recorded.octets / 1e6:.1f} MB{parts}"
        )
    for warning in report.warnings:
        line = f"{warning.where}: {warning.measured}; {warning.fix}"
        console.print(f"[bold yellow]warning:[/] {escape(line)}", highlight=False)
    for failure in report.failures:
        console.print(f"[bold red]failed:[/] {escape(failure)}", highlight=False)


def first_line(report: model.SessionReport, width: int) -> str:
    """The setup, how long the session ran, its radio, and the link's last state."""
    first = next(iter(report.gateways.values()))
    parts = [f"{report.setup}, {report.seconds:.1f} s"]
    if report.end is not None:
        parts.insert(1, f"the {report.end} end alone")
    if first.supervision is not None:
        parts.append(f"link {first.supervision.state}")
    if first.channel is not None:
        parts.append(f"radio {first.channel.profile}")
    return fitted_line(parts, width)


def streams_table(report: model.SessionReport, width: int) -> Table:
    """A row for each stream and each direction of haptics; columns that fit `width`."""
    rows = [
        *([name, *_stream_cells(stream)] for name, stream in report.streams.items()),
        *(
            [f"haptic_{name}", *_haptic_cells(haptic, report.running_s)]
            for name, haptic in report.haptic.items()
        ),
    ]
    return fitted_table(_COLUMNS, rows, width)


def _stream_cells(stream: model.StreamReport) -> list[str]:
    sent = [stream.payload_bps_mean, stream.payload_bps_max_1s, stream.payload_bps_max_100ms]
    return [
        _kbps(stream.cap_bps),
        *(NO_SAMPLE if stream.side == "receiver" else _kbps(bps) for bps in sent),
        NO_SAMPLE if stream.side == "sender" else f"{stream.displayed_hz:.1f}",
        NO_SAMPLE if stream.side == "sender" else str(stream.rtp.rtp_lost),
        *_latency_cells(stream.latency_ms),
    ]


def _haptic_cells(haptic: model.HapticReport, seconds: float) -> list[str]:
    felt = [
        _kbps(haptic.payload_bps_mean),
        "",
        "",
        f"{haptic.receiver.received / max(seconds, 1e-9):.1f}",
        str(haptic.receiver.lost),
    ]
    return [
        _kbps(haptic.cap_bps),
        *(felt if haptic.side != "sender" else [NO_SAMPLE, "", "", NO_SAMPLE, NO_SAMPLE]),
        *_latency_cells(haptic.latency_ms),
    ]


def _latency_cells(latency: model.Spread) -> list[str]:
    values = latency.p50, latency.p95, latency.p99, latency.max
    return [f"{value:.1f}" if latency.count else NO_SAMPLE for value in values]


def stages_line(report: model.SessionReport) -> str:
    """Where the time of the uplink's picture goes, mean of an event; empty without pictures."""
    if report.video_lead is None:
        return ""
    video = report.video_lead.video_ms
    terms = ((name, getattr(video, name)) for name in TERMS)
    parts = ", ".join(f"{name} {ms:.0f}" for name, ms in terms if round(ms))
    return f"uplink picture {video.total:.0f} ms: {parts}"


def _print_content(console: Console, sync: model.SyncReport | None) -> None:
    if sync is None:
        return
    senses = [
        f"{sense} {metrics.latency_ms.p50:.1f} ({metrics.perceived})"
        for sense, metrics in sync.senses.items()
        if metrics is not None and metrics.perceived
    ]
    skews = _skews(sync.skew_ms)
    console.print(
        f"by content, ms after each of {sync.events} contacts: {', '.join(senses)}"
        + (f"; skew: {', '.join(skews)}" if skews else "")
    )


def _skews(skews: Mapping[str, model.SkewReport | model.ContentSkew | None]) -> list[str]:
    return [
        f"{name.replace('_', ' to ')} {skew.p50:+.1f} (p95 {skew.p95:+.1f})"
        for name, skew in skews.items()
        if skew is not None
    ]


def _kbps(bps: float) -> str:
    return f"{bps / 1000:.1f}"
