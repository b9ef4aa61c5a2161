"""What every receiving process does alike."""

from pathlib import Path

from kontur_av.rtp.receiver import RtpReceiver
from pipelines.probe import Probe


class ReportMemory:
    """The newest sender report, kept in the session's directory for a restart of this process.

    Without it a restarted receiver could not say how old its pictures are until the next report,
    and would show none.
    """

    def __init__(self, path: Path, receiver: RtpReceiver, now_ns: int) -> None:
        self._path = path
        self._receiver = receiver
        if path.exists():
            receiver.handle_report(path.read_bytes(), now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> None:
        """Give `datagram` to the receiver, and keep it if it was a report."""
        garbage = self._receiver.counts.garbage
        self._receiver.handle_report(datagram, now_ns)
        if self._receiver.counts.garbage == garbage:
            # Replaced in one step: a kill in between leaves the old report.
            partial = self._path.with_suffix(".new")
            partial.write_bytes(datagram)
            partial.replace(self._path)


def report_reception(probe: Probe, receiver: RtpReceiver) -> None:
    """Put a receiver's counters into the probe."""
    counts = receiver.counts
    probe.total("rtp_packets", counts.received)
    probe.total("rtp_lost", counts.lost)
    probe.total("rtp_reordered", counts.reordered)
    probe.total("rtp_duplicates", counts.duplicates)
    probe.total("rtp_late", counts.late)
    probe.total("garbage", counts.garbage)
    probe.total("sources", counts.sources)
    probe.gauge("jitter_ns", receiver.jitter_ns)
