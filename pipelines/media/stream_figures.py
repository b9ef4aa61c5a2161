"""The figures of a stream's ends, as a process reports them.

Only this module knows both the events of `kontur_av.streams` and the figures of a session.
"""

from collections.abc import Callable

from kontur_av.rtp.payload_h264 import ReceivedUnit
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.rtp.sender import RTP_HEADER_OCTETS
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import PictureCoded, VideoSender
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender
from pipelines.media.gain import CapGain
from pipelines.session.figures import (
    ReceptionCounters,
    ReceptionGauges,
    SendingCounters,
    VideoReceptionCounters,
    VideoSendingCounters,
    VoiceReceptionCounters,
)
from pipelines.session.probe import Probe
from pipelines.session.rows import CodingRow, OutRow, RxRow, TxRow


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
    probe.count(
        SendingCounters(
            frames_captured=counts.captured,
            frames_encoded=counts.encoded,
            frames_sent=counts.sent,
            frames_refused=counts.refused,
            rtp_packets_sent=counts.rtp_packets,
        )
    )
    if not isinstance(sender, VideoSender):
        return
    video = sender.counts
    probe.count(
        VideoSendingCounters(
            feedback_received=video.losses_told,
            feedback_garbage=video.feedback_garbage,
            gained_bits=None if gain is None else gain.gained_bits,
            gain_changes=None if gain is None else gain.changes,
        )
    )


def tell_video_receiver(
    probe: Probe, receiver: VideoReceiver, decoded: int, corrupt: int, restarts: int
) -> None:
    """Put a receiver's counters into the probe, with those of the decoder."""
    counts = receiver.counts
    probe.count(_reception(counts.rtp, counts.undated))
    probe.count(
        VideoReceptionCounters(
            frames_received=counts.units,
            frames_damaged=counts.damaged,
            frames_decoded=decoded,
            frames_corrupt=corrupt,
            decoder_restarts=restarts,
            frames_oversized=counts.oversized,
            pictures_asked_for=counts.asked,
        )
    )
    probe.gauge(ReceptionGauges(jitter_ns=counts.jitter_ns))


def tell_voice_receiver(probe: Probe, receiver: VoiceReceiver) -> None:
    """Put a receiver's counters into the probe."""
    counts = receiver.counts
    playout = counts.playout
    probe.count(_reception(counts.rtp, counts.undated))
    probe.count(
        VoiceReceptionCounters(
            frames_decoded=playout.played + playout.recovered - counts.corrupt,
            frames_concealed=playout.concealed + counts.corrupt,
            frames_recovered=playout.recovered,
            frames_late=playout.late,
            frames_left_out=playout.dropped,
            inserted_ns=counts.inserted_ns,
            frames_stretched=playout.stretched,
            frames_shortened=playout.shortened,
        )
    )
    probe.gauge(ReceptionGauges(jitter_ns=counts.jitter_ns, playout_delay_ns=counts.delay_ns))


def _reception(rtp: ReceiverCounts, undated: int) -> ReceptionCounters:
    return ReceptionCounters(
        rtp_packets=rtp.received,
        rtp_lost=rtp.lost,
        rtp_reordered=rtp.reordered,
        rtp_duplicates=rtp.duplicates,
        rtp_late=rtp.late,
        garbage=rtp.garbage,
        sources=rtp.sources,
        frames_undated=undated,
    )


def note_unit(probe: Probe, unit: ReceivedUnit) -> None:
    """An access unit came out of a `VideoReceiver`."""
    probe.series(RxRow).add(RxRow(unit.timestamp, unit.received_ns))


def note_arrivals(probe: Probe, receiver: VoiceReceiver) -> None:
    """Packets of a voice may have come."""
    probe.series(RxRow).extend_plain(receiver.take_arrivals())
