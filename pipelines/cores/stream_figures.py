"""The figures of a stream's ends, as a process reports them.

Only this module knows both the events of `kontur_av.streams` and the names of the figures.
"""

from collections.abc import Callable

from kontur_av.rtp.payload_h264 import ReceivedUnit
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.rtp.sender import RTP_HEADER_OCTETS
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import PictureCoded, VideoSender
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.cores.gain import CapGain
from pipelines.cores.probe import Probe
from pipelines.cores.rows import CodingRow, OutRow, RxRow, TxRow


class Outgoing:
    """Sends the packets that may leave, and notes them.

    to_rtp, to_rtcp: called with each datagram and the instant.
    """

    def __init__(
        self,
        sender: VideoSender | VoiceSender,
        probe: Probe,
        to_rtp: Callable[[bytes, int], object],
        to_rtcp: Callable[[bytes, int], object],
    ) -> None:
        self._sender = sender
        self._out = probe.series(OutRow)
        self._coding, self._units = probe.series(CodingRow), probe.series(TxRow)
        self._to_rtp = to_rtp
        self._to_rtcp = to_rtcp

    def handle_time(self, now_ns: int) -> None:
        """Send the packets that may leave now, and a report if one is due."""
        sender = self._sender
        while (packet := sender.poll_transmit(now_ns)) is not None:
            self._out.add(OutRow(now_ns, len(packet) - RTP_HEADER_OCTETS, sender.cap_bps))
            self._to_rtp(packet, now_ns)
        while (event := sender.next_event()) is not None:
            if isinstance(event, PictureCoded):
                timestamp, _, came_ns, begun_ns, _, octets, packets = event
                self._coding.add(CodingRow(timestamp, came_ns, begun_ns, octets, packets))
            else:
                self._units.add(TxRow(*event))
        report = sender.poll_report(now_ns)
        if report is not None:
            self._to_rtcp(report, now_ns)

    def close(self, now_ns: int) -> None:
        """Send a goodbye, after which a new sender is accepted at once."""
        goodbye = self._sender.goodbye()
        if goodbye is not None:
            self._to_rtcp(goodbye, now_ns)


def tell_sender(
    probe: Probe, sender: VideoSender | VoiceSender, gain: CapGain | None = None
) -> None:
    """Put a sender's counters into the probe; gain: of its cap."""
    counts = sender.counts
    probe.total("frames_captured", counts.captured)
    probe.total("frames_encoded", counts.encoded)
    probe.total("frames_sent", counts.sent)
    probe.total("frames_refused", counts.refused)
    probe.total("rtp_packets_sent", counts.rtp_packets)
    if not isinstance(sender, VideoSender):
        return
    if gain is not None:
        probe.total("gained_bits", gain.gained_bits)
        probe.total("gain_changes", gain.changes)
    video = sender.counts
    probe.total("feedback_received", video.losses_told)
    probe.total("feedback_garbage", video.feedback_garbage)
    probe.gauge("backlog_octets", sender.backlog_octets)


def tell_video_receiver(
    probe: Probe, receiver: VideoReceiver, decoded: int, corrupt: int, restarts: int
) -> None:
    """Put a receiver's counters into the probe, with those of the decoder."""
    counts = receiver.counts
    _tell_rtp(probe, counts.rtp, counts.jitter_ns, counts.undated)
    probe.total("frames_received", counts.units)
    probe.total("frames_damaged", counts.damaged)
    probe.total("frames_decoded", decoded)
    probe.total("frames_corrupt", corrupt)
    probe.total("decoder_restarts", restarts)
    probe.total("frames_oversized", counts.oversized)
    probe.total("pictures_asked_for", counts.asked)


def tell_voice_receiver(probe: Probe, receiver: VoiceReceiver) -> None:
    """Put a receiver's counters into the probe."""
    counts = receiver.counts
    playout = counts.playout
    _tell_rtp(probe, counts.rtp, counts.jitter_ns, counts.undated)
    probe.total("frames_decoded", playout.played + playout.recovered - counts.corrupt)
    probe.total("frames_concealed", playout.concealed + counts.corrupt)
    probe.total("frames_recovered", playout.recovered)
    probe.total("frames_late", playout.late)
    probe.total("frames_left_out", playout.dropped)
    probe.total("inserted_ns", counts.inserted_ns)
    probe.total("frames_stretched", playout.stretched)
    probe.total("frames_shortened", playout.shortened)
    probe.gauge("playout_delay_ns", counts.delay_ns)


def _tell_rtp(probe: Probe, rtp: ReceiverCounts, jitter_ns: int, undated: int) -> None:
    probe.total("rtp_packets", rtp.received)
    probe.total("rtp_lost", rtp.lost)
    probe.total("rtp_reordered", rtp.reordered)
    probe.total("rtp_duplicates", rtp.duplicates)
    probe.total("rtp_late", rtp.late)
    probe.total("garbage", rtp.garbage)
    probe.total("sources", rtp.sources)
    probe.gauge("jitter_ns", jitter_ns)
    probe.total("frames_undated", undated)


def note_unit(probe: Probe, unit: ReceivedUnit) -> None:
    """An access unit came out of a `VideoReceiver`."""
    probe.series(RxRow).add(RxRow(unit.timestamp, unit.received_ns))


def note_arrivals(probe: Probe, receiver: VoiceReceiver) -> None:
    """Packets of a voice may have come."""
    probe.series(RxRow).extend_plain(receiver.take_arrivals())
