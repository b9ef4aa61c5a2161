"""Receive a stream of pictures as numpy arrays; the other end of send_numpy.py.

python samples/receive_numpy.py picture.sdp 10                            (SDP file, seconds)
"""

import secrets
import sys
from pathlib import Path

import cv2
import numpy as np

import kontur_av as av


def handle(picture: np.ndarray, age_ms: float, quality: av.Quality) -> None:
    """Replace this. picture: RGB, shape (height, width, 3), dtype uint8."""
    print(f"{picture.shape}, {age_ms:.1f} ms old, {quality.name}, mean {picture.mean():.0f}")


stream = av.parse_sdp(Path(sys.argv[1]).read_text())
clock, udp = av.MonotonicClock(), av.UdpReceiver(stream.host, stream.port)
ssrc, decoder = secrets.randbits(32), av.H264Decoder()
about = {"wall_offset_ns": clock.wall_offset_ns, "reduced_size": stream.reduced_size}
receiver = av.VideoReceiver(ssrc=ssrc, **about)
end_ns = clock.now_ns() + int(sys.argv[2]) * 10**9
while (left_ns := end_ns - clock.now_ns()) > 0 and not receiver.ended:
    udp.exchange(receiver, clock, left_ns)
    while (unit := receiver.next_event()) is not None:
        for decoded in decoder.decode(unit.data, unit.timestamp):
            size = decoded.width, decoded.height
            capture_ns = receiver.capture_ns(decoded.timestamp)
            stamp = receiver.handle_picture(decoded.timestamp, *size, capture_ns)
            if stamp is not None:  # otherwise no sender report has said how old it is
                picture = cv2.cvtColor(decoded.to_i420(), cv2.COLOR_YUV2RGB_I420)
                handle(picture, (clock.now_ns() - stamp.capture_ns) / 1e6, stamp.quality)
udp.close()
print(receiver.counts)
