"""A server of rtsp-rs: `python rtsp_rs_server.py PORT` sends a test picture as /stream, by UDP."""

import sys
import time
from fractions import Fraction

import av
import numpy as np
import rtsp


def main(port):
    server = rtsp.Server(f"127.0.0.1:{port}")
    server.start()
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 320, 240, "yuv420p"
    encoder.time_base = Fraction(1, 30)
    encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "15"}
    ramp = np.arange(240 * 320, dtype=np.uint8).reshape(240, 320)
    while True:
        ramp = np.roll(ramp, 1)
        for packet in encoder.encode(av.VideoFrame.from_ndarray(ramp, format="gray8")):
            server.send_frame(bytes(packet), 3000)
        time.sleep(1 / 30)


if __name__ == "__main__":
    main(sys.argv[1])
