"""samples/merge_stereo.py writes the pair and the merged picture."""

import subprocess
import sys

import cv2
import numpy as np
from places import ROOT

SAMPLE = ROOT / "samples" / "merge_stereo.py"


def test_merges_the_built_in_pair(tmp_path):
    subprocess.run([sys.executable, SAMPLE, tmp_path], check=True, timeout=60)
    left, right, merged = (
        cv2.imread(str(tmp_path / f"{n}.png")) for n in ("left", "right", "merged")
    )
    # The conversion to RGB interpolates chroma, so the columns at the seam are left out.
    assert np.array_equal(merged[:, :316], left[:, :316])
    assert np.array_equal(merged[:, 324:], right[:, 324:])
    assert not np.array_equal(left, right)


def test_merges_two_files(tmp_path):
    for name, level in (("a", 60), ("b", 200)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((66, 96, 3), level, np.uint8))
    command = [sys.executable, SAMPLE, tmp_path, tmp_path / "a.png", tmp_path / "b.png"]
    subprocess.run(command, check=True, timeout=60)
    merged = cv2.imread(str(tmp_path / "merged.png"))
    assert merged.shape == (64, 96, 3)
    assert abs(int(merged[20, 10, 0]) - 60) < 3
    assert abs(int(merged[20, 90, 0]) - 200) < 3
