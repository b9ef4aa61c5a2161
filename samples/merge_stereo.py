"""Merge a stereo pair: the left part of the left picture, the right part of the right one.

python samples/merge_stereo.py LEFT RIGHT MERGED          (files that OpenCV reads, of one size)
"""

import sys

import cv2
import numpy as np

from kontur_av.sources import SeamFinder, merge

pair = []
for path in sys.argv[1:3]:
    if (read := cv2.imread(path)) is None:
        sys.exit(f"{path} is no picture that OpenCV can read")
    height, width = read.shape[0] & ~3, read.shape[1] & ~1
    pair.append(cv2.cvtColor(read[:height, :width], cv2.COLOR_BGR2YUV_I420))
left, right = pair
merged, finder = np.empty_like(left), SeamFinder()
# The seam goes to its place in steps, as for a film.
for _ in range(20):
    merge(left, right, into=merged, seam=finder.handle_pictures(left, right))
cv2.imwrite(sys.argv[3], cv2.cvtColor(merged, cv2.COLOR_YUV2BGR_I420))
