"""Send your own numpy pictures as H.264 over RTP/UDP, under a hard cap: replace `picture_at`.

python samples/send_numpy.py 127.0.0.1 5004 85 picture.sdp 10       (kbit/s, SDP file, seconds)
"""

import secrets
import sys
from pathlib import Path

import cv2
import numpy as np

import kontur_av as av


def picture_at(number: int) -> np.ndarray:  # RGB, shape (480, 640, 3), dtype uint8
    centre = int(320 + 180 * np.cos(number / 30)), int(240 + 140 * np.sin(number / 30))
    return cv2.circle(np.full((480, 640, 3), 60, np.uint8), centre, 40, (240, 160, 40), -1)


host, port, cap_bps = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]) * 1000
stream = av.StreamDescription(kind="video", host=host, port=port, payload_type=96, feedback=True)
Path(sys.argv[4]).write_text(av.write_sdp(stream))
clock, udp = av.MonotonicClock(), av.UdpSender(host, port)
encoder = av.H264Encoder(width=640, height=480, fps=30, cap_bps=cap_bps)
about = {"cname": "numpy", "wall_offset_ns": clock.wall_offset_ns}
identity = av.RtpIdentity.draw(secrets.randbits)
sender = av.VideoSender(cap_bps=cap_bps, fps=30, identity=identity, **about)
begin_ns = clock.now_ns()
for number in range(30 * int(sys.argv[5])):
    i420 = cv2.cvtColor(picture_at(number), cv2.COLOR_RGB2YUV_I420)
    frame = av.VideoFrame(i420, av.CaptureStamp(clock.now_ns(), number, "numpy"))
    sender.handle_picture(frame.stamp, clock.now_ns())
    while (now_ns := clock.now_ns()) < begin_ns + (number + 1) * 10**9 // 30:
        if (coding := sender.poll_encode(now_ns)) is not None:
            sender.handle_access_unit(encoder.encode(frame, coding), clock.now_ns())
        udp.exchange(sender, clock)
        clock.sleep_until_ns(now_ns + 10**6)
udp.say_goodbye(sender, clock)
print(f"{sender.counts}, {sender.released.max_bps() / 1000:.1f} kbit/s in the largest second")
