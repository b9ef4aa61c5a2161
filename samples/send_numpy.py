"""Send your own numpy pictures as H.264 over RTP/UDP, under a hard cap.

    python samples/send_numpy.py --to 127.0.0.1:5004 --cap-kbps 85 --sdp picture.sdp
    ffplay -protocol_whitelist file,udp,rtp -fflags nobuffer picture.sdp      (elsewhere)

Replace `picture_at` by whatever makes your pictures.
"""

import argparse
import secrets
import socket
from pathlib import Path

import cv2
import numpy as np

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.h264 import H264Encoder
from kontur_av.media import VIDEO_CLOCK_HZ, CaptureStamp, VideoFrame
from kontur_av.rtp.sdp import VIDEO_PAYLOAD_TYPE, StreamDescription, write_sdp
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from kontur_av.streams.budget import Pacer

WIDTH, HEIGHT, FPS = 640, 480, 30


def picture_at(seconds: float) -> np.ndarray:
    """An RGB picture, shape (HEIGHT, WIDTH, 3), dtype uint8: a disc that circles on a slope."""
    picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    picture[:] = np.linspace(30, 110, WIDTH, dtype=np.uint8)[:, None]
    centre = (int(320 + 180 * np.cos(seconds)), int(240 + 140 * np.sin(seconds)))
    cv2.circle(picture, centre, 40, (240, 160, 40), -1, cv2.LINE_AA)
    return picture


def send(host: str, port: int, cap_bps: int, seconds: float) -> Pacer:
    clock = MonotonicClock()
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=cap_bps)
    pacer = Pacer(cap_bps=cap_bps, slack_ns=NS_PER_S // FPS)
    rtp = RtpSender(
        payload_type=VIDEO_PAYLOAD_TYPE,
        clock_rate_hz=VIDEO_CLOCK_HZ,
        ssrc=secrets.randbits(32),
        first_sequence=secrets.randbits(16),
        timestamp_offset=secrets.randbits(32),
        cname="send-numpy",
        max_payload_octets=min(1200, pacer.max_payload_octets),
    )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as udp:
        start_ns = due_ns = now_ns = clock.now_ns()
        sequence = 0
        while now_ns - start_ns < seconds * NS_PER_S:
            # 1. A picture is due: encode it, unless those before it still fill the channel.
            if now_ns >= due_ns:
                due_ns += NS_PER_S // FPS
                if pacer.ready_for_picture(now_ns):
                    rgb = picture_at((now_ns - start_ns) / NS_PER_S)
                    i420 = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420)
                    frame = VideoFrame(i420, CaptureStamp(now_ns, sequence, "numpy"))
                    packets = rtp.video_packets(encoder.encode(frame, clock.now_ns))
                    sizes = [len(packet) - RTP_HEADER_OCTETS for packet in packets]
                    pacer.handle_access_unit(packets, sizes, clock.now_ns())
                sequence += 1
            # 2. Send what may leave now, and a sender report when one is due.
            now_ns = clock.now_ns()
            while (packet := pacer.poll_transmit(now_ns)) is not None:
                udp.sendto(packet, (host, port))
            if (report := rtp.poll_report(now_ns, clock.ntp)) is not None:
                udp.sendto(report, (host, port + 1))
            # 3. Sleep until the next thing is due.
            wake_ns = min(t for t in (due_ns, pacer.poll_timeout(), rtp.poll_timeout()) if t)
            clock.sleep_until_ns(wake_ns)
            now_ns = clock.now_ns()
        if (goodbye := rtp.goodbye(clock.ntp)) is not None:
            udp.sendto(goodbye, (host, port + 1))
    return pacer


def main() -> None:
    parser = argparse.ArgumentParser(description="Send numpy pictures under a hard cap.")
    parser.add_argument("--to", default="127.0.0.1:5004", metavar="HOST:PORT")
    parser.add_argument("--cap-kbps", type=float, default=85)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--sdp", metavar="FILE", help="write what a receiver needs to know")
    arguments = parser.parse_args()
    host, _, port = arguments.to.rpartition(":")
    cap_bps = round(arguments.cap_kbps * 1000)
    if arguments.sdp:
        stream = StreamDescription(
            kind="video", host=host, port=int(port), payload_type=VIDEO_PAYLOAD_TYPE
        )
        Path(arguments.sdp).write_text(write_sdp(stream))
    sent = send(host, int(port), cap_bps, arguments.seconds)
    print(
        f"{sent.released_packets} packets, {sent.released.mean_bps() / 1000:.1f} kbit/s on "
        f"average, {sent.released.max_bps() / 1000:.1f} kbit/s in the largest second, "
        f"{sent.pictures_refused} pictures left out"
    )


if __name__ == "__main__":
    main()
