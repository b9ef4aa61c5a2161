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
    # The stylus in the middle is whole from one camera, so the seam is beside it. The conversion
    # to RGB interpolates chroma, so the columns at the seam are left out.
    (seams,) = np.nonzero((merged != left).any(axis=(0, 2)))
    seam = seams[0]
    assert 64 < abs(seam - 320) < 320
    assert np.array_equal(merged[:, : seam - 4], left[:, : seam - 4])
    assert np.array_equal(merged[:, seam + 4 :], right[:, seam + 4 :])
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
