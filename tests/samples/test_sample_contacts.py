"""samples/plot_contacts.py finds each contact of a recording, and draws them."""

import subprocess
import sys

import cv2
from places import ROOT
from synthetic_recording import BEGIN_NS, LINK_NS, MS, PUBLISHED_NS, TOUCH_S, S, write_recording

SAMPLE = ROOT / "samples" / "plot_contacts.py"


def run(*words):
    return subprocess.run(
        [sys.executable, SAMPLE, *words], capture_output=True, text=True, timeout=120
    )


def test_sample_lists_and_draws_each_contact(tmp_path):
    recording = write_recording(tmp_path / "a.mcap", parts=2)
    picture = tmp_path / "contacts.png"
    done = run(*recording.paths, "--picture", picture)
    assert (done.returncode, done.stderr) == (0, "")
    rows = [[float(word) for word in line.split()] for line in done.stdout.splitlines()[1:]]
    begins = [(first - BEGIN_NS) / S for first, _ in recording.contacts]
    assert [row[1] for row in rows] == [round(begin, 2) for begin in begins]
    for _, _, length_s, most_n, late_ms in rows:
        assert round(length_s, 2) == TOUCH_S
        assert round(most_n, 1) == 3.0
        assert late_ms == (LINK_NS + PUBLISHED_NS) / MS
    assert cv2.imread(str(picture)).shape == (900, 1200, 3)


def test_a_file_that_is_torn_is_one_line(tmp_path):
    (path,) = write_recording(tmp_path / "a.mcap", end=False).paths
    done = run(path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "a.mcap is no whole recording" in done.stderr
