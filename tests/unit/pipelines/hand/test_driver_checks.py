"""`joystick check`, `robot check`: a sound device passes, and each fault fails its check alone."""

from dataclasses import replace
from itertools import count
from math import nan

import pytest
from positions import ROOT
from user_parts import Guided, load

from kontur_av.clock import ManualClock
from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.hand.driver_checks import JoystickCheck, RobotCheck
from telepresence.haptics.device.simulated import SimulatedDevice

Lever, Mass = load("own_joystick.py").Lever, load("own_robot.py").Mass
CLOCK, SAMPLES = ManualClock(), ROOT / "samples"
#: Each fault: a class of devices, the check that it fails, and what breaks one.
FAULTS = []
#: Faults of so much that other checks fail, too.
GREAT_FAULTS = []


class Arm(Guided, Lever):
    """A joystick with z and yaw, too."""

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if self.age_s > 0.05:
            self.release_axes()
        self.advance_axes(dt_ns)

    def close(self):
        super().close()
        self.release_axes()


class Placed(Mass):
    """A robot that takes places."""

    capabilities = replace(Mass.capabilities, takes="position")

    def deactivate(self):
        super().deactivate()
        self.vx = self.vy = 0.0

    def write_position(self, x_m, y_m, vx_m_s, vy_m_s):
        if self.active:
            self.vx, self.vy = (x_m - self.x) * 50, (y_m - self.y) * 50

    def advance(self, dt_ns):
        if self.active:
            self.x += self.vx * dt_ns / 1e9
            self.y += self.vy * dt_ns / 1e9


class Alone(Mass):
    """A robot whose controller goes on by itself, and stops after 50 ms without a cycle."""

    capabilities = replace(Mass.capabilities, runs_alone=True)
    timeout_ns = 50_000_000
    at_ns = 0

    def advance(self, dt_ns):
        alone_ns = CLOCK.now_ns() - self.at_ns if self.at_ns else dt_ns
        self.at_ns = CLOCK.now_ns()
        for _ in range(min(alone_ns, self.timeout_ns) // 1_000_000):
            super().advance(1_000_000)
        if alone_ns > self.timeout_ns:
            self.vx = self.vy = 0.0


class Wrist(Guided, Mass):
    """A robot with z and yaw, too."""

    def stop_axes(self):
        for axis in self.axes:
            axis.speed_m_s = 0.0

    def activate(self):
        super().activate()
        self.stop_axes()

    def deactivate(self):
        super().deactivate()
        self.release_axes()
        self.stop_axes()

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if self.age_s > 0.05:
            self.release_axes()
        if self.active:
            self.advance_axes(dt_ns)


class LedWrist(Wrist):
    """It takes places."""

    def __init__(self):
        super().__init__()
        self.capabilities = replace(self.capabilities, takes="position")

    write_position = Placed.write_position

    def deactivate(self):
        super().deactivate()
        self.vx = self.vy = 0.0

    def write_more_positions(self, positions, speeds):
        if self.active:
            for axis, position in zip(self.axes, positions, strict=True):
                axis.speed_m_s = (position * axis.lever_m - axis.position_m) * 50

    def advance(self, dt_ns):
        Placed.advance(self, dt_ns)
        for axis in self.axes:
            axis.position_m += axis.speed_m_s * dt_ns / 1e9


def fault(device, check, faults=FAULTS):
    """Add a fault to those that fail one check."""
    return lambda breaks: faults.append((device, check, breaks))


given = setattr


def wait(milliseconds):
    CLOCK.advance_ns(round(milliseconds * 1e6))


def hasten(axis, times):
    axis.speed_m_s *= times


def creep(axis, way_m):
    axis.position_m += way_m


def told(device, name, change):
    """Call a method with what `change` makes of its arguments."""
    method = getattr(device, name)
    setattr(device, name, lambda *values: method(*change(*values)))


def read(device, change, name="read"):
    """Let `change(number, reading)` make another reading of each."""
    method, numbers = getattr(device, name), count(1)
    setattr(device, name, lambda: change(next(numbers), method()))


def read_axis(device, index, change):
    """Change the reading of one axis; `change(number)` says what of it."""

    def changed(number, axes):
        return [axis._replace(**change(number)) if axis is axes[index] else axis for axis in axes]

    read(device, changed, "read_more")


def unplug(number, reading):
    return reading._replace(present=number != 500 and reading.present)


def jump(number, reading):
    return reading._replace(y_m=reading.y_m + 0.01 * (number == 1900))


def each_cycle(device, do):
    """Do something before each cycle."""
    told(device, "advance", lambda dt_ns: (do(), dt_ns)[1:])


def stale(cycles, moves, every=10**6):
    """A change of readings: once, while it moves, nothing new is measured for so many cycles.

    every: it is so again and again.
    """
    kept = []

    def change(number, reading):
        if number % every == 0:
            kept.clear()
        if len(kept) < cycles and moves(reading):
            kept.append(kept[0] if kept else reading)
            return kept[0]
        return reading

    return change


def nothing(*_):
    """In the place of a method."""


@fault(Lever, "rest")
def a_motor_is_on_without_an_order(lever):
    def drift():
        if lever.force == [0.0, 0.0] and lever.age_s < 0.02:
            lever.speed[1] = max(lever.speed[1], 0.02)

    each_cycle(lever, drift)


@fault(Lever, "passivity")
def it_brakes_with_less_than_it_is_told(lever):
    def cut(*forces):
        both = zip(forces, lever.speed, strict=True)
        return [0.3 * force if force * speed < 0 else force for force, speed in both]

    told(lever, "write_force", cut)


@fault(Lever, "limits")
def it_exerts_whatever_it_is_told(lever):
    def write_force(x_n, y_n):
        lever.force, lever.age_s = [x_n, y_n], 0.0

    lever.write_force = write_force


@fault(Lever, "halt")
def no_force_comes_20_ms_late(lever):
    last, zeros = [(0.0, 0.0)], [0]

    def late(*forces):
        zeros[0] = 0 if any(forces) else zeros[0] + 1
        last[0] = last[0] if 0 < zeros[0] <= 20 else forces
        return last[0]

    told(lever, "write_force", late)


@fault(Mass, "power on", GREAT_FAULTS)
def it_follows_though_it_is_not_active(robot):
    def follow():
        robot.active = True
        robot.force = robot.force if any(robot.force) else (1.0, 0.0)

    each_cycle(robot, follow)


@fault(Mass, "passivity", GREAT_FAULTS)
def it_adds_to_the_motion(robot):
    def add():
        if robot.active:
            robot.vx, robot.vy = robot.vx * 1.004, robot.vy * 1.004

    each_cycle(robot, add)


@fault(Mass, "emergency stop")
def it_is_switched_off_20_ms_late(robot):
    left, deactivate = [0], robot.deactivate

    def count_down():
        if left[0]:
            left[0] -= 1
            if not left[0]:
                deactivate()

    robot.deactivate = lambda: left.__setitem__(0, 20)
    told(robot, "activate", lambda: (left.__setitem__(0, 0), ())[1])
    each_cycle(robot, count_down)


@fault(Mass, "stops")
def it_goes_on_when_it_is_switched_off(robot):
    robot.power_off = robot.deactivate
    robot.deactivate = lambda: given(robot, "force", (0.0, 0.0))


@fault(Mass, "missed cycles", GREAT_FAULTS)
def without_orders_it_accelerates(robot):
    wrote = [True]

    def accelerate():
        if not wrote[0]:
            robot.vy += 0.02
        wrote[0] = False

    told(robot, "write_force", lambda *forces: (wrote.__setitem__(0, True), *forces)[1:])
    each_cycle(robot, accelerate)


@fault(Wrist, "z stops")
def z_goes_on_when_it_is_switched_off(wrist):
    z, deactivate = wrist.axes[0], wrist.deactivate

    def slide():
        speed_m_s = 0.1 * z.speed_m_s
        deactivate()
        z.speed_m_s = speed_m_s

    wrist.deactivate = slide
    each_cycle(
        wrist,
        lambda: setattr(z, "position_m", z.position_m + z.speed_m_s * 1e-3 * (not wrist.active)),
    )


#: Faults in one line each: a class of devices, the check that fails, and what breaks one.
SIMPLE_FAULTS = [
    # Its facts cannot be.
    (
        Lever,
        "capabilities",
        lambda d: given(d, "capabilities", replace(d.capabilities, half_width_m=nan)),
    ),
    (
        Mass,
        "capabilities",
        lambda d: given(d, "capabilities", replace(d.capabilities, half_height_m=-0.1)),
    ),
    # Its y axis has no motor.
    (Lever, "moves", lambda d: told(d, "write_force", lambda x_n, y_n: (x_n, 0.0))),
    # It does not listen to where the middle is.
    (Lever, "zero", lambda d: given(d, "set_zero", nothing)),
    # It keeps its force until the next.
    (Lever, "missed cycles", lambda d: each_cycle(d, lambda: given(d, "age_s", 0.0))),
    (Mass, "missed cycles", lambda d: each_cycle(d, lambda: given(d, "age_s", 0.0))),
    # A measurement is missing at times.
    (
        Lever,
        "readings",
        lambda d: read(d, lambda k, one: one if k % 100 else one._replace(vy_m_s=nan)),
    ),
    (Arm, "z readings", lambda d: read_axis(d, 0, lambda k: {"position": nan} if k == 100 else {})),
    # While it moves, it once measures nothing new for a while.
    (Lever, "readings", lambda d: read(d, stale(25, lambda one: one.vx_m_s > 0.01))),
    (Mass, "readings", lambda d: read(d, stale(22, lambda one: one.vx_m_s > 0.005))),
    # It measures anew at 250 Hz.
    (Mass, "readings", lambda d: read(d, stale(10**6, lambda _: True, every=4))),
    # Its encoder trembles by 0.1 mm.
    (Lever, "rest", lambda d: read(d, lambda k, one: one._replace(x_m=one.x_m + k % 2 * 1e-4))),
    # Its plug is loose; its encoder jumps.
    (Lever, "readings", lambda d: read(d, unplug)),
    (Lever, "readings", lambda d: read(d, jump)),
    # An axis says once that it is beyond its speed or its range.
    (Arm, "yaw readings", lambda d: read_axis(d, 1, lambda k: {"speed": 7.0} if k == 3200 else {})),
    (
        Wrist,
        "z readings",
        lambda d: read_axis(d, 0, lambda k: {"position": 0.2} if k == 700 else {}),
    ),
    # The dead-man button is pressed always, or for a moment.
    (Lever, "dead-man button", lambda d: read(d, lambda _, one: one._replace(dead_man=True))),
    (Lever, "dead-man button", lambda d: read(d, lambda k, one: one._replace(dead_man=k == 700))),
    # A reading takes 0.7 ms; it waits for its brakes.
    (Lever, "cycle time", lambda d: read(d, lambda _, one: (wait(0.7), one)[1])),
    (Mass, "emergency stop", lambda d: told(d, "deactivate", lambda: wait(30) or ())),
    # Closed, it is still there, keeps its force, or raises.
    (Lever, "unplugged", lambda d: given(d, "close", lambda: given(d, "force", [0.0, 0.0]))),
    (Lever, "unplugged", lambda d: given(d, "close", lambda: given(d, "present", False))),
    (Lever, "unplugged", lambda d: given(d, "close", lambda: given(d, "read", lambda: 1 // 0))),
    # It does not stop by itself; without power it goes on.
    (Alone, "silence", lambda d: given(d, "timeout_ns", 10**12)),
    (Mass, "power off", lambda d: given(d, "power_off", nothing)),
]
#: It does not move; its axes are exchanged; its driver has a fault.
GREAT_FAULTS += [
    (Mass, "moves", lambda d: given(d, "write_force", nothing)),
    (Mass, "moves", lambda d: told(d, "write_force", lambda x_n, y_n: (y_n, x_n))),
    (Mass, "moves", lambda d: given(d, "write_force", lambda x_n, y_n: 1 // 0)),
]


def checked(device):
    check = RobotCheck if isinstance(device, Mass) else JoystickCheck
    return list(check(device, CLOCK).run())


def failed(device):
    return {one.name for one in checked(device) if one.failed}


def simulated():
    return SimulatedDevice(axes=("z", "roll", "gripper"))


@pytest.mark.parametrize(
    ("device", "checks"),
    [
        *((SimulatedDevice, 13), (simulated, 34), (Lever, 13), (Arm, 27)),
        *((Mass, 12), (Placed, 12), (Alone, 12), (Wrist, 28), (LedWrist, 28)),
    ],
)
def test_a_sound_device_passes(device, checks):
    results = checked(device())
    assert [result.name for result in results if result.failed] == [], results
    assert len(results) == checks


@pytest.mark.parametrize(("device", "check", "breaks"), [*FAULTS, *SIMPLE_FAULTS])
def test_each_fault_fails_its_check_alone(device, check, breaks):
    broken = device()
    breaks(broken)
    assert failed(broken) == {check}


@pytest.mark.parametrize(("device", "check", "breaks"), GREAT_FAULTS)
def test_a_fault_of_much_fails_its_check(device, check, breaks):
    broken = device()
    breaks(broken)
    assert check in failed(broken)


def test_facts_of_another_type_are_refused_before_the_robot_has_power():
    robot = Mass()
    robot.capabilities, robot.power_on = {"name": "arm"}, lambda: pytest.fail("it got power")
    with pytest.raises(ConfigError, match="capabilities returned a dict: give RobotCapabilities"):
        checked(robot)


def test_axes_that_are_not_described_are_said_and_without_motors_only_sensors_are_checked():
    shapeless = Wrist()
    shapeless.capabilities = replace(shapeless.capabilities, more=("z",))
    assert (
        checked(shapeless)[0].trouble == "capabilities returned more = a str: give AxisCapabilities"
    )
    stick = Lever()
    stick.capabilities = replace(stick.capabilities, force_limit_n=0.0)
    results = checked(stick)
    assert [result.name for result in results if result.failed] == []
    assert {one.name for one in results if one.skipped} >= {"moves", "halt", "missed cycles"}


def test_the_command_checks_the_axes_of_a_setup_and_says_what_is_wrong(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(
        'cameras = ["static"]\naxes = ["x", "y", "z"]\n[uplink_video]\ncap_kbps = 90\n'
        "[uplink]\nframe_octets = 48\n"
    )
    monkeypatch.syspath_prepend(SAMPLES)
    monkeypatch.setattr("pipelines.commands.joystick.MonotonicClock", lambda: CLOCK)
    assert main(["joystick", "check", "sim", "--setup", "arm.toml"]) == 0
    assert "z halt" in capsys.readouterr().out
    assert main(["robot", "check", "own_robot:Mass", "--setup", "arm.toml"]) == 2
    assert "but the setup has x, y, z" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken_stick.py").write_text(
        "from telepresence import JoystickReading, JoystickCapabilities\n"
        "class Stick:\n"
        "    facts = JoystickCapabilities(name='a stick', half_width_m=-1, half_height_m=0.1)\n"
        "    def read(self): return JoystickReading(0.0, 0.0, 0.0, 0.0, dead_man=False)\n"
        "    def __getattr__(self, name): return lambda *values: None\n"
    )
    assert main(["joystick", "check", "broken_stick:Stick"]) == 2
    assert "half_width_m = -1.0: give a number above 0" in capsys.readouterr().err
