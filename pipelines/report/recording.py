"""What the recorder reports, for the report and for the live view. A core."""

from pipelines.recording.figures import RecorderFigures
from pipelines.report.collector import Collector
from pipelines.report.model import Warning

RECORDER = "recorder"
_DISK = "give the recording a larger or a faster disk"
_PROCESSOR = "leave the recorder more of the processors: fewer cameras, or a faster machine"


def recorder_report(collector: Collector) -> RecorderFigures | None:
    """The recording of a session; None if nothing was recorded."""
    figures = _figures(collector)
    return figures if figures.parts or figures.disk_faults else None


def seat_recording(collector: Collector) -> dict[str, str | int | None]:
    """What pages show of the recording, by name. file: null while nothing is recorded."""
    if collector.process(RECORDER).find(RecorderFigures) is None:
        return {}
    figures = _figures(collector)
    return {
        "file": None if figures.file is None else figures.file.rpartition("/")[2],
        "octets": figures.octets,
        "lost": figures.lost,
        "fault": figures.fault,
    }


def recorder_warnings(collector: Collector) -> list[Warning]:
    """What is not in the recording, and whether the disk or the processors were too slow for it.

    A disk makes the recorder drop what it has read. What was gone before it was read is missing
    because the recorder did not run in time.
    """
    figures = _figures(collector)
    if not (figures.lost or figures.disk_faults):
        return []
    why = f"; {figures.fault}" if figures.fault else ""
    dropped = sum(one.dropped for one in figures.channels.values())
    missed = figures.lost - dropped
    measured = f"{figures.lost} messages are not in the recording"
    if missed:
        measured += f", of which {missed} were gone before they were read"
    mends = [_DISK] * bool(dropped or figures.disk_faults) + [_PROCESSOR] * bool(missed)
    mend = "; ".join(mends)
    return [Warning(what="not_recorded", where=RECORDER, measured=measured + why, mend=mend)]


def recording_line(collector: Collector) -> tuple[str, bool] | None:
    """A line for the live view, and whether it is bad news; None while nothing is recorded."""
    figures = _figures(collector)
    if figures.file is None:
        return None
    line = f"recording to {figures.file}, {figures.octets / 1e6:.1f} MB"
    line += f", {figures.lost} messages lost" if figures.lost else ""
    line += f": {figures.fault}" if figures.fault else ""
    return line, bool(figures.lost or figures.fault)


def _figures(collector: Collector) -> RecorderFigures:
    return collector.process(RECORDER).total(RecorderFigures)
