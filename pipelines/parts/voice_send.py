"""A voice stream's sending process: topic -> Opus -> RTP to the gateway."""

import secrets

from kontur_av.media import AUDIO_CLOCK_HZ
from kontur_av.opus import OpusEncoder, bitrate_under_cap
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from kontur_av.sources.source import BLOCK_NS
from pipelines.names import VOICE_PAYLOAD_TYPE
from pipelines.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.setup import VoiceStream

#: A block this old is no voice any more; it would only push the following ones back.
_TOO_OLD_NS = 5 * BLOCK_NS


def run_voice_send(context: Context, *, stream: VoiceStream, topic: str) -> None:
    """Send every block of sound of `topic` as it comes, at a constant rate within the cap."""
    clock, probe, ports = context.clock, context.probe, context.setup.ports
    encoder = OpusEncoder(bitrate_bps=bitrate_under_cap(stream.cap_bps))
    rtp = RtpSender(
        payload_type=VOICE_PAYLOAD_TYPE,
        clock_rate_hz=AUDIO_CLOCK_HZ,
        ssrc=secrets.randbits(32),
        first_sequence=secrets.randbits(16),
        timestamp_offset=secrets.randbits(32),
        cname=f"{stream.name}@kontur-av",
    )
    gateway, gateway_rtcp = (
        (LOOPBACK, ports.entry(flow)) for flow in (stream.name, f"{stream.name}_rtcp")
    )
    udp = context.listen(0)
    captured = encoded = too_old = 0

    def fill() -> None:
        probe.total("frames_captured", captured)
        probe.total("frames_encoded", encoded)
        probe.total("frames_sent", encoded)
        probe.total("frames_refused", too_old)
        probe.total("rtp_packets_sent", rtp.packets_sent)

    context.on_flush(fill)
    with context.open_bus() as bus:
        reader = bus.reader(topic, depth=8)
        while not context.stopping:
            context.tick(clock.now_ns())
            reader.wait(PATIENCE_NS)
            while (lease := reader.next()) is not None:
                with lease:
                    captured += 1
                    if clock.now_ns() - lease.stamp.capture_ns > _TOO_OLD_NS:
                        too_old += 1
                        continue
                    frame = lease.audio()
                    data = encoder.encode(frame.samples)
                encoded += 1
                encoded_ns = clock.now_ns()
                for packet in rtp.audio_packets(data, frame.stamp):
                    udp.sendto(packet, gateway)
                    now_ns = clock.now_ns()
                    probe.row("out", now_ns, len(packet) - RTP_HEADER_OCTETS)
                    timestamp = int.from_bytes(packet[4:8], "big")
                    probe.row("tx", timestamp, frame.stamp.capture_ns, encoded_ns, now_ns)
            report = rtp.poll_report(clock.now_ns(), clock.ntp)
            if report is not None:
                udp.sendto(report, gateway_rtcp)
        goodbye = rtp.goodbye(clock.ntp)
        if goodbye is not None:
            udp.sendto(goodbye, gateway_rtcp)
