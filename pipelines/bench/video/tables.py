"""The tables and headlines of `bench video`."""

from collections.abc import Callable, Mapping, Sequence

from rich.table import Table

from pipelines.bench.video.figures import ContenderFigures
from pipelines.bench.video.targets import VideoVerdict
from pipelines.report.result import Headline

#: Heading of a row, and its text from the figures.
_ROWS: tuple[tuple[str, Callable[[ContenderFigures], str]], ...] = (
    *(
        (f"capture to displayed, {key}, ms", lambda found, key=key: f"{found.latency_ms[key]:.1f}")
        for key in ("p50", "p95", "p99", "max")
    ),
    ("PSNR, mean, dB", lambda found: f"{found.psnr_db.mean:.2f}"),
    ("PSNR, worst 5 %, dB", lambda found: f"{found.psnr_db.worst:.2f}"),
    ("SSIM, mean", lambda found: f"{found.ssim.mean:.3f}"),
    ("SSIM, worst 5 %", lambda found: f"{found.ssim.worst:.3f}"),
    ("VMAF, mean", lambda found: f"{found.vmaf.mean:.1f}" if found.vmaf else "–"),
    ("VMAF, worst 5 %", lambda found: f"{found.vmaf.worst:.1f}" if found.vmaf else "–"),
    ("displayed pictures a second", lambda found: f"{found.per_second:.1f}"),
    ("longest gap, ms", lambda found: f"{found.longest_gap_ms:.0f}"),
    ("payload, mean, kbit/s", lambda found: _kbps(found.payload_bps)),
    ("largest 1 s of payload, kbit/s", lambda found: _kbps(found.payload_1s_bps)),
    ("largest 1 s with RTP headers", lambda found: _kbps(found.rtp_1s_bps)),
    ("largest 0.1 s of payload", lambda found: _kbps(found.payload_100ms_bps)),
    ("largest 0.1 s with RTP headers", lambda found: _kbps(found.rtp_100ms_bps)),
    ("CPU of the sender, s", lambda found: f"{found.sender_cpu_s:.2f}"),
    ("CPU of the receiver, s", lambda found: f"{found.receiver_cpu_s:.2f}"),
)


def _kbps(rate_bps: float) -> str:
    return f"{rate_bps / 1000:.1f}"


def figures_table(title: str, measured: Mapping[str, ContenderFigures]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for name in measured:
        table.add_column(name, justify="right")
    for heading, value in _ROWS:
        table.add_row(heading, *(value(found) for found in measured.values()))
    return table


def notes(name: str, found: ContenderFigures) -> list[str]:
    """What disturbed this run."""
    said = []
    if found.guessed or found.unreadable:
        said.append(
            f"{name}: {found.guessed} numbers known only from their neighbours, "
            f"{found.unreadable} not at all"
        )
    if found.left_out_by_camera:
        said.append(
            f"{name}: {found.left_out_by_camera} pictures left out by the camera, "
            "because the sender had not read the ones before"
        )
    if found.others_cores > 0.1:
        said.append(
            f"{name}: other programs used {found.others_cores:.1f} cores: "
            "an idle machine has lower latencies and higher rates"
        )
    if not found.realtime or found.camera_latest_us > 1000 or found.channel_late_us["p99"] > 500:
        said.append(
            f"{name}: this machine was busy: camera up to {found.camera_latest_us / 1000:.1f} ms "
            f"late, channel {found.channel_late_us['p99'] / 1000:.2f} ms at p99"
            + ("" if found.realtime else ", without real-time priority")
        )
    return said


def verdicts_table(title: str, verdicts: Sequence[VideoVerdict]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("", "target", "found", "against", ""):
        table.add_column(heading, justify="left" if not heading else "right")
    for verdict in verdicts:
        table.add_row(
            verdict.what,
            verdict.target,
            verdict.found,
            verdict.against,
            "met" if verdict.met else "[red]missed[/red]",
        )
    return table


def headlines(
    group: str, measured: Mapping[str, ContenderFigures], verdicts: Sequence[VideoVerdict]
) -> list[Headline]:
    """Of one clip at one rate."""
    found = []
    for who, figures in measured.items():
        for what, unit, value in (
            ("capture to displayed, p50", "ms", figures.latency_ms["p50"]),
            ("capture to displayed, p99", "ms", figures.latency_ms["p99"]),
            ("PSNR, mean", "dB", figures.psnr_db.mean),
            ("PSNR, worst 5 %", "dB", figures.psnr_db.worst),
            ("SSIM, mean", "", figures.ssim.mean),
            ("VMAF, mean", "", figures.vmaf.mean if figures.vmaf else None),
            ("VMAF, worst 5 %", "", figures.vmaf.worst if figures.vmaf else None),
            ("displayed", "pictures/s", figures.per_second),
            ("payload, mean", "kbit/s", figures.payload_bps / 1000),
            ("CPU of both ends", "s", figures.cpu_s),
        ):
            found.append(Headline(group=group, what=what, who=who, unit=unit, value=value))
    found += [
        Headline(
            group=f"targets: {group}",
            what=verdict.what,
            unit=verdict.unit,
            value=verdict.value,
            target=verdict.target,
            met=verdict.met,
        )
        for verdict in verdicts
    ]
    return found
