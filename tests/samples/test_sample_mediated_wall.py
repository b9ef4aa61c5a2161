"""samples/mediated_wall.py prints its table and draws its chart."""

import subprocess
import sys

import cv2
from places import ROOT

SAMPLE = ROOT / "samples" / "mediated_wall.py"


def test_sample_shows_what_is_felt_and_draws_it(tmp_path):
    picture = tmp_path / "felt.png"
    done = subprocess.run(
        [sys.executable, str(SAMPLE), "--delays", "300", "--picture", str(picture)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    felt = {(row[2], row[3]): float(row[6]) for row in rows}
    for grip in ("soft", "firm"):
        assert felt[grip, "mediated"] > 2 * felt[grip, "direct"]
    assert cv2.imread(str(picture)).shape == (400, 700, 3)
