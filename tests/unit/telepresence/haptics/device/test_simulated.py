"""The simulated joystick as a device: sensors, motors, fingers and what breaks."""

import pytest

from telepresence.haptics.axes import AxisReading
from telepresence.haptics.device.device import KEEPS_FORCE_NS
from telepresence.haptics.device.simulated import CAPABILITIES, FAULTS, SimulatedDevice
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import Hand
from telepresence.haptics.specs import open_device

MS = 1_000_000


def advance(device, milliseconds):
    for _ in range(milliseconds):
        device.advance(MS)


def push(device, ms, x_n=0.0, y_n=0.0):
    for _ in range(ms):
        device.write_force(x_n, y_n)
        device.advance(MS)
    return device.read()


def test_encoders_count_from_the_start_and_from_each_new_middle():
    device = SimulatedDevice(start_m=(0.02, -0.03))
    assert device.read()[:4] == (0.0, 0.0, 0.0, 0.0)
    moved = push(device, 100, 2.0, -3.0)
    assert moved.x_m > 0.01 and moved.y_m < -0.01 and moved.vx_m_s > 0.0 > moved.vy_m_s
    assert moved.x_m == pytest.approx(device.joystick.x_m - 0.02)
    device.set_zero(moved.x_m, moved.y_m)
    device.set_zero(0.001, -0.002)
    assert device.read()[:2] == pytest.approx((-0.001, 0.002))


def test_a_force_lasts_fifty_milliseconds_and_a_long_step_is_cut():
    device = SimulatedDevice()
    device.write_force(3.0, 2.0)
    advance(device, KEEPS_FORCE_NS // MS)
    assert (device.joystick.motor_x_n, device.joystick.motor_y_n) == (3.0, 2.0)
    advance(device, 1)
    assert (device.joystick.motor_x_n, device.joystick.motor_y_n) == (0.0, 0.0)

    def glided(count, step_ns):
        one = SimulatedDevice()
        one.joystick.vx_m_s = 0.5
        for _ in range(count):
            one.advance(step_ns)
        return one.read()

    # Of a stall, 50 ms are simulated in steps of 1 ms.
    assert glided(1, 500 * MS) == glided(50, MS)
    assert glided(20, MS // 2).x_m == pytest.approx(glided(4, 5 * MS // 2).x_m, rel=0.05)


def test_a_closed_device_is_gone_and_dark():
    device = SimulatedDevice(axes=("z",))
    device.write_leds(3)
    device.write_more_forces([2.0])
    push(device, 1, 2.0)
    assert device.read().present and device.leds == 3
    device.close()
    advance(device, 1)
    assert not device.read().present and device.leds == 0
    assert device.joystick.motor_x_n == 0.0


@pytest.mark.parametrize("name", [*FAULTS, ""])
def test_each_fault_is_in_the_readings(name):
    device = open_device(f"sim:{name}" if name else "sim")
    assert device.read().temperature_c == pytest.approx(103.0 if name == "hot" else 23.0, abs=5.0)
    device.write_leds(0b0010)
    for _ in range(249):
        device.advance(MS)
    assert device.read().buttons == 0
    device.advance(MS)
    # A quarter of a second is a person's reaction time.
    assert device.read().buttons == (0 if name == "button" else 0b0010)
    device.write_leds(0b1111)
    for _ in range(260):
        device.advance(MS)
    assert device.read().dead_man and device.read().buttons == 0
    moved = push(device, 50, 1.0, 1.0)
    assert (moved.x_m > 2e-3) is (name not in ("stuck-x", "friction", "weak"))
    assert (moved.y_m > 2e-3) is (name not in ("stuck-y", "friction", "weak"))
    assert (moved.x_m == 0.0, moved.y_m == 0.0) == (name == "stuck-x", name == "stuck-y")
    # Hot motors push less, and weak ones, too.
    push(device, 1, 5.0)
    expected_n = {"weak": 3.0, "hot": device.joystick.force_limit_n}.get(name, 5.0)
    assert device.joystick.motor_x_n == pytest.approx(expected_n)
    for _ in range(160):
        device.advance(50 * MS)
    assert device.read().present is (name != "unplugged")


def test_a_hand_takes_the_handle_in_the_application_only():
    device = SimulatedDevice(hand=Hand())
    assert not device.read().dead_man
    device.show_state(JoystickState.APPLICATION)
    for ms in range(1, 402):
        device.advance(MS)
        # It presses once it has closed around the handle.
        assert device.read().dead_man is (ms >= 400)
    device.show_state(JoystickState.HALTED)
    assert not device.read().dead_man


@pytest.mark.parametrize("axes", [("z",), ("z", "yaw", "gripper")])
def test_more_axes_are_measured_in_their_own_units_and_moved_by_the_hand(axes):
    device = SimulatedDevice(hand=Hand(), axes=axes)
    assert [capabilities.name for capabilities in device.capabilities.more] == list(axes)
    assert CAPABILITIES.more == ()
    assert device.read_more() == [AxisReading(0.0, 0.0)] * len(axes)
    device.show_state(JoystickState.APPLICATION)
    most = [0.0] * len(axes)
    for ms in range(6400):
        device.advance(MS)
        for index, (reading, capabilities) in enumerate(
            zip(device.read_more(), device.capabilities.more, strict=True)
        ):
            most[index] = max(most[index], abs(reading.position) / capabilities.half_range)
            assert ms > 398 or reading.position == 0.0
    # It is led over 0.8 of its range within 6 s.
    assert all(0.6 < share < 0.9 for share in most)
    # A hand that let go brakes it.
    device.show_state(JoystickState.HALTED)
    for _ in range(500):
        device.advance(MS)
    assert all(abs(reading.speed) < 1e-3 for reading in device.read_more())


def test_a_force_on_an_axis_moves_it_and_no_other():
    device = SimulatedDevice(axes=("z", "yaw"))
    device.write_more_forces([0.0, 0.5])
    for _ in range(40):
        device.write_force(0.0, 0.0)
        device.advance(MS)
    z, yaw = device.read_more()
    assert z[:2] == (0.0, 0.0) and yaw.position > 0.0 and yaw.speed > 0.0
    with pytest.raises(ValueError, match="zip"):
        device.write_more_forces([1.0])
