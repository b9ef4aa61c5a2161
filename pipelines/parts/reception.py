"""What every receiving process counts alike."""

from kontur_av.rtp.receiver import RtpReceiver
from pipelines.probe import Probe


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
