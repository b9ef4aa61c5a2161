"""`python -m benchmarks haptics`: a cell, its figures and its claims."""

import json

import numpy as np
from mcap.reader import make_reader

from benchmarks.__main__ import main
from benchmarks.haptics.cell import read_cell
from benchmarks.haptics.haptics_metrics import metrics
from benchmarks.haptics.run import COLUMNS, run_cell

CELL = ["--cell", "delay=100", "--jobs", "1"]
ACTIVE = """
from telepresence.haptics.joystick_controller import JoystickController
from telepresence.haptics.robot_controller import RobotController

class Joystick(JoystickController):
    def __init__(self):
        super().__init__(passive=False)

class Robot(RobotController):
    def __init__(self, *, x_m, y_m):
        super().__init__(passive=False, x_m=x_m, y_m=y_m)
"""


def test_the_command_writes_its_metrics(tmp_path, capsys):
    report = tmp_path / "h.json"
    bare = ["--cell", "delay=100,passive=off"]
    assert main(["haptics", *CELL, *bare, "--report", str(report)]) == 0
    found = json.loads(report.read_text())
    assert all(claim["holds"] for claim in found["claims"])
    assert [row["unstable"] for row in found["cells"]] == [False, True]
    swings = [row for row in found["summaries"] if row["figure"] == "swing_n"]
    assert swings[-1]["worst_cell"] == "delay=100,wall=5000,passive=off"
    assert "without controllers" in capsys.readouterr().out


def test_a_controller_that_makes_energy_breaks_the_claims(tmp_path, monkeypatch, capsys):
    (tmp_path / "active.py").write_text(ACTIVE)
    monkeypatch.chdir(tmp_path)
    own = ["--controller", "active:Joystick", "--robot-controller", "active:Robot"]
    assert main(["haptics", *CELL, *own, "--report", "b.json"]) == 1
    found = json.loads((tmp_path / "b.json").read_text())
    assert not any(claim["holds"] for claim in found["claims"] if "energy" in claim["text"])
    assert found["cells"][0]["network_uj"] > 1000.0
    assert "NO" in capsys.readouterr().out


def test_a_trace_is_read_back_with_units_and_bears_its_metrics(tmp_path):
    text = "delay=30,loss=5,wall=500,angle=90"
    assert main(["haptics", "--cell", text, "--traces", str(tmp_path), "--jobs", "1"]) == 0
    (path,) = tmp_path.glob("*.mcap")
    cell = read_cell(text)
    planned, course = run_cell(cell, seed=1)
    with path.open("rb") as file:
        reader = make_reader(file)
        (schema,) = reader.get_summary().schemas.values()
        about = {record.name: record.metadata for record in reader.iter_metadata()}
        read = [(m.log_time, json.loads(m.data)) for _, _, m in reader.iter_messages()]
    units = {name: value["unit"] for name, value in json.loads(schema.data)["properties"].items()}
    assert (units["handle_x"], units["drive_y"], units["motor_work"]) == ("m", "N", "J")
    assert [at for at, _ in read] == [row * 1_000_000 for row in range(len(course))]
    for name in COLUMNS:
        assert np.allclose([row[name] for _, row in read], course[name], rtol=1e-6, atol=1e-9)
    assert about["cell"]["hand"] == "soft"
    assert (about["cell"]["wall"], about["cell"]["seed"]) == ("500.0", "1")
    assert about["figures"]["felt_first"] == str(metrics(cell, planned, course).felt_first)
    assert read[-1][1]["commands_lost"] > 100
    assert read[-1][1]["command_delay"] == 15.0
