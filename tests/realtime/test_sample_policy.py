"""samples/policy.py in a session: it aims three times, and a person takes over in the fourth."""

import subprocess
import sys

from page_client import hand, visiting
from positions import ROOT
from running_session import BOARD, RunningSession, eventually, tcp_port

from pipelines.session.mission_messages import ROBOT_TOPIC
from pipelines.session.topic_ends import TopicReader

SAMPLE = ROOT / "samples" / "policy.py"
OPTIONS = ("--joystick", "page", "--page", str(tcp_port()))


async def test_it_aims_three_times_and_hands_over_in_the_fourth(tmp_path, monkeypatch):
    said = tmp_path / "policy.txt"
    with RunningSession(BOARD, *OPTIONS, directory=tmp_path) as session:
        session.wait_for_flow()
        command = [sys.executable, str(SAMPLE)]
        with said.open("w") as out, session.bus(monkeypatch) as bus:
            program = subprocess.Popen(command, stdout=out, stderr=out, env=session.environment)
            robot = TopicReader(bus, ROBOT_TOPIC)
            async with visiting(session.pages()["space"]) as visitor, visitor.page() as page:
                while (await page.text("state"))["hand"]["policy"] != "Reach":
                    pass
                # The joystick calibrates first.
                while not (await page.ask("hand", action="policy"))["ok"]:
                    await page.text("state")
                while said.read_text().count("reached") < 3:
                    state = await page.text("state")
                    assert state["hand"]["who"] in ("the policy Reach", ""), state
                    if not state["hand"]["who"]:
                        # A program that was late has let go.
                        await page.ask("hand", action="policy")
                assert (await page.ask("hand", action="take"))["ok"]
                for _ in range(5):
                    state = await page.text("state")
                assert state["hand"]["you"]
                moved_m, number = 0.0, 0
                # A page that was late has let go: it presses anew, and goes on from there.
                while moved_m > -0.01:
                    began = eventually(robot.latest, "the robot's place")
                    for step in range(-9, 61):
                        number += 1
                        way = {"dead_man": step > 0, "y": -0.01 * min(max(step, 0), 30)}
                        await page.ws.send_bytes(hand(number, **way))
                        await page.text("state") if number % 10 == 0 else None
                    moved_m = eventually(robot.latest, "the robot's place").y_m - began.y_m
                    assert moved_m > -0.04
            report = session.finish(clean=False)
            assert program.wait(20) == 0 and said.read_text().count("reached") == 3, (
                said.read_text()
            )
    seat = report["processes"]["page_space"]["counts"]
    assert seat["driven_ms_policy"] > 0 < seat["driven_ms_person"]
