"""What is true of a session at present, which the report at its end does not have. A core."""

from kontur_av.meters import RateMeter
from kontur_av.streams.staleness import State
from pipelines.media.figures import DisplayFigures
from pipelines.report.collector import Collector
from pipelines.session.probe import FLUSH_NS
from pipelines.session.setup.table import Setup, VideoStream, VoiceStream

#: Figures are at most this old: a process reports twice a second, and may be late.
_TOLD_AFTER_NS = 2 * FLUSH_NS


def last_bps(rate: RateMeter, now_ns: int) -> float:
    """The rate of the last second that the processes have reported."""
    return rate.last_bps(now_ns - _TOLD_AFTER_NS)


def shown_now(
    stream: VideoStream | VoiceStream, setup: Setup, collector: Collector, now_ns: int
) -> tuple[State, int | None]:
    """The state of what is shown of `stream`, and its age in ns.

    None: nothing was shown yet, or its clock is not known.
    """
    display = collector.process(collector.topology.media(stream.name).display)
    reported = display.total(DisplayFigures, stream.name)
    if reported.age_ns is None:
        return reported.state, None
    age_ns = reported.age_ns + max(0, now_ns - display.told_ns - _TOLD_AFTER_NS)
    if age_ns >= setup.stale_after_ns(stream):
        return State.STALE, age_ns
    return reported.state, age_ns
