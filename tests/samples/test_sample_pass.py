"""samples/plot_pass.py runs, prints its table and draws its chart."""

import subprocess
import sys

import cv2
from places import ROOT

SAMPLE = ROOT / "samples" / "plot_pass.py"


def test_sample_shows_the_pass_and_draws_it(tmp_path):
    picture = tmp_path / "pass.png"
    done = subprocess.run(
        [sys.executable, str(SAMPLE), "--seconds", "120", "--picture", str(picture)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    lines = done.stdout.splitlines()
    assert lines[0].startswith("acquisition: 2015-08-18T14:32")
    first, second = (line.split() for line in lines[-2:])
    # In the first minute the signal comes and goes, in the second it stays.
    assert 10 < float(first[-4]) < 90
    assert float(second[-4]) < 1
    assert cv2.imread(str(picture)).shape == (900, 1200, 3)


def test_a_profile_that_cannot_be_read_is_one_line(tmp_path):
    (tmp_path / "mine.toml").write_text('[contact]\nelements = "iss.tle"\n')
    run = subprocess.run(
        [sys.executable, SAMPLE, "--radio", tmp_path / "mine.toml"], capture_output=True, text=True
    )
    assert (run.returncode, run.stdout, run.stderr.count("\n")) == (2, "", 1)
    assert "iss.tle" in run.stderr
