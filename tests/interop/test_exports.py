"""FFmpeg, GNU Octave, scipy and LeRobot read what `kontur-av export` has written."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from programs import needs
from synthetic_recording import write_recording

from pipelines.cli import main

pytestmark = pytest.mark.interop

#: Octave prints what it has read: for each column its class, length and numbers.
OCTAVE = """
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
LEROBOT = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
found = LeRobotDataset("test/set", root=sys.argv[1])
rows = [found[number] for number in range(len(found))]
print(json.dumps({
    "actions": [row["action"].tolist() for row in rows],
    "shapes": sorted({tuple(row["observation.images.head"].shape) for row in rows}),
    "tasks": sorted({row["task"] for row in rows}),
    "rows": found.meta.total_frames,
}))
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The path of a recording with three contacts."""
    return write_recording(tmp_path_factory.mktemp("recording") / "a.mcap").paths[0]


def run(*command, cwd=None):
    return subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=300, cwd=cwd
    )


def test_ffmpeg_decodes_every_film_without_an_error(recording, tmp_path):
    needs("ffmpeg")
    assert main(["export", str(recording), "--mkv", str(tmp_path)]) == 0
    for path in tmp_path.iterdir():
        # These keep the instants as they are.
        ends = ("-fps_mode", "passthrough", "-enc_time_base", "-1", "-f", "null", "-")
        done = run("ffmpeg", "-v", "error", "-xerror", "-i", path, *ends)
        assert (path.name, done.returncode, done.stderr) == (path.name, 0, "")


def test_octave_and_scipy_read_the_same_numbers(recording, tmp_path):
    needs("octave-cli")
    io = pytest.importorskip("scipy.io", reason="scipy: pip install 'kontur-av[export]'")
    assert main(["export", str(recording), "--mat", str(tmp_path / "out.mat")]) == 0
    done = run("octave-cli", "--quiet", "--no-init-file", "--eval", OCTAVE, cwd=tmp_path)
    session, *lines, touched = done.stdout.splitlines()
    assert session == "kontur-1"
    found = io.loadmat(tmp_path / "out.mat", simplify_cells=True)
    for line in lines:
        table, field, kind, *told = line.split(" ", 3)
        column = found[table][field]
        if kind == "text":
            assert told == ["|".join(column)]
            continue
        numbers = np.array(told[0].split(), float)
        assert np.array_equal(numbers, np.asarray(column, float), equal_nan=True), line[:60]
        if kind != "logical":
            assert kind == CLASSES.get(column.dtype.name, column.dtype.name)
    assert len(lines) > 60
    # Rows count from 1 there: each contact begins in its row.
    assert touched.split() == ["1"] * 3 + ["0"] * 3


def test_lerobot_reads_every_row(recording, tmp_path):
    info = shutil.which("lerobot-info")
    if info is None:
        # It needs an environment of its own, with torch.
        pytest.skip("this machine has no lerobot-info: pip install lerobot")
    import pyarrow.parquet as pq

    folder = tmp_path / "set"
    assert main(["export", str(recording), "--lerobot", str(folder)]) == 0
    done = run(Path(info).with_name("python"), "-c", LEROBOT, folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    rows = pq.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict()
    assert found["rows"] == len(rows["index"]) > 20
    assert found["actions"] == [pytest.approx(action) for action in rows["action"]]
    assert (found["shapes"], found["tasks"]) == ([[3, 240, 320]], ["spacejustin"])
