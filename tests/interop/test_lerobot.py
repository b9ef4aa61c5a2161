"""LeRobot itself, from an environment of its own, reads a data set of `export --lerobot`."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from synthetic_recording import write_recording

from pipelines.cli import main

LEROBOT = shutil.which("lerobot-info")
pytestmark = [
    pytest.mark.interop,
    pytest.mark.skipif(LEROBOT is None, reason="lerobot-info: pip install lerobot"),
]
READ = """
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


def test_lerobot_reads_every_row(tmp_path):
    import pyarrow.parquet as pq

    recording = write_recording(tmp_path / "a.mcap")
    folder = tmp_path / "set"
    assert main(["export", str(recording.paths[0]), "--lerobot", str(folder)]) == 0
    python = Path(LEROBOT).with_name("python")
    done = subprocess.run(
        [python, "-c", READ, folder], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    rows = pq.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict()
    assert found["rows"] == len(rows["index"]) > 20
    assert found["actions"] == [pytest.approx(action) for action in rows["action"]]
    assert found["shapes"] == [[3, 240, 320]]
    assert found["tasks"] == ["spacejustin"]
