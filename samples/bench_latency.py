"""Latency of one video pipeline by stage: source -> H.264 -> cap -> RTP over UDP -> decoder.

    python samples/bench_latency.py [--clip FILE] [--seconds 10] [--cap-kbps 512]

Sender and receiver are two processes with a real socket between them; both stamp on the same
clock, so a latency is a difference. The picture is captured when its source gives it out.
"""

import argparse
import multiprocessing
import secrets
import socket
from multiprocessing.connection import Connection

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.h264 import H264Decoder, H264Encoder
from kontur_av.errors import ConfigError
from kontur_av.media import VIDEO_CLOCK_HZ, VideoFrame, empty_picture
from kontur_av.meters import Histogram
from kontur_av.rtp.payload_h264 import H264Depacketizer
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from kontur_av.sources import check_spec, open_video
from kontur_av.streams.budget import Pacer
from telepresence.world import video_scenes

PAYLOAD_TYPE = 96
STAGES = ("encode", "cap and channel", "network", "decode")


def receive(udp: socket.socket, results: Connection) -> None:
    """Until an empty datagram: (RTP timestamp, received, decoded) of each picture."""
    clock = MonotonicClock()
    receiver = RtpReceiver(payload_type=PAYLOAD_TYPE, clock_rate_hz=VIDEO_CLOCK_HZ)
    depacketizer, decoder = H264Depacketizer(), H264Decoder()
    received_ns: dict[int, int] = {}
    seen = []
    while datagram := udp.recv(2048):
        receiver.handle_packet(datagram, clock.now_ns())
        while (packet := receiver.next_event()) is not None:
            depacketizer.handle_packet(packet)
        while (unit := depacketizer.next_event()) is not None:
            received_ns[unit.timestamp] = unit.received_ns
            pictures = decoder.decode(unit.data, unit.timestamp)
            now_ns = clock.now_ns()
            seen += [(p.timestamp, received_ns[p.timestamp], now_ns) for p in pictures]
    results.send((seen, receiver.counts.lost))


def send(
    udp: socket.socket, spec: str, seconds: float, cap_bps: int, channel_bps: int
) -> tuple[dict[int, tuple[int, int, int]], Pacer]:
    """(captured, encoded, sent) by RTP timestamp, and the pacer with its counts."""
    clock = MonotonicClock()
    width, height, fps = 640, 480, 30
    source = open_video(
        spec, name="bench", width=width, height=height, fps=fps, clock=clock, scenes=video_scenes()
    )
    encoder = H264Encoder(width=width, height=height, fps=fps, cap_bps=cap_bps)
    pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps)
    rtp = RtpSender(
        payload_type=PAYLOAD_TYPE,
        clock_rate_hz=VIDEO_CLOCK_HZ,
        ssrc=secrets.randbits(32),
        first_sequence=secrets.randbits(16),
        timestamp_offset=secrets.randbits(32),
        cname="bench",
        max_payload_octets=min(1200, pacer.max_payload_octets),
    )
    instants: dict[int, tuple[int, int, int]] = {}
    picture = empty_picture(width, height)
    end_ns = clock.now_ns() + round(seconds * NS_PER_S)
    while (now_ns := clock.now_ns()) < end_ns:
        due_ns = pacer.poll_timeout()
        wait_ns = NS_PER_S // 10 if due_ns is None else max(0, due_ns - now_ns)
        stamp = source.read(picture, wait_ns)
        if stamp is not None and pacer.ready_for_picture(clock.now_ns()):
            unit = encoder.encode(VideoFrame(picture, stamp), clock.now_ns)
            packets = rtp.video_packets(unit)
            instants[rtp.timestamp(stamp.capture_ns)] = (stamp.capture_ns, unit.encoded_ns, 0)
            sizes = [len(packet) - RTP_HEADER_OCTETS for packet in packets]
            pacer.handle_access_unit(packets, sizes, unit.encoded_ns)
        while (packet := pacer.poll_transmit(clock.now_ns())) is not None:
            udp.send(packet)
            # The last packet of a picture is the one that counts.
            timestamp = int.from_bytes(packet[4:8], "big")
            captured_ns, encoded_ns, _ = instants[timestamp]
            instants[timestamp] = (captured_ns, encoded_ns, clock.now_ns())
    source.close()
    udp.send(b"")
    return instants, pacer


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure a video pipeline's latency by stage.")
    parser.add_argument("--clip", default="scene:static", help="a film, or any other source")
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--cap-kbps", type=float, default=512)
    parser.add_argument("--channel-kbps", type=float, default=3824, help="of what the cap is part")
    arguments = parser.parse_args()
    cap_bps, channel_bps = (
        round(kbps * 1000) for kbps in (arguments.cap_kbps, arguments.channel_kbps)
    )
    check_spec(arguments.clip, "video", video_scenes())
    inbound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    inbound.bind(("127.0.0.1", 0))
    outbound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    outbound.connect(inbound.getsockname())
    results, theirs = multiprocessing.Pipe(duplex=False)
    receiver = multiprocessing.Process(target=receive, args=(inbound, theirs), daemon=True)
    receiver.start()
    sent, pacer = send(outbound, arguments.clip, arguments.seconds, cap_bps, channel_bps)
    seen, lost = results.recv()
    receiver.join()

    stages = {stage: Histogram() for stage in (*STAGES, "capture to decoded")}
    for timestamp, received_ns, decoded_ns in seen:
        instants = (*sent[timestamp], received_ns, decoded_ns)
        for stage, begin_ns, end_ns in zip(STAGES, instants, instants[1:], strict=False):
            stages[stage].add(end_ns - begin_ns)
        stages["capture to decoded"].add(decoded_ns - instants[0])
    print(f"{'ms':20}{'p50':>9}{'p95':>9}{'p99':>9}{'max':>9}")
    for stage, histogram in stages.items():
        columns = "".join(f"{value:9.2f}" for value in histogram.summary_ms().values())
        print(f"{stage:20}{columns}")
    print(
        f"{len(sent)} pictures sent, {len(seen)} seen, {lost} packets lost, "
        f"{pacer.released.max_bps() / 1000:.1f} of {arguments.cap_kbps:g} kbit/s in the largest "
        "second"
    )


if __name__ == "__main__":
    try:
        main()
    except ConfigError as error:
        raise SystemExit(f"bench_latency: {error}") from None
