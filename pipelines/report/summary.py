"""A report as a table for people."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pipelines.report.link_report import end_line, ledger_line
from pipelines.report.model import SessionReport, SyncReport


def print_summary(report: SessionReport) -> None:
    """The streams, the senses and the cost, on standard output."""
    # Without a terminal there is no width to keep to; the widest table takes about this.
    console = Console() if Console().is_terminal else Console(width=118)
    title = f"{report.setup}, {report.seconds:.1f} s"
    streams = Table(title=title, title_justify="left")
    headings = ("stream", "cap", "mean", "max 1 s", "max 0.1 s", "shown/s", "lost", "p50", "p95")
    for heading in (*headings, "p99", "max ms"):
        streams.add_column(heading, justify="left" if heading == "stream" else "right")
    for name, stream in report.streams.items():
        latency = stream.latency_ms
        streams.add_row(
            name,
            *map(_kbps, (stream.cap_bps, stream.payload_bps_mean)),
            *map(_kbps, (stream.payload_bps_max_1s, stream.payload_bps_max_100ms)),
            f"{stream.displayed_hz:.1f}",
            str(stream.rtp_lost or 0),
            *(f"{value:.1f}" for value in (latency.p50, latency.p95, latency.p99, latency.max)),
        )
    for name, haptic in report.haptic.items():
        felt = haptic.latency_ms
        rate_hz = haptic.received / max(report.seconds, 1e-9)
        streams.add_row(
            f"haptic_{name}",
            *map(_kbps, (haptic.cap_bps, haptic.payload_bps_mean)),
            *("", ""),
            f"{rate_hz:.1f}",
            str(haptic.lost),
            *(f"{value:.1f}" for value in (felt.p50, felt.p95, felt.p99, felt.max)),
        )
    console.print(streams)
    for direction, link in report.link.items():
        console.print(
            f"{direction}: {link.frames} frames, {link.frames_lost} lost, "
            f"{link.slips} slips; {ledger_line(link)}"
        )
    for end, told in report.gateways.items():
        console.print(end_line(end, told))
    skews = [
        f"{name.replace('_', ' to ')} {skew.p50:+.1f} (p95 {skew.p95:+.1f})"
        for name, skew in report.skew_ms.items()
        if skew is not None
    ]
    if skews:
        console.print("skew at the operator, ms: " + ", ".join(skews))
    _print_content(console, report.sync)
    together = report.lip_sync
    if together is not None:
        console.print(
            f"lip-sync (ITU-R BT.1359): {100 * together.within:.1f} % of the time within, sound "
            f"too early {100 * together.early:.1f} %, too late {100 * together.late:.1f} %"
        )
    for name, stream in report.streams.items():
        spells = ", ".join(
            f"{word} {spell_ms:.0f} ms ({episodes} times)"
            for word, spell_ms, episodes in (
                ("stale", stream.stale_ms, stream.stale_episodes),
                ("frozen", stream.frozen_ms, stream.frozen_episodes),
                ("damaged", stream.damaged_ms, stream.damaged_episodes),
            )
            if spell_ms
        )
        if spells:
            console.print(f"{name}: {spells}")
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
    for failure in report.failures:
        console.print(f"[bold red]failed:[/] {failure}")


def _print_content(console: Console, sync: SyncReport | None) -> None:
    if sync is None:
        return
    senses = [
        f"{sense} {figures.latency_ms.p50:.1f} ({figures.perceived})"
        for sense, figures in sync.senses.items()
        if figures is not None and figures.perceived
    ]
    skews = [
        f"{name.replace('_', ' to ')} {skew.p50:+.1f} (p95 {skew.p95:+.1f})"
        for name, skew in sync.skew_ms.items()
        if skew is not None
    ]
    console.print(
        f"by content, ms after each of {sync.events} contacts: {', '.join(senses)}"
        + (f"; skew: {', '.join(skews)}" if skews else "")
    )


def _kbps(bps: float) -> str:
    return f"{bps / 1000:.1f}"
