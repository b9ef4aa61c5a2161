"""The age and the state of what the displays show, as they report it."""

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.staleness import State
from pipelines.cores.probe import FLUSH_NS
from pipelines.report.collector import Collector
from pipelines.setup.table import Setup, VideoStream, VoiceStream

#: A display that has reported nothing for longer is assumed to show its last picture.
_TOLD_AFTER_NS = 2 * FLUSH_NS


def spell_ms(stream: str, spell: str, collector: Collector) -> float:
    """The time (ms) for which `stream` was shown `stale`, `frozen` or `damaged`."""
    return round(collector.total(f"{stream}.{spell}_ns") / NS_PER_MS, 3)


def spell_episodes(stream: str, spell: str, collector: Collector) -> int:
    """How many times `stream` began to be shown `stale`, `frozen` or `damaged`."""
    return collector.total(f"{stream}.{spell}_episodes")


def shown_now(
    stream: VideoStream | VoiceStream, setup: Setup, collector: Collector, now_ns: int
) -> tuple[State, int]:
    """The state of what is shown of `stream`, and its age in ns (0 if nothing was shown yet)."""
    reporting = [of for of in collector.processes.values() if f"{stream.name}.age_ns" in of.gauges]
    if not reporting:
        return State.NOTHING, 0
    figures = max(reporting, key=lambda of: of.told_ns)
    age_ns = figures.gauges[f"{stream.name}.age_ns"]
    age_ns += max(0, now_ns - figures.told_ns - _TOLD_AFTER_NS)
    if age_ns >= setup.stale_after_ns(stream):
        return State.STALE, age_ns
    return State(figures.gauges[f"{stream.name}.state"]), age_ns
