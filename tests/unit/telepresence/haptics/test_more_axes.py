"""Axes behind x and y: the same guarantees as x and y, each by itself, at any delay."""

from collections import deque
from dataclasses import replace
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.session.setup.setup_file import TASKBOARD
from telepresence.haptics.axes import (
    AXIS_OCTETS,
    MOST_AXIS_ENERGY_UJ,
    AxisFacts,
    AxisReading,
    check_axes,
    pack_axes,
    read_axes,
)
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.robot import Robot, RobotFacts
from telepresence.haptics.robot_device import DrivenRobot, RobotReading
from telepresence.haptics.sample import POSITION_M, SAMPLE_OCTETS
from telepresence.link.profile import UPLINK

NAMES = ("z", "yaw", "gripper")
Z = AxisFacts(name="z", half_range=0.1, force_limit=10.0, speed=0.5)
YAW = AxisFacts(name="yaw", half_range=1.0, force_limit=0.5, speed=3.0)


class Pair:
    """Joystick and robot with a channel between them, a cycle of 1 ms a step."""

    def __init__(self, *, round_trip_ms, loss=0.0, robot=None):
        more = len(NAMES) if robot is None else len(robot.more)
        axes = NAMES if robot is None else [axis.facts.name for axis in robot.more]
        self.handle = OperatedHandle(SimulatedDevice(hand=Hand(), axes=axes))
        self.joystick = JoystickSide(handle=self.handle, link=joystick_link(life=5, more=more))
        self.robot = RobotSide(
            robot=robot or Robot(axes=NAMES),
            link=robot_link(life=7, more=more),
            envelope=SafetyEnvelope(),
        )
        self.cycle = 0
        self.carries = True
        self._lag, self._loss, self._random = round_trip_ms // 2, loss, Random(1)
        self._up, self._down = deque(), deque()

    def step(self):
        now_ns = self.cycle * NS_PER_MS
        ways = ((self._up, self.joystick), (self._down, self.robot))
        for way, side in ways:
            while way and way[0][0] <= self.cycle:
                side.handle_datagram(way.popleft()[1], now_ns)
        self.handle.handle_feedback(self.joystick.link.latest(now_ns))
        for way, side in ((self._down, self.joystick), (self._up, self.robot)):
            side.handle_cycle(now_ns, NS_PER_MS)
            sample = side.poll_transmit(now_ns)
            if sample is not None and self.carries and self._random.random() >= self._loss:
                way.append((self.cycle + self._lag, sample))
        self.cycle += 1


@pytest.mark.parametrize(("round_trip_ms", "loss"), [(0, 0.0), (60, 0.1), (300, 0.0)])
def test_each_axis_is_felt_and_gives_no_energy(round_trip_ms, loss):
    pair = Pair(round_trip_ms=round_trip_ms, loss=loss)
    felt, pushed = [0.0] * len(NAMES), [0.0] * len(NAMES)
    for _ in range(12_000):
        pair.step()
        felt = [max(old, -axis.force_n) for old, axis in zip(felt, pair.handle.more, strict=True)]
        pushed = [
            max(old, -axis.push_n) for old, axis in zip(pushed, pair.robot.robot.more, strict=True)
        ]
    assert min(pushed) > 2.0
    assert min(felt) > 0.5 * min(pushed)
    here, there = pair.joystick.axes.report(), pair.robot.axes.report()
    for name in NAMES:
        out_uj = here[name].energy_out_uj + there[name].energy_out_uj
        in_uj = here[name].energy_in_uj + there[name].energy_in_uj
        assert 0 < out_uj <= in_uj
        assert min(here[name].least_uj, there[name].least_uj) >= -1


def test_no_axis_moves_without_a_press_nor_jumps_at_one():
    pair = Pair(round_trip_ms=20)
    places = []
    for _ in range(9_000):
        # A loss of signal in between: afterwards the hand must press anew.
        pair.carries = not 4_000 < pair.cycle < 5_000
        pair.step()
        if not pair.robot.envelope.presses:
            assert all(axis.place_m == 0.0 for axis in pair.robot.robot.more)
        places.append(pair.robot.robot.more[0].place_m)
    assert pair.robot.envelope.presses == 2
    assert max(abs(after - before) for before, after in pairwise(places)) < 0.6e-3
    assert max(places) > 0.02


values = st.tuples(st.floats(-0.6, 0.6), st.integers(0, MOST_AXIS_ENERGY_UJ), st.booleans())


@given(st.lists(values, min_size=1, max_size=5))
def test_what_is_packed_is_read_back(sent):
    data = pack_axes(sent, [0] * len(sent), POSITION_M)
    assert len(data) == AXIS_OCTETS * len(sent)
    for (value, *rest), (heard, *read) in zip(sent, read_axes(data, POSITION_M), strict=True):
        assert abs(value - heard) <= 0.5 * POSITION_M + 1e-12
        assert read == rest


@given(st.binary(max_size=40))
def test_garbage_is_counted_and_nothing_else(data):
    link = robot_link(more=2)
    link.handle_datagram(data, 0)
    assert link.garbage + link.greetings + link.strays == 1


def test_a_count_that_is_never_sent_is_refused():
    with pytest.raises(ProtocolError, match="-32768"):
        read_axes(b"\x80\x00\x00\x00\x00", POSITION_M)


class Guide:
    """A user's robot with z and yaw, which moves without mass where it is pushed."""

    def __init__(self, takes="force"):
        self.facts = RobotFacts(name="guide", takes=takes, more=(Z, YAW))
        self.place, self.forces, self.active = [0.0, 0.0], [0.0, 0.0], False
        self.tip = (0.0, 0.0)
        self.broken = None

    def configure(self): ...

    power_on = power_off = configure

    def activate(self):
        self.active = True

    def deactivate(self):
        self.active, self.forces = False, [0.0, 0.0]

    def read(self):
        return RobotReading(*self.tip, 0.0, 0.0)

    def write_force(self, x_n, y_n): ...

    def write_position(self, x_m, y_m, vx_m_s, vy_m_s):
        self.tip = (x_m, y_m)

    def write_more_forces(self, forces):
        self.forces = list(forces)

    def write_more_positions(self, places, speeds):
        if self.active:
            self.place = list(places)

    def advance(self, dt_ns):
        if self.active and self.facts.takes == "force":
            self.place = [
                place + force * gain * dt_ns / 1e9
                for place, force, gain in zip(self.place, self.forces, (0.01, 20.0), strict=True)
            ]

    def read_more(self):
        if self.broken is not None:
            return [self.broken, AxisReading(0.0, 0.0)]
        return [AxisReading(place, 0.0) for place in self.place]


@pytest.mark.parametrize("takes", ["force", "position"])
def test_a_users_axes_are_driven(takes):
    device = Guide(takes)
    pair = Pair(round_trip_ms=0, robot=DrivenRobot(device))
    most = [0.0, 0.0]
    for _ in range(6_000):
        pair.step()
        most = [max(old, abs(new)) for old, new in zip(most, device.place, strict=True)]
    assert pair.robot.robot.error == ""
    # m and rad, as the facts have them.
    assert most[0] > 0.015
    assert most[1] > 0.2


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (AxisReading(float("nan"), 0.0), "z is not a number"),
        (AxisReading(0.2, 0.0), "outside of its range"),
        (AxisReading(0.0, 5.0), "beyond twice its speed"),
    ],
)
def test_an_axis_that_measures_what_cannot_be_is_an_error(reading, words):
    device = Guide()
    robot = DrivenRobot(device)
    device.broken = reading
    robot.step(0.0, 0.0, NS_PER_MS)
    assert words in robot.error


def test_a_robot_with_other_axes_is_refused():
    with pytest.raises(ConfigError, match="robot arm has the axes x, y, z, yaw, but the setup"):
        check_axes("robot arm", Guide().facts.more, ("z",))


def test_a_press_at_the_page_holds_the_axes_where_they_are():
    device = PageDevice(axes=("z",))
    device.show_state(JoystickState.APPLICATION)
    for number, share in enumerate((0.5, 0.5, 0.6), 1):
        device.handle_input(PageInput(True, 0.0, 0.0, 0, number, device._now_ns, (share,)))
        for _ in range(60 if number == 2 else 20):
            device.advance(NS_PER_MS)
        place = device.read_more()[0].place
        # The page's first word means where the axis is, whatever it says.
        assert abs(place) < 1e-4 if number < 3 else place > 1e-4


@pytest.mark.parametrize("ends", ["silence", "close"])
def test_motors_that_are_told_nothing_more_fall_silent(ends):
    device = SimulatedDevice(axes=("z",))
    device.write_force(0.0, 0.0)
    device.write_more_forces([5.0])
    for _ in range(40):
        device.advance(NS_PER_MS)
    assert device.read_more()[0].speed > 0.05
    if ends == "close":
        device.close()
    for _ in range(20 if ends == "close" else 150):
        device.advance(NS_PER_MS)
    assert device.read_more()[0].speed < 0.03


def test_a_setup_says_what_more_axes_cost():
    with pytest.raises(
        ConfigError, match=r"17 octets of each frame, 136 kbit/s in place of 96.*39"
    ):
        replace(TASKBOARD, axes=3)
    with pytest.raises(ConfigError, match="take 2, 3 or 6"):
        replace(TASKBOARD, axes=4)
    wide = replace(UPLINK, frame_octets=60, pointer_in_vcid=False)
    setup = replace(TASKBOARD, axes=6, gripper=True, uplink=wide)
    octets = SAMPLE_OCTETS + 5 * AXIS_OCTETS
    assert (setup.uplink.insert_octets, setup.downlink.insert_octets) == (octets, octets)
    assert TASKBOARD.uplink.insert_octets == SAMPLE_OCTETS
    for change in ({"deadband": "picture"}, {"partner_arm": "shared"}):
        with pytest.raises(ConfigError, match="x and y only"):
            replace(setup, **change)
