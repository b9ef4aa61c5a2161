"""The joystick in operation: control of its motors, causes of a halt, and contents of samples."""

from copy import deepcopy
from dataclasses import replace
from math import hypot, inf, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joystick_scripts import REST, STICK, operated, play

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.calibration import calibrate
from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.operation import JoystickOperation
from telepresence.haptics.device.simulated import CAPABILITIES, FAULTS, SimulatedDevice
from telepresence.haptics.device.states import REQUESTS, JoystickEvent, JoystickState
from telepresence.haptics.device.supervision import Limits
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import Feedback

QUIET = Feedback(0.0, 0.0, 0, False)
APPLICATION, HALTED = JoystickState.APPLICATION, JoystickState.HALTED
RECOVERABLE, STANDBY = JoystickState.RECOVERABLE, JoystickState.STANDBY


class Session:
    """An operated handle on virtual time, with a robot that sends while `robot` is set."""

    def __init__(self, device=None, limits=None):
        self.device = device or SimulatedDevice(hand=Hand())
        self.handle = OperatedHandle(self.device, limits=limits)
        self.operation = self.handle.operation
        self.robot = True

    @property
    def state(self):
        return self.operation.state

    @property
    def motors(self):
        return self.device.joystick

    def run(self, seconds, force=(0.0, 0.0), each=None):
        for _ in range(round(seconds * 1000)):
            if self.robot:
                self.handle.handle_feedback(QUIET)
            self.handle.step(*force, NS_PER_MS)
            if each is not None:
                each()
        return self

    def asks(self, event):
        """Return the refusal of a person's command."""
        return self.handle.handle_command(event)


def in_application(device=None, limits=None):
    session = Session(device, limits).run(4)
    assert session.state is APPLICATION
    return session


READY = in_application()


@pytest.fixture
def session():
    """In the application."""
    return deepcopy(READY)


def test_it_enters_the_application_by_itself_and_finds_its_middle():
    session = Session(SimulatedDevice(hand=Hand(), start_m=(0.03, -0.04)))
    states, positions = [], set()

    def look():
        states.append(session.handle.state)
        if session.state < JoystickState.CALIBRATED:
            positions.add((session.handle.x_m, session.handle.y_m, session.handle.force_limit_n))

    session.run(4, each=look)
    assert sorted(set(states)) == [0, 1, 2, 3] and states == sorted(states)
    assert positions == {(0.0, 0.0, 0.0)}, "a position or a force without a calibration"
    handle, joystick = session.handle, session.motors
    assert hypot(handle.x_m - joystick.x_m, handle.y_m - joystick.y_m) < 0.001
    log = [entry.event for entry in handle.report().log]
    assert log == ["self-test passed", "calibrate", "calibration passed", "start"]


def test_the_calibration_pushes_a_hand_with_at_most_five_newton():
    device = SimulatedDevice()
    session, joystick, write_force = Session(device), device.joystick, device.write_force
    asked, been_right = [], False

    def held(x_n, y_n):
        nonlocal been_right
        asked.append(hypot(x_n, y_n))
        been_right = been_right or joystick.x_m > 0.149
        if been_right and joystick.x_m < 0.13:
            device.stuck = 0  # on its way back to the middle
        elif len(asked) == 600:
            joystick.vx_m_s, joystick.vy_m_s = -1.5, -1.0  # a blow on its way to the right
        write_force(x_n, y_n)

    device.write_force = held
    session.run(4.5)
    assert "does not return to its middle" in session.operation.reason
    assert 4.5 < max(asked) <= 5.000001


@pytest.mark.rule("S4")
def test_releasing_the_dead_man_button_removes_the_force_which_returns_slowly(session):
    handle = session.handle
    assert handle.force_limit_n == CAPABILITIES.force_limit_n
    session.device.show_state(HALTED)  # the hand lets go
    session.run(0.002, force=(3.0, 0.0))
    assert not handle.dead_man and handle.force_limit_n == 0.0
    session.run(0.002, force=(3.0, 0.0))
    assert session.motors.motor_x_n == 0.0
    session.device.show_state(APPLICATION)
    # The hand closes around the handle in 0.4 s, and then presses.
    session.run(0.6)
    assert 0.0 < handle.force_limit_n < CAPABILITIES.force_limit_n / 2
    session.run(0.3)
    assert handle.force_limit_n == CAPABILITIES.force_limit_n
    assert session.operation.released == 1


def test_heat_warns_then_weakens_then_halts_until_it_is_cool(session):
    handle, joystick = session.handle, session.motors
    joystick.temperature_c = 70.0
    session.run(0.1)
    report = handle.report()
    assert report.temperature_warnings == 1
    # The device and its supervisor reduce the force by the same amount.
    assert abs(handle.force_limit_n - joystick.force_limit_n) < 0.1
    assert 0.25 < report.force_share < 1.0
    joystick.temperature_c = 80.5
    session.run(0.1, force=(5.0, 0.0))
    assert session.state is HALTED and joystick.motor_x_n == 0.0
    assert "80 °C" in session.operation.reason or "81 °C" in session.operation.reason
    refusal = session.operation.handle_request(JoystickEvent.RESUME, handle.now_ns)
    assert "not yet" in refusal
    for cooler_c, seconds, state in ((60.0, 0.1, HALTED), (50.0, 0.5, APPLICATION)):
        joystick.temperature_c = cooler_c
        assert session.run(seconds).state is state
    # Each rise is a warning, even if it is lower than the last one.
    joystick.temperature_c = 65.0
    report = session.run(0.1).handle.report()
    assert (report.temperature_warnings, report.hottest_c) == (2, 80.5)


def test_silence_halts_it_and_the_first_sample_brings_it_back():
    session = in_application(limits=Limits(silence_ns=NS_PER_S))
    session.robot = False
    assert session.run(1.1).state is HALTED
    assert session.operation.reason == "no sample from the robot for 1 s"
    assert session.run(3).operation.machine.entered == 5
    session.robot = True
    assert session.run(0.01).state is APPLICATION


def test_a_person_may_halt_and_resume_and_refusals_give_a_reason():
    operation = JoystickOperation(SimulatedDevice(), automatic=False)
    now_ns = operated(operation, 30)

    def asks(event, *reason):
        return operation.handle_request(event, now_ns, *reason)

    assert operation.state is STANDBY
    assert "not in the state standby" in asks(JoystickEvent.HALT)
    assert not asks(JoystickEvent.CALIBRATE)
    now_ns = operated(operation, 4000, now_ns)
    assert operation.state is JoystickState.CALIBRATED
    assert not asks(JoystickEvent.START) and not asks(JoystickEvent.HALT, "lunch")
    assert operation.reason == "lunch"
    assert "not a request" in asks(JoystickEvent.FAULT)
    now_ns = operated(operation, 100, now_ns)
    assert operation.state is HALTED
    assert not asks(JoystickEvent.RESUME)
    assert operation.state is JoystickState.CALIBRATED


@pytest.mark.parametrize(
    ("event", "state"),
    [(JoystickEvent.HALT, HALTED), (JoystickEvent.STOP, JoystickState.CALIBRATED)],
)
def test_a_persons_halt_holds_until_a_person_starts(session, event, state):
    session.run(0.5, force=(3.0, 0.0))
    assert session.motors.motor_x_n == 3.0
    refusal = session.asks(JoystickEvent.CALIBRATE)
    assert refusal == "calibrate: not in the state application; allowed there: stop, halt"
    assert session.asks(event) == ""
    # The force ends with the cycle: the controller asks for the limit before the next force.
    assert session.handle.force_limit_n == 0.0
    session.run(0.001, force=(3.0, 0.0))
    assert session.motors.motor_x_n == 0.0
    session.run(8, force=(3.0, 0.0))
    assert session.state is state and session.handle.force_limit_n == 0.0
    assert session.operation.reason == "by a person's command"
    assert session.asks(JoystickEvent.START) == ""
    assert session.run(0.01).state is APPLICATION
    # From now on it goes on by itself again.
    session.motors.temperature_c = 90.0
    assert session.run(0.1).state is HALTED
    refusal = session.asks(JoystickEvent.START)
    assert refusal.startswith("start: not yet, the motors were at 90 °C")
    session.motors.temperature_c = 23.0
    assert session.run(0.1).state is APPLICATION


def test_a_persons_halt_ends_a_calibration_and_outlives_what_follows():
    session = Session().run(1)
    assert session.state is STANDBY
    motors = session.motors
    assert hypot(motors.motor_x_n, motors.motor_y_n) > 0.1
    assert session.asks(JoystickEvent.HALT) == ""
    session.run(0.001)
    assert (motors.motor_x_n, motors.motor_y_n) == (0.0, 0.0)
    assert session.run(5).state is STANDBY
    # A calibration that a person asks for does not end the halt.
    assert session.asks(JoystickEvent.CALIBRATE) == ""
    assert session.run(5).state is JoystickState.CALIBRATED
    read = session.device.read
    session.device.read = lambda: read()._replace(x_m=nan)
    session.run(0.1)
    session.device.read = read
    assert session.run(10).state is RECOVERABLE and session.operation.given_up
    assert "allowed there: acknowledge" in session.asks(JoystickEvent.START)
    assert session.asks(JoystickEvent.ACKNOWLEDGE) == ""
    assert session.run(5).state is STANDBY
    assert session.asks(JoystickEvent.START) == ""
    assert session.run(5).state is APPLICATION


def test_a_handle_outside_its_workspace_is_an_error_until_the_next_calibration(session):
    session.device.set_zero(0.3, 0.0)  # an encoder that has jumped
    assert session.run(0.01).state is RECOVERABLE
    assert "the workspace ends at ±151 mm" in session.operation.reason
    assert session.run(6).state is APPLICATION
    assert abs(session.handle.x_m - session.motors.x_m) < 0.002


def test_motors_give_up_after_three_retries():
    session = Session(SimulatedDevice(FAULTS["stuck-x"]))
    while session.state is not JoystickState.CALIBRATION_ERROR:
        session.run(0.1)
    assert not session.operation.given_up
    session.run(20)
    assert session.state is JoystickState.CALIBRATION_ERROR and session.operation.given_up
    events = [entry.event for entry in session.handle.report().log]
    assert events.count("calibrate") == 4


numbers = st.floats(-1, 1) | st.sampled_from([nan, inf, -inf, 1e300])
readings = st.builds(
    JoystickReading,
    numbers,
    numbers,
    numbers,
    numbers,
    st.integers(0, 15),
    st.booleans(),
    st.none() | st.floats(-50, 200) | st.sampled_from([nan, inf, -inf]),
    st.sampled_from([True] * 9 + [False]),
)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(readings, st.integers(1, 60), st.floats(-50, 50) | numbers), max_size=30),
    st.booleans(),
)
def test_no_sensor_reading_lets_the_force_exceed_its_limit(script, calibrated):
    operation = deepcopy(READY.operation) if calibrated else JoystickOperation(SimulatedDevice())
    now_ns = READY.handle.now_ns if calibrated else 0
    device = operation.device
    write_force, written = device.write_force, [(0.0, 0.0)]

    def watch_force(x_n, y_n):
        written.append((x_n, y_n))
        write_force(x_n, y_n)

    device.write_force = watch_force

    def cycle(reading, force_n):
        nonlocal now_ns
        now_ns += NS_PER_MS
        device.read = lambda: reading
        operation.handle_reading(now_ns)
        operation.handle_force(force_n, -force_n)
        device.advance(NS_PER_MS)
        wanted = max(map(abs, written[-1]))
        if operation.state is APPLICATION:
            assert wanted <= operation.force_limit_n <= CAPABILITIES.force_limit_n
            assert operation.reading.dead_man or wanted == 0.0
        elif operation.state is not STANDBY:
            assert wanted == 0.0

    for reading, count, force_n in script:
        for _ in range(count):
            cycle(reading, force_n)
        assert reading.present or operation.state is JoystickState.FATAL


@pytest.mark.parametrize("wait_ms", range(10))
def test_a_release_a_press_and_a_sensor_failure_are_noticed_in_the_same_cycle(session, wait_ms):
    # Not only by the full check, which runs only every ten cycles.
    session.run(wait_ms / 1000)
    read = session.device.read
    session.device.read = lambda: read()._replace(dead_man=False)
    assert session.run(0.001).handle.force_limit_n == 0.0
    session.device.read = read
    assert session.run(0.002).handle.force_limit_n > 0.0, "it begins to return at once"
    wrong = read()._replace(vx_m_s=100.0)
    session.device.read = lambda: wrong
    assert session.run(0.001).state is not APPLICATION
    assert session.handle.force_limit_n == 0.0


def test_what_a_robot_told_of_its_stop_is_not_known_once_it_is_silent(session):
    session.robot = False
    for stopped in (True, False):
        session.handle.handle_feedback(QUIET._replace(stopped=stopped))
        for seconds, told in ((0.3, stopped), (0.4, False)):
            session.run(seconds, each=lambda: session.handle.handle_feedback(None))
            assert session.handle.robot_stopped is told


def test_the_robots_led_is_lit_here_and_a_device_that_is_gone_is_so_for_good(session):
    session.robot = False
    for lit, leds in ((2, 0b100), (None, 0)):
        session.handle.handle_feedback(QUIET._replace(lit=lit))
        assert session.run(0.001).device.leds == leds
    session.device.close()
    assert session.run(0.01).handle.state == JoystickState.FATAL
    assert session.handle.force_limit_n == 0.0
    for event in REQUESTS:
        assert "the device is gone: plug it in and restart" in session.asks(event), event


def test_a_trainers_exercise_is_a_fault_until_its_end_and_then_it_recovers_by_itself(session):
    session.handle.handle_exercise(3 * NS_PER_S)
    assert session.run(0.1).state is RECOVERABLE
    assert "no valid reading" in session.operation.trouble
    assert session.handle.force_limit_n == 0.0
    assert session.run(2.8).state is RECOVERABLE
    assert session.run(6).state is APPLICATION
    session.handle.handle_exercise(-1)
    assert session.run(0.1).state is APPLICATION, "it is over"


def test_a_stick_is_calibrated_where_it_rests():
    quiet = [0.001 * (-1) ** ms for ms in range(400)]

    def answer(ms, output):
        return REST._replace(x_m=0.004 + quiet[ms], y_m=-0.006)

    found, wanted = play(calibrate(STICK), answer)
    assert found.problem == "" and len(wanted) == 300
    assert found[:4] == pytest.approx((0.004, -0.006, 0.1, 0.08), abs=1e-5)
    assert wanted[1].prompt == "leave the stick alone"


@pytest.mark.parametrize(
    ("position", "axis", "problem"),
    [
        # It rests within 15 % of its travel, and moves by at most 5 %.
        (lambda ms: 0.0149, 0, False),
        (lambda ms: -0.0151, 0, True),
        (lambda ms: 0.0119, 1, False),
        (lambda ms: 0.0121, 1, True),
        (lambda ms: 0.0049 * (ms % 2), 0, False),
        (lambda ms: 0.0051 * (ms % 2), 0, True),
        (lambda ms: -0.0041 * (ms % 2), 1, True),
    ],
)
def test_a_stick_that_is_held_is_not_calibrated(position, axis, problem):
    found, _ = play(
        calibrate(STICK), lambda ms, _: REST._replace(**{("x_m", "y_m")[axis]: position(ms)})
    )
    assert ("does not rest at its middle" in found.problem) is problem


def test_a_calibration_finds_the_middle_between_the_stops_and_refuses_a_wrong_width():
    def handle(left, right, low, high):
        at = {"x": 0.0, "y": 0.0}

        def answer(ms, output):
            # A handle so light that it is where it is pushed to; it creeps at 1 mm per ms and N.
            at["x"] = max(left, min(right, at["x"] + 1e-4 * output.x_n))
            at["y"] = max(low, min(high, at["y"] + 1e-4 * output.y_n))
            return REST._replace(x_m=at["x"], y_m=at["y"])

        return answer

    capabilities = replace(CAPABILITIES, half_width_m=0.01, half_height_m=0.02)
    found, _ = play(calibrate(capabilities), handle(-0.004, 0.016, -0.03, 0.01))
    assert found == (pytest.approx(0.006), pytest.approx(-0.01), 0.01, 0.02, "")
    found, _ = play(calibrate(capabilities), handle(-0.004, 0.0145, -0.03, 0.01))
    assert found.problem == "" and found.half_width_m == pytest.approx(0.00925)
    found, _ = play(calibrate(capabilities), handle(-0.004, 0.0142, -0.03, 0.01))
    assert "axis x moves by ±9 mm where ±10 mm are due" in found.problem
    found, _ = play(calibrate(capabilities), handle(-0.004, 0.016, -0.03, 0.0135))
    assert "axis y moves by ±22 mm where ±20 mm are due" in found.problem
