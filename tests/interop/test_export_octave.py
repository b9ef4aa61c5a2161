"""scipy and GNU Octave read the same numbers from a MATLAB file of an export."""

import shutil
import subprocess

import numpy as np
import pytest
from scipy.io import loadmat
from synthetic_recording import write_recording

from pipelines.cli import main

pytestmark = [
    pytest.mark.interop,
    pytest.mark.skipif(
        shutil.which("octave-cli") is None, reason="octave-cli: apt-get install octave"
    ),
]

#: Octave prints what it has read: for each column its class, length and numbers.
SCRIPT = """
tables = load('out.mat');
printf('%s\\n', tables.recording.session);
for name = {'haptic_up', 'haptic_down', 'events', 'link_uplink_sent', 'uplink_video_received'}
  table = tables.(name{1});
  for field = fieldnames(table)'
    column = table.(field{1});
    if iscell(column)
      printf('%s %s text %s\\n', name{1}, field{1}, strjoin(column', '|'));
    else
      printf('%s %s %s', name{1}, field{1}, class(column));
      printf(' %.17g', column);
      printf('\\n');
    end
  end
end
touched = tables.events.haptic_up_row(strcmp(tables.events.what, 'touch'));
printf('%d ', tables.haptic_up.contact(touched), tables.haptic_up.contact(touched - 1));
"""
CLASSES = {"float64": "double", "float32": "single"}


def test_octave_and_scipy_read_the_same_numbers(tmp_path):
    recording = write_recording(tmp_path / "a.mcap")
    assert main(["export", str(recording.paths[0]), "--mat", str(tmp_path / "out.mat")]) == 0
    done = subprocess.run(
        ["octave-cli", "--quiet", "--no-init-file", "--eval", SCRIPT],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
    )
    session, *lines, touched = done.stdout.splitlines()
    assert session == "kontur-1"
    found = loadmat(tmp_path / "out.mat", simplify_cells=True)
    columns = 0
    for line in lines:
        table, field, kind, *told = line.split(" ", 3)
        column = found[table][field]
        columns += 1
        if kind == "text":
            assert told == ["|".join(column)]
            continue
        numbers = np.array(told[0].split(), float)
        assert len(numbers) == len(column)
        assert np.array_equal(numbers, np.asarray(column, float), equal_nan=True), line[:60]
        if kind != "logical":
            assert kind == CLASSES.get(column.dtype.name, column.dtype.name)
    assert columns > 60
    # Rows count from 1 there: each contact begins in its row.
    assert touched.split() == ["1"] * 3 + ["0"] * 3
