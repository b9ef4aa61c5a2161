"""Send your own numpy pictures as H.264 over RTP, under a hard cap: replace `picture_at`.

python samples/send_numpy.py localhost:5004 85 picture.sdp 10        (kbit/s, SDP file, seconds)
"""

import sys

import cv2
import numpy as np

import kontur_av as ka


def picture_at(number: int) -> np.ndarray:  # RGB, shape (480, 640, 3), dtype uint8
    centre = int(320 + 180 * np.cos(number / 30)), int(240 + 140 * np.sin(number / 30))
    return cv2.circle(np.full((480, 640, 3), 60, np.uint8), centre, 40, (240, 160, 40), -1)


to, cap_bps, sdp, seconds = sys.argv[1], 1000 * int(sys.argv[2]), sys.argv[3], int(sys.argv[4])
with ka.PictureSender(to, cap_bps=cap_bps, sdp=sdp) as end:
    for number in range(30 * seconds):
        end.send(picture_at(number))
print(f"{end.counts}, {end.largest_bps / 1000:.1f} kbit/s in the largest second")
