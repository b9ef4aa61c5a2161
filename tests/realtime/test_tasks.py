"""Tasks in a live session: a simulated cosmonaut does them, whatever is killed meanwhile."""

import re

import numpy as np
from mcap.reader import make_reader
from running_session import BOARD, eventually, restarted

from kontur_av.clock import NS_PER_MS
from pipelines.hand.haptic_trace import DEAD_MAN
from pipelines.recording.recorded_messages import unpack_haptics
from pipelines.session.mission_messages import (
    MISSION_GROUND_TOPIC,
    ROBOT_STATUS_TOPIC,
    ExperimentShown,
    RobotStatus,
)
from pipelines.session.topic_ends import TopicReader

#: Rows in which what was led before may still settle.
_SETTLE_ROWS = 200
PLAN = """
skill = 1.0
files = ["short.xml"]
[[task]]
name = "reach"
[[task]]
name = "roam"
"""
#: A task that ends soon, and one that does not end by itself during the test.
TASKS = """<Tasks>
  <Operation name="execReach">
    <Operation ref="beginTelepresence"/>
    <Elemop ref="highlightLed7"/>
    <Elemop ref="checkPos7"/>
    <Elemop ref="highlightLed0"/>
    <Elemop ref="checkPos0"/>
    <Operation ref="endTelepresence"/>
  </Operation>
  <Task name="reach" start="startAiming" exec="execReach" start_x_mm="-45" start_y_mm="0"
        text="Reach each LED that lights up."/>
  <Wait name="roamFreely" seconds="300"/>
  <Operation name="execRoam">
    <Operation ref="beginTelepresence"/>
    <Elemop ref="roamFreely"/>
    <Operation ref="endTelepresence"/>
  </Operation>
  <Task name="roam" start="startFree" exec="execRoam" start_x_mm="-45" start_y_mm="0" text="Roam."/>
</Tasks>
"""


class Watched:
    """What the topics of a session say."""

    def __init__(self, bus):
        self._readers = {
            ExperimentShown: TopicReader(bus, MISSION_GROUND_TOPIC),
            RobotStatus: TopicReader(bus, ROBOT_STATUS_TOPIC),
        }

    def see(self, kind):
        self._readers[kind].latest()
        return self._readers[kind].newest

    def wait_for_telepresence(self, run):
        def there():
            experiment, robot = self.see(ExperimentShown), self.see(RobotStatus)
            driven = robot and robot.powered and robot.mode == "telepresence"
            return experiment and experiment.run == run and experiment.phase == "running" and driven

        eventually(there, f"telepresence in run {run}")

    def wait_for_result(self, run):
        def over():
            shown = self.see(ExperimentShown)
            rows = {row.run: row for row in shown.runs} if shown else {}
            return rows.get(run)

        return eventually(over, f"the end of run {run}")


def led_without_dead_man_m(path):
    """How far the tip went after the dead-man button had been let go for a while (m)."""
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(["/haptic/up/sent"])
        rows = np.concatenate([unpack_haptics(message.data) for _, _, message in found])
    free = np.convolve(rows["flags"] & DEAD_MAN, np.ones(_SETTLE_ROWS))[: len(rows)] == 0
    free[:_SETTLE_ROWS] = False
    steps = np.hypot(np.diff(rows["x_m"]), np.diff(rows["y_m"]))
    # Between rows that a busy recorder lost, the button may have been held.
    near = np.diff(rows["time_ns"]) < 5 * NS_PER_MS
    return steps[free[1:] & free[:-1] & near].sum()


def test_tasks_are_done_or_aborted_whatever_is_killed(start, tmp_path, monkeypatch):
    plan, runs = tmp_path / "plan.toml", tmp_path / "runs"
    plan.write_text(PLAN)
    (tmp_path / "short.xml").write_text(TASKS)
    session = start(BOARD, "--radio", "clean", "--plan", str(plan), "--runs", str(runs))
    pids = session.pids()
    with session.bus(monkeypatch) as bus:
        watched = Watched(bus)
        # The LED panel comes back with what it is told ten times a second.
        watched.wait_for_telepresence(1)
        session.kill(pids, "leds")
        row = watched.wait_for_result(1)
        assert row.result == "finished", row
        # A panel that has forgotten its task is told it again.
        eventually(lambda: watched.see(ExperimentShown).panel == "hold", "a held handle")
        assert watched.see(ExperimentShown).run == 2
        session.kill(pids, "panel")
        watched.wait_for_telepresence(2)
        # The controller goes on without the kernel, whose next start switches the robot off.
        boot_id = watched.see(RobotStatus).boot_id
        session.kill(pids, "tasks")
        row = watched.wait_for_result(2)
        assert (row.result, row.reason) == ("aborted", "the task's process was restarted")
        eventually(lambda: not watched.see(RobotStatus).powered, "the robot without power")
        assert watched.see(RobotStatus).boot_id == boot_id
        listed = session.ask("task", "list").stdout
        reason = "the task's process was restarted"
        assert re.search(rf"^run 2 roam: aborted after [\d.]+ s: {reason}$", listed, re.MULTILINE)
        eventually(lambda: watched.see(ExperimentShown).run == 3, "run 3")
        assert session.ask("task", "select", "line").returncode == 1
        aborted = session.ask("task", "abort")
        assert aborted.returncode == 0, (aborted.stderr, watched.see(ExperimentShown))
        assert watched.wait_for_result(3).reason == "somebody on the ground ended it"
    report = session.finish()
    rows = report["tasks"]
    assert [row["run"] for row in rows] == [1, 2, 3]
    assert [row["result"] for row in rows] == ["finished", "aborted", "aborted"]
    assert set(restarted(report)) == {"leds", "panel", "tasks"}
    # Each run has its own file, also the one after the run that a killed process left open.
    files = sorted(runs.iterdir())
    assert [path.name for path in files] == [
        "run-001-reach.mcap",
        "run-002-roam.mcap",
        "run-003-roam.mcap",
    ]
    assert report["processes"]["tasks"]["counts"]["unrecorded"] == 0
    for path in files:
        assert led_without_dead_man_m(path) < 1e-6, path.name
