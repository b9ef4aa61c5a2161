"""`kontur-av task list`: what can be selected, and why something cannot."""

from pipelines.commands.task import _print
from pipelines.mission.mission import MissionGround
from telepresence.tasks.plan import TaskWorld
from telepresence.tasks.task_files import built_in_tasks


def test_a_task_that_cannot_be_done_here_is_listed_with_the_reason(capsys):
    world = TaskWorld(cameras=("stereo",), setup="lab", measures=False)
    _print(MissionGround(built_in_tasks(), None, now_ns=0, world=world).shown)
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    for name in built_in_tasks().tasks:
        assert ("Not available: it needs two hands" in lines[name]) is (
            name in ("handshake", "ball")
        )
    assert "it needs a robot that measures the force" in lines["spring"]
    assert "it selects the camera static, and setup lab has stereo" in lines["pursuit"]
    assert "Not available" not in lines["aiming"]
