"""Latency of one video pipeline by stage: source -> H.264 -> cap -> RTP over UDP -> decoder.

    python samples/bench_latency.py [--clip FILE] [--seconds 10] [--cap-kbps 512]

Sender and receiver are two processes with a real socket between them. Both stamp on one clock, so
a latency is a difference. A picture counts as captured when its source delivers it.
"""

import argparse
import multiprocessing
import secrets
import socket
from multiprocessing.connection import Connection

import numpy as np

from kontur_av import ConfigError, VideoFrame
from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs import H264Decoder, H264Encoder
from kontur_av.media import empty_picture
from kontur_av.rtp import RtpIdentity
from kontur_av.sources import check_spec, open_video
from kontur_av.streams import UnitSent, VideoReceiver, VideoSender
from telepresence import video_scenes

STAGES = ("encode", "cap and channel", "network", "decode")


def receive(udp: socket.socket, results: Connection) -> None:
    """Send (RTP timestamp, received, decoded) of each picture, until an empty datagram comes."""
    clock = MonotonicClock()
    receiver, decoder = VideoReceiver(ssrc=secrets.randbits(32)), H264Decoder()
    received_ns: dict[int, int] = {}
    seen = []
    while datagram := udp.recv(2048):
        receiver.handle_packet(datagram, clock.now_ns())
        while (unit := receiver.next_event()) is not None:
            received_ns[unit.timestamp] = unit.received_ns
            pictures = decoder.decode(unit.data, unit.timestamp)
            now_ns = clock.now_ns()
            seen += [(p.timestamp, received_ns[p.timestamp], now_ns) for p in pictures]
    results.send((seen, receiver.counts.rtp.rtp_lost))


def send(
    udp: socket.socket, spec: str, seconds: float, cap_bps: int, channel_bps: int
) -> tuple[dict[int, tuple[int, int, int]], VideoSender]:
    """(captured, encoded, sent) by RTP timestamp, and the sender with its counts."""
    clock = MonotonicClock()
    width, height, fps = 640, 480, 30
    source = open_video(
        spec, name="bench", width=width, height=height, fps=fps, clock=clock, scenes=video_scenes()
    )
    encoder = H264Encoder(width=width, height=height, fps=fps, cap_bps=cap_bps)
    sender = VideoSender(
        cap_bps=cap_bps,
        channel_bps=channel_bps,
        fps=fps,
        identity=RtpIdentity.draw(secrets.randbits),
        cname="bench",
    )
    instants: dict[int, tuple[int, int, int]] = {}
    picture = empty_picture(width, height)
    end_ns = clock.now_ns() + round(seconds * NS_PER_S)
    while (now_ns := clock.now_ns()) < end_ns:
        due_ns = sender.poll_timeout()
        wait_ns = NS_PER_S // 10 if due_ns is None else max(0, due_ns - now_ns)
        stamp = source.read(picture, wait_ns)
        if stamp is not None:
            frame = VideoFrame(picture, stamp)
            sender.handle_picture(stamp, clock.now_ns())
        coding = sender.poll_encode(clock.now_ns())
        if coding is not None:
            sender.handle_access_unit(encoder.encode(frame, coding), clock.now_ns())
        while (packet := sender.poll_transmit(clock.now_ns())) is not None:
            udp.send(packet)
        while (event := sender.next_event()) is not None:
            if isinstance(event, UnitSent):
                instants[event.timestamp] = event.capture_ns, event.encoded_ns, event.sent_ns
    source.close()
    udp.send(b"")
    return instants, sender


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure a video pipeline's latency by stage.")
    parser.add_argument("--clip", default="scene:static", help="a film, or any other source")
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--cap-kbps", type=float, default=512)
    parser.add_argument("--channel-kbps", type=float, default=3824, help="of the whole channel")
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
    sent, sender = send(outbound, arguments.clip, arguments.seconds, cap_bps, channel_bps)
    seen, lost = results.recv()
    receiver.join()

    stages = {stage: [] for stage in (*STAGES, "capture to decoded")}
    for timestamp, received_ns, decoded_ns in seen:
        instants = (*sent[timestamp], received_ns, decoded_ns)
        for stage, begin_ns, end_ns in zip(STAGES, instants, instants[1:], strict=False):
            stages[stage].append((end_ns - begin_ns) / NS_PER_MS)
        stages["capture to decoded"].append((decoded_ns - instants[0]) / NS_PER_MS)
    print(f"{'ms':20}{'p50':>9}{'p95':>9}{'p99':>9}{'max':>9}")
    for stage, took_ms in stages.items():
        columns = "".join(f"{value:9.2f}" for value in np.percentile(took_ms, (50, 95, 99, 100)))
        print(f"{stage:20}{columns}")
    print(
        f"{len(sent)} pictures sent, {len(seen)} seen, {lost} packets lost, "
        f"{sender.released.max_bps() / 1000:.1f} of {arguments.cap_kbps:g} kbit/s in the largest "
        "second"
    )


if __name__ == "__main__":
    try:
        main()
    except ConfigError as error:
        raise SystemExit(f"bench_latency: {error}") from None
