"""A game controller's stick: it leads the handle smoothly, its buttons and further axes."""

from itertools import pairwise
from math import hypot

import pytest
from gamepads import AXES, CONTROLLERS, KEYS, STICKS, Pad, settled
from hypothesis import given
from hypothesis import strategies as st
from joystick_scripts import operated

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.axes import AXIS_NAMES, MoreAxis
from telepresence.haptics.device.operation import UNFELT_FORCE_LIMIT_N, JoystickOperation
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.stick import (
    RUMBLE_NS,
    Axis,
    RumbleMeter,
    Stick,
    dead_man_of,
    puck_axes,
    stick_axes,
)
from telepresence.haptics.joystick_controller import JoystickControllerModel


def test_full_travel_maps_to_the_workspace_and_the_flat_middle_to_zero():
    stick = Stick("pad", AXES, KEYS)
    assert settled(stick)[:2] == (0.0, 0.0)
    # The kernel's y axis points down.
    for x, y, position in ((255, -32768, (0.1, 0.08)), (140, 0, (0.0, 0.0))):
        stick.handle_event(3, 0, x)
        stick.handle_event(3, 1, y)
        assert settled(stick)[:2] == pytest.approx(position, abs=1e-6)


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


def test_the_dead_man_button_is_the_left_shoulder_or_the_trigger_or_the_first_button():
    pad, joystick = Stick("pad", AXES, KEYS), Stick("stick", AXES, frozenset({0x120, 0x121}))
    for stick, code in ((pad, 0x136), (joystick, 0x120)):
        assert not stick.reading().dead_man
        stick.handle_event(1, code, 1)
        assert stick.reading().dead_man and stick.reading().buttons == 0
    assert (pad.capabilities.buttons, joystick.capabilities.buttons) == (4, 1)
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
    stick.handle_state({0: 255, 1: 0}, {0x131, 0x136})
    assert not stick.needs_state
    reading = settled(stick)
    assert reading.buttons == 0b10 and reading.dead_man and reading.x_m > 0.09


EVENTS = st.tuples(st.integers(0, 31), st.integers(0, 0x2FF), st.integers(-(2**31), 2**31 - 1))


def controller(kind, more=AXIS_NAMES):
    axes, keys, _ = CONTROLLERS[kind]
    return Stick(kind, axes, keys, more=more)


def names_of(stick):
    return tuple(capabilities.name for capabilities in stick.capabilities.more)


def positions(stick, milliseconds=500):
    for _ in range(milliseconds):
        stick.advance(NS_PER_MS)
    return dict(zip(names_of(stick), [one.position for one in stick.more_readings()], strict=True))


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_a_controller_has_the_axes_that_it_can_lead(kind):
    axes, keys, names = CONTROLLERS[kind]
    assert stick_axes(axes, keys) == names_of(controller(kind)) == names
    assert names_of(controller(kind, ("z",))) == (("z",) if "z" in names else ())


def test_the_right_stick_leads_places_and_hat_and_triggers_lead_on():
    pad = controller("pad")
    # The kernel counts down as positive.
    for code, value in ((4, -32768), (3, 32767), (0x10, 1), (0x11, -1), (5, 255)):
        pad.handle_event(3, code, value)
    reached = positions(pad)
    assert (reached["z"], reached["yaw"]) == pytest.approx((0.1, 1.0), abs=1e-4)
    # Nothing is led on without the dead-man button.
    assert (reached["roll"], reached["pitch"], reached["gripper"]) == (0.0, 0.0, 0.0)
    pad.handle_event(1, 0x136, 1)
    reached = positions(pad)
    assert (reached["roll"], reached["pitch"]) == pytest.approx((0.5, 0.5), abs=0.05)
    assert reached["gripper"] == pytest.approx(0.02, abs=0.002)
    for code in (4, 3, 0x10, 0x11, 5):
        pad.handle_event(3, code, 0)
    released = positions(pad)
    assert (released["z"], released["yaw"]) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert released["roll"] == pytest.approx(reached["roll"], abs=0.05)
    pad.handle_event(3, 2, 255)
    assert positions(pad, 3000)["gripper"] == pytest.approx(-0.04, abs=1e-4)


@pytest.mark.parametrize("relative", [True, False])
def test_a_puck_goes_on_while_it_is_deflected_and_its_first_button_held(relative):
    buttons = frozenset({0x100, 0x101, 0x102, 0x103})
    axes = puck_axes() if relative else dict.fromkeys(range(6), Axis(0, -350, 350, 12))
    stick = Stick("puck", axes, buttons, more=("z", "yaw", "gripper"))

    def push(ms, *, value=350):
        """Push right, away, up, and turn; the kernel tells relative motions every 16 ms."""
        for cycle in range(ms):
            if cycle == 0 or (relative and value and cycle % 16 == 0):
                for code, way in ((0, 1), (1, -1), (2, -1), (5, 1)):
                    stick.handle_event(2 if relative else 3, code, way * value)
            stick.advance(NS_PER_MS)

    push(400)
    assert settled(stick)[:2] == (0.0, 0.0) and stick.reading().buttons == 0
    push(1, value=0)
    for key in (0x100, 0x103):
        stick.handle_event(1, key, 1)
    push(500)
    push(1, value=0)
    x_m, y_m = settled(stick)[:2]
    assert 0.04 < x_m < 0.06 and 0.03 < y_m < 0.05
    z, yaw, gripper = (axis.position for axis in stick.more_readings())
    assert 0.04 < z < 0.06 and 0.4 < yaw < 0.6 and 0.02 < gripper <= 0.04
    stick.handle_event(1, 0x100, 0)
    push(500)
    assert settled(stick)[:2] == pytest.approx((x_m, y_m))
    assert {*stick_axes(range(6), buttons)} == {*AXIS_NAMES}


def test_triggers_that_are_buttons_close_and_open_the_gripper():
    pad = controller("small pad")
    pad.handle_event(1, 0x136, 1)
    pad.handle_event(1, 0x139, 1)
    assert positions(pad)["gripper"] > 0.015
    pad.handle_event(1, 0x139, 0)
    pad.handle_event(1, 0x138, 1)
    assert positions(pad, 3000)["gripper"] == pytest.approx(-0.04, abs=1e-4)


RANGES = st.builds(Axis, *[st.integers(-(2**15), 2**15)] * 3, st.integers(-10, 300))


@given(
    st.dictionaries(st.sampled_from([2, 3, 4, 5, 6, 0x10, 0x11]), RANGES),
    st.frozensets(st.sampled_from([0x120, 0x130, 0x136, 0x138, 0x139])),
    st.lists(st.tuples(EVENTS, st.integers(1, 40)), max_size=12),
)
def test_whatever_a_controller_has_no_axis_leaves_its_limits(axes, keys, events):
    stick = Stick("any", STICKS | axes, keys, more=AXIS_NAMES)
    limits = [MoreAxis(capabilities) for capabilities in stick.capabilities.more]
    for (kind, code, value), cycles in events:
        stick.handle_event(kind, code, value)
        for _ in range(cycles):
            stick.advance(NS_PER_MS)
            for axis, reading in zip(limits, stick.more_readings(), strict=True):
                assert axis.take(reading) == ""
                assert abs(reading.speed) <= axis.capabilities.speed * 1.001
        reading = stick.reading()
        assert abs(reading.x_m) < 0.1005 and abs(reading.y_m) < 0.0805
        assert 0 <= reading.buttons < 16


def test_rumble_changes_in_steps_keeps_on_and_stops_at_once():
    meter = RumbleMeter(8.0)
    for force_n, after_ms, strength in (
        (0.0, 1, None),
        (4.0, 1, round(0.5 * 0xFFFF)),
        (8.0, 1, None),  # not so soon
        (8.0, 50, 0xFFFF),
        (7.9, 50, None),  # nobody feels that
        (0.0, 1, 0),
    ):
        assert meter.handle_force(force_n, after_ms * NS_PER_MS) == strength
    meter = RumbleMeter(8.0)
    set_ms = [ms for ms in range(10_000) if meter.handle_force(6.0, NS_PER_MS) is not None]
    gaps_ms = [later - earlier for earlier, later in pairwise([*set_ms, 10_000])]
    assert set_ms[0] == 0
    assert 400 * NS_PER_MS < max(gaps_ms) * NS_PER_MS < 0.7 * RUMBLE_NS
    assert meter.handle_force(0.0, NS_PER_MS) == 0
    # A tiny force never starts it.
    for force_n in (0.0, 0.4):
        assert not any(meter.handle_force(force_n, NS_PER_MS) for _ in range(3000))


def test_a_stick_at_rest_is_calibrated_and_needs_its_dead_man_button():
    operation = JoystickOperation(Pad())
    now_ns = operated(operation, 500)
    assert operation.state is JoystickState.APPLICATION
    assert operation.force_limit_n == 0.0
    operation.device.stick.handle_event(1, 0x136, 1)
    operated(operation, 500, now_ns)
    # Nobody feels this force, but the energies must be those of a hand that does.
    assert operation.force_limit_n == UNFELT_FORCE_LIMIT_N
