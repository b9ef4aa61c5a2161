"""Merge a stereo pair: the left part of the left picture, the right part of the right one.

    python samples/merge_stereo.py [DIRECTORY [LEFT RIGHT]]

Takes two pictures of one size (any format that OpenCV reads), or draws the built-in task board
with its stylus in the middle. Writes left.png, right.png and merged.png into DIRECTORY.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from kontur_av.media import I420, empty_picture
from kontur_av.sources import SeamFinder, merge
from telepresence import WorldState, render


def load(path: str) -> I420:
    picture = cv2.imread(path)
    if picture is None:
        raise SystemExit(f"{path} is no picture that OpenCV can read")
    height, width = picture.shape[0] & ~3, picture.shape[1] & ~1
    return np.asarray(cv2.cvtColor(picture[:height, :width], cv2.COLOR_BGR2YUV_I420), np.uint8)


def look(camera: str) -> I420:
    picture = empty_picture(640, 480)
    render(camera, WorldState(time_ns=0, x_m=0.0, y_m=-0.02), picture)
    return picture


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    if len(sys.argv) > 3:
        left, right = load(sys.argv[2]), load(sys.argv[3])
    else:
        left, right = look("left"), look("right")
    merged, finder = np.empty_like(left), SeamFinder()
    # It goes to its place in steps, as for a film.
    for _ in range(20):
        merge(left, right, into=merged, seam=finder.handle_pictures(left, right))
    for name, picture in (("left", left), ("right", right), ("merged", merged)):
        path = folder / f"{name}.png"
        cv2.imwrite(str(path), cv2.cvtColor(picture, cv2.COLOR_YUV2BGR_I420))
        print(path)


if __name__ == "__main__":
    main()
