"""A game controller: its events, as the kernel's octets through the library's own reader."""

import os
import struct
from itertools import pairwise
from math import hypot

import pytest
from haptic_pair import each_cycle
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.gamepad import feed, find_gamepads, open_gamepad
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.operation import UNFELT_FORCE_LIMIT_N, JoystickOperation
from telepresence.haptics.device.spec import check_joystick
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.stick import RUMBLE_NS, Axis, RumbleMeter, Stick, dead_man_of
from telepresence.haptics.joystick_controller import JoystickControllerModel

KEYS = frozenset({0x130, 0x131, 0x133, 0x134, 0x136})
AXES = (Axis(128, 0, 255, 15), Axis(0, -32768, 32767, 128))


class Pad:
    """A device around a `Stick`, without a kernel device."""

    def __init__(self):
        self.stick = Stick("pad", AXES, KEYS)
        self.facts = self.stick.facts
        self.read, self.set_zero = self.stick.reading, self.stick.handle_zero
        self.advance = self.stick.advance

    def write_force(self, x_n, y_n):
        self.force = (x_n, y_n)

    def write_leds(self, mask):
        pass

    def show_state(self, state):
        pass


def settled(stick):
    for _ in range(300):
        stick.advance(NS_PER_MS)
    return stick.reading()


def test_full_travel_maps_to_the_workspace_and_the_flat_middle_to_zero():
    stick = Stick("pad", AXES, KEYS)
    assert settled(stick)[:2] == (0.0, 0.0)
    stick.handle_event(3, 0, 255)
    stick.handle_event(3, 1, -32768)
    reading = settled(stick)
    assert reading.x_m == pytest.approx(0.1, abs=1e-6)
    # The kernel's y axis points down.
    assert reading.y_m == pytest.approx(0.08, abs=1e-6)
    stick.handle_event(3, 0, 140)
    assert settled(stick).x_m == pytest.approx(0.0, abs=1e-6)


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(1, 120)), min_size=1, max_size=12))
def test_the_handle_follows_a_jump_of_the_stick_smoothly(jumps):
    stick = Stick("pad", AXES, KEYS)
    before = (0.0, 0.0, 0.0, 0.0)
    for value, cycles in jumps:
        stick.handle_event(3, 0, value)
        stick.handle_event(3, 1, -257 * value + 32767)
        for _ in range(cycles):
            stick.advance(NS_PER_MS)
            x, y, vx, vy = stick.reading()[:4]
            assert (
                hypot(vx - before[2], vy - before[3])
                <= JoystickControllerModel().acceleration_m_s2 * 1e-3
            )
            assert hypot(vx, vy) < 3.0
            assert (x - before[0], y - before[1]) == pytest.approx((vx * 1e-3, vy * 1e-3))
            # It never overshoots the positions of the stick.
            assert abs(x) < 0.1005 and abs(y) < 0.0805
            before = (x, y, vx, vy)
    stick.handle_event(3, 0, 255)
    assert settled(stick).x_m == pytest.approx(0.1, abs=1e-5)


@pytest.mark.parametrize("release_ms", [0, 16, 64])
def test_releasing_the_stick_at_a_wall_keeps_the_observers_positive(release_ms):
    device = Pad()
    space, ground = JoystickSide(handle=OperatedHandle(device)), RobotSide()
    for cycle in each_cycle(space, ground, count=3700, delay_ms=10):
        if cycle == 690:
            device.stick.handle_event(1, 0x136, 1)
        since = (cycle - 700) % 1500
        share = min(since / 400, 1.0) if since < 1000 else 1 - (since - 1000) / max(release_ms, 1)
        if cycle >= 700:
            device.stick.handle_event(3, 0, round(127.5 + 127.5 * max(share, 0.0)))
    assert ground.controller.energy_out_uj > 10_000
    assert space.report().least_uj >= -1 and ground.report().least_uj >= -1
    assert space.handle.operation.state is JoystickState.APPLICATION


def test_the_dead_man_button_is_the_left_shoulder_or_the_trigger_or_the_first_button():
    pad, joystick = Stick("pad", AXES, KEYS), Stick("stick", AXES, frozenset({0x120, 0x121}))
    for stick, code in ((pad, 0x136), (joystick, 0x120)):
        assert not stick.reading().dead_man
        stick.handle_event(1, code, 1)
        assert stick.reading().dead_man and stick.reading().buttons == 0
    assert (pad.facts.buttons, joystick.facts.buttons) == (4, 1)
    bare = Stick("bare", AXES, frozenset({0x130, 0x131}))
    assert not bare.reading().dead_man
    bare.handle_event(1, 0x131, 1)
    assert not bare.reading().dead_man and bare.reading().buttons == 1
    bare.handle_event(1, 0x130, 1)
    assert bare.reading().dead_man and bare.reading().buttons == 1
    assert dead_man_of(frozenset()) is None


def test_after_lost_events_the_state_is_requested():
    stick = Stick("pad", AXES, KEYS)
    stick.handle_event(1, 0x130, 1)
    stick.handle_event(0, 3, 0)
    assert stick.needs_state
    stick.handle_state(255, 0, frozenset({0x131, 0x136}))
    assert not stick.needs_state
    reading = settled(stick)
    assert reading.buttons == 0b10 and reading.dead_man and reading.x_m > 0.09


EVENTS = st.tuples(st.integers(0, 31), st.integers(0, 0x2FF), st.integers(-(2**31), 2**31 - 1))


@given(st.lists(EVENTS), st.sampled_from([AXES, (Axis(0, 0, 0), Axis(7, 5, 3, 2))]))
def test_no_event_leads_outside_the_workspace(events, axes):
    stick = Stick("pad", axes, KEYS)
    for kind, code, value in events:
        stick.handle_event(kind, code, value)
        stick.advance(NS_PER_MS)
    reading = settled(stick)
    assert abs(reading.x_m) <= 0.1 and abs(reading.y_m) <= 0.08
    assert 0 <= reading.buttons < 16


def test_rumble_changes_in_steps_and_stops_at_once():
    meter = RumbleMeter(8.0)
    assert meter.handle_force(0.0, NS_PER_MS) is None
    assert meter.handle_force(4.0, NS_PER_MS) == round(0.5 * 0xFFFF)
    assert meter.handle_force(8.0, NS_PER_MS) is None  # not so soon
    assert meter.handle_force(8.0, 50 * NS_PER_MS) == 0xFFFF
    assert meter.handle_force(7.9, 50 * NS_PER_MS) is None  # nobody feels that
    assert meter.handle_force(0.0, NS_PER_MS) == 0


def test_a_constant_force_keeps_rumbling_and_a_tiny_one_never_starts():
    meter = RumbleMeter(8.0)
    set_ms = [ms for ms in range(10_000) if meter.handle_force(6.0, NS_PER_MS) is not None]
    gaps_ms = [later - earlier for earlier, later in pairwise([*set_ms, 10_000])]
    assert set_ms[0] == 0
    assert 400 * NS_PER_MS < max(gaps_ms) * NS_PER_MS < 0.7 * RUMBLE_NS
    assert meter.handle_force(0.0, NS_PER_MS) == 0
    assert not any(meter.handle_force(0.0, NS_PER_MS) for _ in range(3000))
    assert not any(meter.handle_force(0.4, NS_PER_MS) for _ in range(3000))


def run(operation, milliseconds, now_ns=0):
    for _ in range(milliseconds):
        now_ns += NS_PER_MS
        operation.handle_reading(now_ns)
        operation.handle_force(0.0, 0.0)
        operation.device.advance(NS_PER_MS)
    return now_ns


def test_a_stick_at_rest_is_calibrated_and_needs_its_dead_man_button():
    operation = JoystickOperation(Pad())
    now_ns = run(operation, 500)
    assert operation.state is JoystickState.APPLICATION
    assert operation.force_limit_n == 0.0
    operation.device.stick.handle_event(1, 0x136, 1)
    run(operation, 500, now_ns)
    # Nobody feels this force, but the energies must be those of a hand that does.
    assert operation.force_limit_n == UNFELT_FORCE_LIMIT_N


def test_a_stick_that_is_held_is_not_calibrated():
    operation = JoystickOperation(Pad(), automatic=True)
    operation.device.stick.handle_event(3, 0, 200)
    run(operation, 500)
    assert operation.state is JoystickState.CALIBRATION_ERROR
    assert "does not rest at its middle (+" in operation.reason
    # It pushes nobody, so it is repeated until the stick is released.
    now_ns = run(operation, 20_000, 500 * NS_PER_MS)
    operation.device.stick.handle_event(3, 0, 128)
    run(operation, 2_000, now_ns)
    assert operation.state is JoystickState.APPLICATION


def test_a_missing_controller_is_refused_in_one_line(tmp_path):
    pytest.importorskip("evdev")
    assert find_gamepads(tmp_path) == []
    with pytest.raises(ConfigError, match="no game controller here: plug one in"):
        open_gamepad(folder=tmp_path)
    (tmp_path / "event3").write_bytes(b"")
    assert "cannot be opened" in find_gamepads(tmp_path)[0].problem
    with pytest.raises(ConfigError, match=r"event3 is no input device .*joystick list"):
        open_gamepad(str(tmp_path / "event3"))
    with pytest.raises(ConfigError, match="is no input device"):
        check_joystick("evdev:/dev/null")


@pytest.mark.parametrize("spec", ["", "usb", "sim:tired"])
def test_an_invalid_spec_is_refused_in_one_line(spec):
    with pytest.raises(ConfigError, match="joystick"):
        check_joystick(spec)


def test_the_library_reads_the_kernels_octets():
    evdev = pytest.importorskip("evdev")
    read_end, write_end = os.pipe2(os.O_NONBLOCK)

    class Events(evdev.eventio.EventIO):
        """The library's reader on a pipe instead of a device file."""

        fd = read_end

    # struct input_event: a struct timeval, type, code, value.
    event = struct.Struct("@llHHi")
    os.write(
        write_end,
        event.pack(1, 2, 3, 0, 255)
        + event.pack(1, 2, 1, 0x131, 1)
        + event.pack(1, 2, 0, 0, 0)
        + event.pack(1, 3, 1, 0x136, 1),
    )
    stick = Stick("pad", AXES, KEYS)
    feed(stick, Events())
    reading = settled(stick)
    assert (reading.buttons, reading.dead_man, reading.present) == (0b10, True, True)
    assert reading.x_m > 0.09
    feed(stick, Events())  # nothing new, and no matter
    assert stick.present
    os.close(read_end)
    feed(stick, Events())
    assert not stick.present
    os.close(write_end)
