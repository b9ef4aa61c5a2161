"""The joystick in a page's hand: smooth, yields to force, passive, and at rest when released."""

from copy import deepcopy
from math import hypot, inf, nan, pi, sin

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import CAPABILITIES, PageDevice, PageHandModel, PageInput
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.haptics.joystick_controller import JoystickControllerModel
from telepresence.haptics.sample import Feedback

MODEL = PageHandModel()


class Seat:
    """An operated page joystick on virtual time; the page sends `wanted` every `period_ms`."""

    def __init__(self):
        self.device = PageDevice()
        self.handle = OperatedHandle(self.device)
        self.wanted = None
        self.period_ms = 4
        self.sequence = 0
        self.most_speed = self.most_acceleration = 0.0

    @property
    def position(self):
        return self.handle.x_m, self.handle.y_m

    def send(self, x, y, *, dead_man=True):
        self.sequence += 1
        now_ns = self.handle.now_ns
        self.device.handle_input(PageInput(dead_man, x, y, 0, self.sequence, now_ns))

    def run(self, seconds, force=(0.0, 0.0)):
        joystick = self.device.joystick
        for k in range(round(seconds * 1000)):
            if self.wanted is not None and k % self.period_ms == 0:
                self.send(*self.wanted)
            before = joystick.vx_m_s, joystick.vy_m_s
            self.handle.handle_feedback(Feedback(0.0, 0.0, 0, False))
            self.handle.step(*force, NS_PER_MS)
            vx, vy = joystick.vx_m_s, joystick.vy_m_s
            self.most_speed = max(self.most_speed, hypot(vx, vy))
            change = hypot(vx - before[0], vy - before[1]) * 1000
            self.most_acceleration = max(self.most_acceleration, change)
        return self


def in_application():
    seat = Seat().run(4)
    assert seat.handle.operation.state is JoystickState.APPLICATION
    seat.most_speed = seat.most_acceleration = 0.0
    return seat


READY = in_application()


@pytest.fixture
def seat():
    return deepcopy(READY)


def pointing(seat, *positions):
    """The page points at each place for a while (s)."""
    for x, y, seconds in positions:
        seat.wanted = (x, y)
        seat.run(seconds)
    return seat


@pytest.mark.parametrize("period_ms", [1, 4, 17])
def test_it_goes_where_the_page_points_at_any_rate_of_events(seat, period_ms):
    seat.period_ms = period_ms
    pointing(seat, (0.0, 0.0, 0.1), (0.6, -0.5, 1.5))
    assert seat.position[0] == pytest.approx(0.6 * CAPABILITIES.half_width_m, abs=0.002)
    assert seat.position[1] == pytest.approx(-0.5 * CAPABILITIES.half_height_m, abs=0.002)
    # A jump of the pointer is no jump of the handle, which the controller's bound relies on.
    assert seat.most_acceleration < JoystickControllerModel().acceleration_m_s2 / 2
    assert seat.most_speed < 1.5 * MODEL.speed_m_s


def test_steps_of_a_slow_pointer_are_smoothed(seat):
    seat.period_ms = 17
    pointing(seat, (0.0, 0.0, 0.1))
    speeds = []
    for k in range(60):
        pointing(seat, (0.01 * k, 0.0, 0.017))
        speeds.append(seat.device.joystick.vx_m_s)
    # 1.5 mm in 17 ms are 0.088 m/s.
    assert all(speed == pytest.approx(0.088, rel=0.1) for speed in speeds[20:])


def test_the_hand_begins_where_the_handle_is_and_ends_with_the_workspace(seat):
    before = seat.position
    pointing(seat, (1.0, -0.9, 0.5))
    assert seat.handle.dead_man
    assert seat.position == pytest.approx(before, abs=1e-6)
    pointing(seat, (0.8, -0.9, 1.0))
    assert seat.position[0] - before[0] == pytest.approx(
        -0.2 * CAPABILITIES.half_width_m, abs=0.002
    )
    assert seat.position[1] == pytest.approx(before[1], abs=1e-4)
    # The wanted place ends with the workspace.
    seat = pointing(deepcopy(READY), (-1.0, 0.0, 0.1), (1.0, 0.0, 2.0))
    assert seat.position[0] == pytest.approx(CAPABILITIES.half_width_m, abs=0.002)


def test_a_force_displaces_the_handle_against_the_muscles(seat):
    pointing(seat, (0.0, 0.0, 0.5))
    free_m = seat.position[0]
    seat.run(1.5, force=(-5.0, 0.0))
    assert seat.position[0] - free_m == pytest.approx(-5.0 / MODEL.muscles.stiffness_n_m, abs=0.001)
    # Beyond what the muscles can hold, the motors win.
    seat.run(1.5, force=(-10.0, 0.0))
    assert seat.position[0] < -0.14


@pytest.mark.rule("S4")
@pytest.mark.parametrize("way", ["button", "silence", "halt"])
def test_a_released_handle_is_braked_and_stays_without_force(seat, way):
    joystick = seat.device.joystick
    pointing(seat, (0.0, 0.0, 0.5))
    seat.wanted = (0.9, 0.2)
    seat.run(0.1, force=(2.0, 0.0))
    assert joystick.vx_m_s > 0.7 and seat.handle.force_limit_n > 0.0
    seat.wanted = None
    if way == "button":
        seat.send(nan, inf, dead_man=False)
    elif way == "halt":
        seat.handle.handle_command(JoystickEvent.HALT)
    else:
        # The last input came 4 ms ago.
        seat.run(0.095)
        assert seat.handle.dead_man
    seat.run(0.002, force=(2.0, 0.0))
    # The button is the person's, who may be holding it through a halt.
    assert seat.handle.dead_man is (way == "halt") and not seat.device.held
    assert seat.handle.force_limit_n == 0.0
    seat.run(0.001, force=(2.0, 0.0))
    assert joystick.motor_x_n == 0.0
    position = seat.position
    seat.run(2.0, force=(2.0, 0.0))
    # From 0.8 m/s; without the brake it would go on to the stop, 5 cm away.
    assert hypot(seat.position[0] - position[0], seat.position[1] - position[1]) < 0.01
    assert joystick.vx_m_s == pytest.approx(0.0, abs=1e-6)
    # The next hand takes it where it is.
    position = seat.position
    if way != "halt":
        seat.send(0.0, 0.0, dead_man=False)
        pointing(seat, (-1.0, -1.0, 0.5))
        assert seat.handle.dead_man
        assert seat.position == pytest.approx(position, abs=1e-6)


def test_inputs_that_arrive_late_hold_the_handle_only_for_the_rest_of_their_time(seat):
    seat.device.handle_input(PageInput(True, 0.0, 0.0, 0, 1, NS_PER_S), 60 * NS_PER_MS)
    seat.run(0.038)
    assert seat.handle.dead_man
    seat.run(0.004)
    assert not seat.handle.dead_man
    seat.device.handle_input(PageInput(True, 0.0, 0.0, 0, 2, NS_PER_S), 100 * NS_PER_MS)
    seat.run(0.002)
    assert not seat.handle.dead_man


def test_what_a_page_has_painted_counts_only_while_it_holds_the_handle(seat):
    seat.device.handle_input(held := PageInput(True, 0.0, 0.0, 0, 1, NS_PER_S, picture_ns=5))
    assert seat.device.picture_ns == 5
    # A busy page's release is late, and it says nothing afterwards.
    seat.device.handle_input(held._replace(dead_man=False, sequence=2), NS_PER_S)
    assert seat.device.picture_ns == PageInput._field_defaults["picture_ns"]


def test_a_page_that_begins_anew_takes_the_handle_once_the_one_before_is_silent(seat):
    seat.sequence = 1000
    pointing(seat, (0.0, 0.0, 0.1))
    seat.sequence = 0
    seat.run(0.09)
    assert seat.device.ignored == 23
    seat.run(0.1)
    assert seat.handle.dead_man and seat.device.ignored < 30


def test_the_hand_takes_the_handle_in_the_application_only():
    seat = Seat()
    seat.wanted = (0.0, 0.0)
    while seat.handle.operation.state is not JoystickState.APPLICATION:
        assert not seat.device.held
        seat.wanted = (sin(2 * pi * seat.handle.now_ns / NS_PER_S), 0.0)
        seat.run(0.004)
    assert seat.handle.now_ns < 4 * NS_PER_S
    seat.run(0.05)
    assert seat.device.held
    seat.handle.handle_command(JoystickEvent.HALT)
    seat.run(0.5)
    assert seat.handle.operation.state is JoystickState.HALTED and not seat.device.held


def test_a_change_of_the_state_releases_no_button_and_presses_none(seat):
    pointing(seat, (0.0, 0.0, 0.1))
    for event in (JoystickEvent.HALT, JoystickEvent.START):
        seat.handle.handle_command(event)
        for _ in range(300):
            assert seat.run(0.001).handle.dead_man
    assert seat.handle.operation.state is JoystickState.APPLICATION


@pytest.mark.rule("10")
@pytest.mark.parametrize(("silent_s", "presses"), [(0.25, True), (0.4, False)])
def test_after_a_silence_a_button_that_was_held_is_pressed_no_more(seat, silent_s, presses):
    pointing(seat, (0.0, 0.0, 0.1))
    seat.wanted = None
    assert not seat.run(silent_s).handle.dead_man
    pointing(seat, (0.0, 0.0, 0.5))
    assert seat.handle.dead_man is presses
    seat.send(0.0, 0.0, dead_man=False)
    assert seat.run(0.01).handle.dead_man


wild = st.floats() | st.sampled_from([0.0, 1.0, -1.0, 1.0000001, nan, inf, -inf, 1e300])
inputs = st.builds(
    PageInput,
    st.booleans(),
    wild,
    wild,
    st.integers(0, 2**32 - 1),
    st.integers(0, 3) | st.integers(0, 2**32 - 1),
    st.integers(0, 2**63 - 1) | st.integers(0, 10**9),
)


@pytest.mark.rule("10")
@settings(max_examples=80)
@given(st.lists(st.tuples(inputs, st.integers(-(10**9), 10**9), st.integers(0, 40)), max_size=12))
@example([(PageInput(True, nan, 0.0, 0, 1, 1), 0, 40), (PageInput(False, 1.0, 1.0, 0, 2, 2), 0, 9)])
def test_no_input_moves_the_handle_without_the_dead_man_button(script):
    seat = deepcopy(READY)
    joystick = seat.device.joystick
    nobody = not any(one.dead_man for one, _, _ in script)
    for hand, age_ns, cycles in script:
        seat.device.handle_input(hand, age_ns)
        for _ in range(cycles):
            position, speed = (joystick.x_m, joystick.y_m), hypot(joystick.vx_m_s, joystick.vy_m_s)
            may_move = seat.device.held
            seat.run(0.001, force=(1.0, -1.0))
            assert seat.handle.dead_man <= may_move
            if not may_move and abs(joystick.motor_x_n) + abs(joystick.motor_y_n) == 0.0:
                assert hypot(joystick.vx_m_s, joystick.vy_m_s) <= speed
            if nobody:
                assert hypot(joystick.x_m - position[0], joystick.y_m - position[1]) <= 1e-9
        assert hypot(joystick.x_m, joystick.y_m) < 1.0 and seat.handle.buttons < 16
    seat.run(0.3)
    position = seat.position
    seat.run(0.3, force=(1.0, 1.0))
    assert not seat.handle.dead_man and seat.position == pytest.approx(position, abs=1e-5)


def test_a_press_at_the_page_holds_the_axes_where_they_are():
    device = PageDevice(axes=("z",))
    device.show_state(JoystickState.APPLICATION)
    for number, share in enumerate((0.5, 0.5, 0.6), 1):
        device.handle_input(PageInput(True, 0.0, 0.0, 0, number, device._now_ns, more=(share,)))
        for _ in range(60 if number == 2 else 20):
            device.advance(NS_PER_MS)
        position = device.read_more()[0].position
        # The page's first word means where the axis is, whatever it says.
        assert abs(position) < 1e-4 if number < 3 else position > 1e-4


#: Of a session with a robot. Self-test and calibration take 3.1 s.
BEGUN, TAPS, PRESS, RELEASED = 3_500, 4_500, 6_500, 8_500


def wanted(cycle):
    """Free motion and hard taps on the wall, then a press beyond what the muscles can."""
    t = cycle / 1000
    if cycle < PRESS:
        return 0.6 * sin(2 * pi * 0.7 * t), 0.5 * sin(2 * pi * 0.4 * t)
    return 0.95, 0.1
