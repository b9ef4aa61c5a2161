"""Packets as an RtpReceiver hands them on, and a sender whose packets leave at once."""

from kontur_av.rtp.receiver import RtpReceived
from kontur_av.rtp.sender import RtpSender
from kontur_av.rtp.wire import RtpPacket


def received(
    payload: bytes,
    number: int,
    *,
    ssrc: int = 1,
    timestamp: int = 0,
    marker: bool = True,
    received_ns: int = 0,
    lost_before: int = 0,
    restart: bool = False,
) -> RtpReceived:
    packet = RtpPacket(
        payload_type=96,
        marker=int(marker),
        sequence_number=number,
        timestamp=timestamp,
        ssrc=ssrc,
        payload=payload,
    )
    return RtpReceived(packet, payload, number, timestamp, received_ns, lost_before, restart)


class PromptSender(RtpSender):
    """Its packets leave at the instant of their capture."""

    def video_packets(self, access_unit):
        return self._sent(super().video_packets(access_unit), access_unit.stamp)

    def audio_packets(self, opus, stamp):
        return self._sent(super().audio_packets(opus, stamp), stamp)

    def _sent(self, made, stamp):
        for packet in made.packets:
            self.handle_sent(packet, stamp.capture_ns)
        return made
