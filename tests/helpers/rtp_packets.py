"""Packets as an RtpReceiver hands them on."""

from kontur_av.rtp.receiver import RtpReceived
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
