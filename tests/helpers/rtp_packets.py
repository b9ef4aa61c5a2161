"""Packets as an RtpReceiver hands them on, and both ends of a stream of pictures."""

import struct
from dataclasses import asdict

from kontur_av.clock import NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.receiver import RtpReceived, RtpReceiver
from kontur_av.rtp.sender import RtpSender
from kontur_av.rtp.wire import RtpPacket

FRAME_NS = 33_333_333


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


def make_sender(**changes) -> PromptSender:
    return PromptSender(
        **{
            "payload_type": 96,
            "clock_rate_hz": 90_000,
            "ssrc": 1,
            "first_sequence": 65_530,
            "timestamp_offset": 2**32 - 5000,
            "cname": "test",
        }
        | changes
    )


def make_receiver(**changes) -> RtpReceiver:
    return RtpReceiver(**{"payload_type": 96, "clock_rate_hz": 90_000} | changes)


def picture(number: int, octets: int = 100) -> AccessUnit:
    # A slice whose first_mb_in_slice is 0 (0x88 begins with a one bit).
    data = b"\x00\x00\x00\x01\x41\x88" + bytes([1 + number % 255]) * octets
    return AccessUnit(data, CaptureStamp(number * FRAME_NS, number, "test"), False)


def singles(count: int, **changes) -> list[bytes]:
    """Return `count` packets, each one picture."""
    rtp = make_sender(**changes)
    return [
        packet for number in range(count) for packet in rtp.video_packets(picture(number)).packets
    ]


def drain(receiver: RtpReceiver) -> list:
    events = []
    while (event := receiver.next_event()) is not None:
        events.append(event)
    return events


def feed(receiver: RtpReceiver, packets, every_ns=1, since_ns=0, source=None) -> list:
    """Hand packets to a receiver, one every `every_ns`; return what comes out."""
    for index, packet in enumerate(packets):
        receiver.handle_packet(packet, since_ns + index * every_ns, source)
    return drain(receiver)


def counted(receiver: RtpReceiver) -> dict[str, int]:
    """Return the counts that are not 0, but for octets, without `rtp_` in their names."""
    metrics = asdict(receiver.counts)
    del metrics["rtp_payload_octets"]
    return {name.removeprefix("rtp_"): count for name, count in metrics.items() if count}


def report_at(unix_ns: int, timestamp: int) -> bytes:
    """Return a sender report of the source 1 that dates this timestamp so."""
    seconds, rest_ns = divmod(unix_ns, NS_PER_S)
    ntp = (seconds + 2_208_988_800 << 32) + (rest_ns << 32) // NS_PER_S
    return struct.pack("!BBHIQIII", 0x80, 200, 6, 1, ntp, timestamp, 1, 1)


def reported(ssrc=1):
    """Return the packet of one picture, and the sender report that belongs to it."""
    rtp = make_sender(ssrc=ssrc)
    (packet,) = rtp.video_packets(picture(0)).packets
    return packet, rtp.poll_report(0)
