"""Receive a stream of pictures as numpy arrays; the other end of send_numpy.py.

python samples/receive_numpy.py picture.sdp 100                          (SDP file, pictures)
"""

import sys

import kontur_av as ka

with ka.StreamReceiver(sys.argv[1]) as pictures:
    for _, one in zip(range(int(sys.argv[2])), pictures, strict=False):
        mean = one.data.mean()  # RGB, shape (height, width, 3), dtype uint8, in the size as sent
        state = "damaged" if one.damaged else "whole"
        print(
            f"{one.sequence}: {one.data.shape}, {one.age_ms:.1f} ms old, {state}, mean {mean:.0f}"
        )
print(f"{pictures.skipped} skipped; {pictures.ended}")
