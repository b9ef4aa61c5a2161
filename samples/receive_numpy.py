"""Receive a stream of pictures as numpy arrays; the other end of send_numpy.py.

python samples/receive_numpy.py picture.sdp 100                          (SDP file, pictures)
"""

import sys

import kontur_av as av

with av.StreamReceiver(sys.argv[1]) as pictures:
    for _, one in zip(range(int(sys.argv[2])), pictures, strict=False):
        mean = one.data.mean()  # RGB, shape (height, width, 3), dtype uint8
        age = "no age yet" if one.age_ms is None else f"{one.age_ms:.1f} ms old"
        print(f"{one.data.shape}, {age}, {one.quality.name}, mean {mean:.0f}")
print(f"{pictures.skipped} skipped; {pictures.ended}")
