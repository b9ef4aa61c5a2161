"""What the recorder reports, for the report and for the live view. A core."""

from pipelines.report.collector import Collector
from pipelines.report.model import RecordedChannel, RecorderReport, Warning
from pipelines.session.figures import RecorderCounters, RecorderGauges

RECORDER = "recorder"
_MEND = "give the recording a larger or a faster disk"


def recorder_report(collector: Collector) -> RecorderReport | None:
    """The recording of a session; None if nothing was recorded."""
    counters, gauges = _figures(collector)
    if counters is None or not (counters.parts or counters.disk_faults):
        return None
    names = sorted({*counters.kept, *counters.missed, *counters.dropped})
    return RecorderReport(
        file=(gauges.file or None) if gauges else None,
        parts=counters.parts,
        octets=counters.octets,
        disk_faults=counters.disk_faults,
        late_keys=counters.late_keys,
        fault=(gauges.fault or None) if gauges else None,
        channels={
            name: RecordedChannel(
                kept=counters.kept.get(name, 0),
                missed=counters.missed.get(name, 0),
                dropped=counters.dropped.get(name, 0),
            )
            for name in names
        },
    )


def seat_recording(collector: Collector) -> dict[str, str | int | None]:
    """What pages show of the recording, by name. file: null while nothing is recorded."""
    counters, gauges = _figures(collector)
    if counters is None or gauges is None:
        return {}
    return {
        "file": gauges.file.rpartition("/")[2] or None,
        "octets": counters.octets,
        "lost": _lost(counters),
        "fault": gauges.fault or None,
    }


def recorder_warnings(collector: Collector) -> list[Warning]:
    """What is not in the recording."""
    counters, gauges = _figures(collector)
    lost = _lost(counters)
    if counters is None or not (lost or counters.disk_faults):
        return []
    why = f"; {gauges.fault}" if gauges is not None and gauges.fault else ""
    measured = f"{lost} messages are not in the recording{why}"
    return [Warning(what="not_recorded", where=RECORDER, measured=measured, mend=_MEND)]


def recording_line(collector: Collector) -> tuple[str, bool] | None:
    """A line for the live view, and whether it is bad news; None while nothing is recorded."""
    counters, gauges = _figures(collector)
    if counters is None or gauges is None or not gauges.file:
        return None
    lost = _lost(counters)
    line = f"recording to {gauges.file}, {counters.octets / 1e6:.1f} MB"
    line += f", {lost} messages lost" if lost else ""
    line += f": {gauges.fault}" if gauges.fault else ""
    return line, bool(lost or gauges.fault)


def _figures(collector: Collector) -> tuple[RecorderCounters | None, RecorderGauges | None]:
    figures = collector.process(RECORDER)
    return figures.counted(RecorderCounters), figures.gauges(RecorderGauges)


def _lost(counters: RecorderCounters | None) -> int:
    if counters is None:
        return 0
    return sum(counters.missed.values()) + sum(counters.dropped.values())
