"""`kontur-av joystick check`: a sound joystick passes, and each fault fails its check alone."""

from dataclasses import replace

import pytest
from places import ROOT
from user_parts import Guided, load

from kontur_av.clock import ManualClock
from pipelines.cli import main
from pipelines.hand.driver_checks import JoystickCheck
from telepresence.haptics.device.simulated import SimulatedDevice

Lever = load("own_joystick.py").Lever
CLOCK, SAMPLES = ManualClock(), ROOT / "samples"


class Boastful(Lever):
    """Its facts cannot be."""

    facts = replace(Lever.facts, half_width_m=float("nan"))


class Drifting(Lever):
    """A motor is on without an order."""

    def advance(self, dt_ns):
        if self.force == [0.0, 0.0] and self.age_s < 0.02:
            self.speed[1] = max(self.speed[1], 0.02)
        super().advance(dt_ns)


class Deaf(Lever):
    """Its y axis has no motor."""

    def write_force(self, x_n, y_n):
        super().write_force(x_n, 0.0)


class Lively(Lever):
    """It brakes with less than it is told, so that more energy comes out than was put in."""

    def write_force(self, x_n, y_n):
        braking = [force * speed < 0 for force, speed in zip((x_n, y_n), self.speed, strict=True)]
        super().write_force(0.3 * x_n if braking[0] else x_n, 0.3 * y_n if braking[1] else y_n)


class Zeroless(Lever):
    """It does not listen to where the middle is."""

    def set_zero(self, x_m, y_m): ...


class Strong(Lever):
    """It exerts whatever it is told."""

    def write_force(self, x_n, y_n):
        self.force, self.age_s = [x_n, y_n], 0.0


class Late(Lever):
    """No force comes 20 ms late."""

    zeros = 0

    def write_force(self, x_n, y_n):
        self.zeros = 0 if x_n or y_n else self.zeros + 1
        if self.zeros == 0 or self.zeros > 20:
            super().write_force(x_n, y_n)


class Stubborn(Lever):
    """It keeps its force until the next."""

    def advance(self, dt_ns):
        self.age_s = 0.0
        super().advance(dt_ns)


class Lost(Lever):
    """A measurement is missing at times."""

    reads = 0

    def read(self):
        self.reads += 1
        reading = super().read()
        return reading._replace(vy_m_s=float("nan")) if self.reads % 100 == 0 else reading


class Stale(Lever):
    """While it is moved, it once measures nothing new for 25 ms."""

    left, last = 25, None

    def read(self):
        reading = super().read()
        if self.left and reading.vx_m_s > 0.01:
            self.left -= 1
            self.last = self.last or reading
            return self.last
        return reading


class Gone(Lever):
    """Its plug is loose."""

    reads = 0

    def read(self):
        self.reads += 1
        reading = super().read()
        return reading._replace(present=False) if self.reads == 500 else reading


class Jumping(Lever):
    """Its encoder jumps by a centimetre."""

    reads = 0

    def read(self):
        self.reads += 1
        reading = super().read()
        return reading._replace(y_m=reading.y_m + 0.01) if self.reads == 1900 else reading


class Held(Lever):
    """The dead-man button is always pressed."""

    def read(self):
        return super().read()._replace(dead_man=True)


class Bouncing(Lever):
    """The dead-man button is pressed for a moment, by itself."""

    reads = 0

    def read(self):
        self.reads += 1
        return super().read()._replace(dead_man=self.reads == 700)


class Slow(Lever):
    """It takes 0.7 ms for a reading."""

    def read(self):
        CLOCK.advance_ns(700_000)
        return super().read()


class Deceiving(Lever):
    """Closed, it says that it is still there."""

    def close(self):
        self.force = [0.0, 0.0]


class Open(Lever):
    """Closed, it keeps its force."""

    def close(self):
        self.present = False


class Raising(Lever):
    """Closed, it raises."""

    def close(self):
        self.read = lambda: 1 // 0


class Arm(Guided, Lever):
    """It has z and yaw, too."""

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if self.age_s > 0.05:
            self.release_axes()
        self.advance_axes(dt_ns)

    def close(self):
        super().close()
        self.release_axes()


class DriftingArm(Arm):
    """A motor of z is on without an order."""

    def advance(self, dt_ns):
        super().advance(dt_ns)
        z = self.axes[0]
        if z.force_n == 0.0:
            z.speed_m_s = max(z.speed_m_s, 0.006)


class DeafArm(Arm):
    """Yaw has no motor."""

    def write_more_forces(self, forces):
        super().write_more_forces([forces[0], 0.0])


class LivelyArm(Arm):
    """Yaw brakes with less than it is told."""

    def write_more_forces(self, forces):
        z, yaw = forces
        super().write_more_forces([z, 0.3 * yaw if yaw * self.axes[1].speed_m_s < 0 else yaw])


class StrongArm(Arm):
    """z exerts whatever it is told."""

    def advance_axes(self, dt_ns):
        z, yaw = self.axes
        z.step(z.force_n, dt_ns)
        yaw.step(yaw.cut_n, dt_ns)


class LateArm(Arm):
    """No force of z comes 20 ms late."""

    zeros = 0

    def write_more_forces(self, forces):
        self.zeros = 0 if forces[0] else self.zeros + 1
        kept_n = self.axes[0].force_n
        super().write_more_forces(forces)
        if 0 < self.zeros <= 20:
            self.axes[0].force_n = kept_n


class StubbornArm(Arm):
    """Yaw keeps its force until the next."""

    def release_axes(self):
        self.axes[0].force_n = 0.0


class LostArm(Arm):
    """A measurement of z is missing at times."""

    reads = 0

    def read_more(self):
        self.reads += 1
        z, yaw = super().read_more()
        return [z._replace(place=float("nan")) if self.reads % 100 == 0 else z, yaw]


class SpeedyArm(Arm):
    """Yaw says once that it moves beyond its speed."""

    reads = 0

    def read_more(self):
        self.reads += 1
        z, yaw = super().read_more()
        return [z, yaw._replace(speed=7.0) if self.reads == 3200 else yaw]


def failed(joystick):
    results = list(JoystickCheck(joystick, CLOCK).run())
    assert len(results) == 12 + 7 * len(joystick.facts.more)
    return {one.name for one in results if one.failed}


def simulated():
    return SimulatedDevice(axes=("z", "roll", "gripper"))


@pytest.mark.parametrize("joystick", [SimulatedDevice, simulated, Lever, Arm])
def test_a_sound_joystick_passes(joystick):
    assert failed(joystick()) == set()


@pytest.mark.parametrize(
    ("joystick", "check"),
    [
        (Boastful, "facts"),
        (Drifting, "rest"),
        (Deaf, "moves"),
        (Lively, "passivity"),
        (Zeroless, "zero"),
        (Strong, "limits"),
        (Late, "halt"),
        (Stubborn, "missed cycles"),
        (Lost, "readings"),
        (Stale, "readings"),
        (Gone, "readings"),
        (Jumping, "readings"),
        (Held, "dead-man button"),
        (Bouncing, "dead-man button"),
        (Slow, "cycle time"),
        (Deceiving, "unplugged"),
        (Open, "unplugged"),
        (Raising, "unplugged"),
        (DriftingArm, "z rest"),
        (DeafArm, "yaw moves"),
        (LivelyArm, "yaw passivity"),
        (StrongArm, "z limits"),
        (LateArm, "z halt"),
        (StubbornArm, "yaw missed cycles"),
        (LostArm, "z readings"),
        (SpeedyArm, "yaw readings"),
    ],
)
def test_each_fault_fails_its_check_alone(joystick, check):
    assert failed(joystick()) == {check}


def test_without_motors_only_the_sensors_are_checked():
    stick = Lever()
    stick.facts = replace(stick.facts, force_limit_n=0.0)
    results = list(JoystickCheck(stick, CLOCK).run())
    assert [one.name for one in results if one.failed] == []
    assert {one.name for one in results if one.skipped} >= {"moves", "halt", "missed cycles"}


def test_the_command_checks_the_axes_of_a_setup(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(
        'cameras = ["static"]\naxes = 3\n[uplink_video]\ncap_kbps = 90\n'
        "[uplink]\nframe_octets = 48\n"
    )
    monkeypatch.syspath_prepend(SAMPLES)
    monkeypatch.setattr("pipelines.commands.joystick.MonotonicClock", lambda: CLOCK)
    assert main(["joystick", "check", "sim", "--setup", "arm.toml"]) == 0
    assert "z halt" in capsys.readouterr().out
    assert main(["robot", "check", "own_robot:Mass", "--setup", "arm.toml"]) == 2
    assert "but the setup has x, y, z" in capsys.readouterr().err


def test_the_command_says_what_is_wrong_and_ends_with_1(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken_stick.py").write_text(
        "from telepresence import JoystickReading, JoystickFacts\n"
        "class Stick:\n"
        "    facts = JoystickFacts(name='a stick', half_width_m=-1, half_height_m=0.1)\n"
        "    def read(self): return JoystickReading(0.0, 0.0, 0.0, 0.0, dead_man=False)\n"
        "    def __getattr__(self, name): return lambda *values: None\n"
    )
    assert main(["joystick", "check", "broken_stick:Stick"]) == 1
    out = capsys.readouterr().out
    assert "facts: half_width_m is -1: give a number above 0" in out
    assert "moves: it has no motors" in out
