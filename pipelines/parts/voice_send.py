"""A voice stream's sending process: topic -> Opus -> RTP to the gateway."""

from collections import deque

from kontur_av.budget import Pacer
from kontur_av.media import AUDIO_CLOCK_HZ
from kontur_av.opus import OpusEncoder, bitrate_under_cap
from kontur_av.sources.source import BLOCK_NS
from pipelines.names import VOICE_PAYLOAD_TYPE
from pipelines.parts.sending import Outgoing
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VoiceStream

#: A block this old is no voice any more; it would only push the following ones back.
_TOO_OLD_NS = 5 * BLOCK_NS


def run_voice_send(context: Context, *, stream: VoiceStream, topic: str) -> None:
    """Send every block of sound of `topic` as it comes, at a constant rate within the cap."""
    clock, probe = context.clock, context.probe
    encoder = OpusEncoder(bitrate_bps=bitrate_under_cap(stream.cap_bps))
    outgoing = Outgoing(
        context, stream, payload_type=VOICE_PAYLOAD_TYPE, clock_rate_hz=AUDIO_CLOCK_HZ
    )
    rtp = outgoing.rtp
    # The rate is constant, but a process that was held up would send two packets at once.
    pacer = Pacer(cap_bps=stream.cap_bps, channel_bps=context.setup.profile_of(stream).media_bps)
    under_way: deque[tuple[int, int, int]] = deque()
    captured = encoded = sent = too_old = 0

    def fill() -> None:
        probe.total("frames_captured", captured)
        probe.total("frames_encoded", encoded)
        probe.total("frames_sent", sent)
        probe.total("frames_refused", too_old)
        probe.total("rtp_packets_sent", rtp.packets_sent)

    def send_due() -> None:
        nonlocal sent
        now_ns = clock.now_ns()
        while (packet := pacer.poll_transmit(now_ns)) is not None:
            outgoing.send(packet, now_ns)
            sent += 1
            probe.row("tx", *under_way.popleft(), now_ns)

    context.on_flush(fill)
    with context.open_bus() as bus:
        reader = bus.reader(topic, depth=8)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = pacer.poll_timeout()
            reader.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
            while (lease := reader.next()) is not None:
                with lease:
                    captured += 1
                    now_ns = clock.now_ns()
                    if now_ns - lease.stamp.capture_ns > _TOO_OLD_NS:
                        too_old += 1
                        continue
                    frame = lease.audio()
                    data = encoder.encode(frame.samples)
                encoded += 1
                encoded_ns = clock.now_ns()
                packets = rtp.audio_packets(data, frame.stamp)
                timestamp = int.from_bytes(packets[0][4:8], "big")
                under_way.append((timestamp, frame.stamp.capture_ns, encoded_ns))
                pacer.handle_access_unit(packets, [len(data)], encoded_ns)
            send_due()
            outgoing.send_report(clock.now_ns())
        outgoing.close()
