"""What a running session shows: a live table on a terminal, else one line a second."""

import sys
from types import TracebackType
from typing import Self

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from kontur_av.clock import NS_PER_S
from pipelines.collector import HAPTIC_ENDS
from pipelines.launcher import Launcher
from pipelines.report import displayed_frames, haptic_bps, haptic_cap_bps, latency_ms


class LiveView:
    """Shows a launcher's session; use it as a context around the run, and give `show` to it."""

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        self._console = Console(file=sys.stdout)
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, launcher: Launcher) -> None:
        """Draw the present state."""
        if self._live is not None:
            self._live.update(
                Group(_streams(launcher), _processes(launcher, verbose=self._verbose)),
                refresh=True,
            )
        elif not self._quiet:
            print(_line(launcher), flush=True)


def _streams(launcher: Launcher) -> Table:
    collector = launcher.collector
    selector = collector.process("selector").gauges.get("selected", "-")
    table = Table(
        title=f"{launcher.setup.name}   {launcher.seconds:.0f} s   camera {selector}",
        title_justify="left",
    )
    for heading in ("stream", "kbit/s", "max 1 s", "cap", "shown", "lost", "latency ms", "p99 ms"):
        table.add_column(heading, justify="left" if heading == "stream" else "right")
    for stream in launcher.setup.streams:
        figures = collector.streams[stream.name]
        newest = latency_ms(figures)
        largest = figures.rate.max_bps(NS_PER_S)
        table.add_row(
            stream.name,
            f"{figures.rate.mean_bps() / 1000:.1f}",
            Text(f"{largest / 1000:.1f}", "bold red" if largest > stream.cap_bps else "green"),
            f"{stream.cap_bps / 1000:g}",
            str(displayed_frames(collector, stream.name)),
            str(collector.process(f"{stream.name}_receive").total("rtp_lost")),
            "-" if newest is None else f"{newest:.1f}",
            f"{figures.latency.percentile(99) / 1e6:.1f}",
        )
    for name, (_, receiver) in HAPTIC_ENDS.items():
        histogram = collector.haptics[name].latency
        figures_of_end = collector.process(receiver)
        samples = figures_of_end.total("received")
        profile = launcher.setup.uplink if name == "up" else launcher.setup.downlink
        table.add_row(
            f"haptic_{name}",
            f"{haptic_bps(profile, samples, launcher.seconds) / 1000:.1f}",
            "",
            f"{haptic_cap_bps(profile) / 1000:g}",
            str(samples),
            str(figures_of_end.total("lost")),
            f"{histogram.percentile(50) / 1e6:.1f}",
            f"{histogram.percentile(99) / 1e6:.1f}",
        )
    return table


def _processes(launcher: Launcher, *, verbose: bool) -> Columns:
    texts = []
    seconds = max(launcher.seconds, 1e-9)
    for child in launcher.children:
        text = Text("● ", "green" if child.pid is not None else "bold red")
        text.append(child.part.name, "default")
        if verbose or child.restarts:
            text.append(f" {100 * child.cpu_s() / seconds:.0f} %", "dim")
        if child.restarts:
            text.append(f" ({child.restarts} restarts: {child.last_error})", "yellow")
        texts.append(text)
    return Columns(texts, padding=(0, 2))


def _line(launcher: Launcher) -> str:
    collector = launcher.collector
    parts = [f"{launcher.seconds:6.1f} s"]
    for stream in launcher.setup.streams:
        figures = collector.streams[stream.name]
        newest = latency_ms(figures)
        parts.append(
            f"{stream.name} {figures.rate.mean_bps() / 1000:.1f}/{stream.cap_bps / 1000:g} kbit/s "
            f"{displayed_frames(collector, stream.name)} shown "
            f"{collector.process(f'{stream.name}_receive').total('rtp_lost')} lost "
            f"{'-' if newest is None else f'{newest:.0f}'} ms"
        )
    for name, (_, receiver) in HAPTIC_ENDS.items():
        received = collector.process(receiver)
        parts.append(
            f"haptic_{name} {received.total('received')} received {received.total('lost')} lost "
            f"{collector.haptics[name].latency.percentile(50) / 1e6:.1f} ms"
        )
    down = [child.part.name for child in launcher.children if child.pid is None]
    if down:
        parts.append("down: " + ", ".join(down))
    return "  ".join(parts)
