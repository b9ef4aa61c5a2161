"""The joystick in operation: control of its motors, causes of a halt, and contents of samples."""

from copy import deepcopy
from math import hypot, inf, nan

import pytest
from haptic_samples import unpack_command
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.operation import JoystickOperation
from telepresence.haptics.device.simulated import FACTS, FAULTS, SimulatedDevice
from telepresence.haptics.device.states import REQUESTS, JoystickEvent, JoystickState
from telepresence.haptics.device.supervision import Limits
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import Feedback, is_greeting

QUIET = Feedback(0.0, 0.0, 0, False)


class Session:
    """An operated handle on virtual time, with a robot that sends while `robot` is set."""

    def __init__(self, device=None, limits=None):
        self.device = device or SimulatedDevice(hand=Hand())
        self.handle = OperatedHandle(self.device, limits=limits)
        self.operation = self.handle.operation
        self.robot = True

    def run(self, seconds, force=(0.0, 0.0), each=None):
        for _ in range(round(seconds * 1000)):
            if self.robot:
                self.handle.handle_feedback(QUIET)
            self.handle.step(*force, NS_PER_MS)
            if each is not None:
                each()
        return self

    def into_application(self):
        self.run(4)
        assert self.operation.state is JoystickState.APPLICATION
        return self


def test_it_enters_the_application_by_itself_and_finds_its_middle():
    session = Session(SimulatedDevice(hand=Hand(), start_m=(0.03, -0.04)))
    states = []
    session.run(4, each=lambda: states.append(session.handle.state))
    assert sorted(set(states)) == [0, 1, 2, 3] and states == sorted(states)
    joystick = session.device.joystick
    assert hypot(session.handle.x_m - joystick.x_m, session.handle.y_m - joystick.y_m) < 0.001
    log = [entry.event for entry in session.handle.report().log]
    assert log == ["self-test passed", "calibrate", "calibration passed", "start"]


def test_without_a_calibration_there_is_no_position_and_no_force():
    session = Session()
    places = set()

    def look():
        if session.operation.state < JoystickState.CALIBRATED:
            places.add((session.handle.x_m, session.handle.y_m, session.handle.force_limit_n))

    session.run(4, each=look)
    assert places == {(0.0, 0.0, 0.0)}


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


def test_releasing_the_dead_man_button_removes_the_force_which_returns_slowly():
    session = Session().into_application()
    assert session.handle.force_limit_n == FACTS.force_limit_n
    session.device.show_state(JoystickState.HALTED)  # the hand lets go
    session.run(0.002, force=(3.0, 0.0))
    assert not session.handle.dead_man
    assert session.handle.force_limit_n == 0.0
    session.run(0.002, force=(3.0, 0.0))
    assert session.device.joystick.motor_x_n == 0.0
    session.device.show_state(JoystickState.APPLICATION)
    # The hand closes around the handle in 0.4 s, and then presses.
    session.run(0.6)
    assert 0.0 < session.handle.force_limit_n < FACTS.force_limit_n / 2
    session.run(0.3)
    assert session.handle.force_limit_n == FACTS.force_limit_n
    assert session.operation.released == 1


def test_heat_warns_then_weakens_then_halts_until_it_is_cool():
    session = Session().into_application()
    joystick = session.device.joystick
    joystick.temperature_c = 70.0
    session.run(0.1)
    report = session.handle.report()
    assert report.temperature_warnings == 1
    # The device and its supervisor reduce the force by the same amount.
    assert abs(session.handle.force_limit_n - joystick.force_limit_n) < 0.1
    assert 0.25 < report.force_share < 1.0
    joystick.temperature_c = 80.5
    session.run(0.1, force=(5.0, 0.0))
    assert session.operation.state is JoystickState.HALTED
    assert joystick.motor_x_n == 0.0
    assert "80 °C" in session.operation.reason or "81 °C" in session.operation.reason
    assert "not yet" in session.operation.handle_request(
        JoystickEvent.RESUME, session.handle.now_ns
    )
    joystick.temperature_c = 60.0
    session.run(0.1)
    assert session.operation.state is JoystickState.HALTED
    joystick.temperature_c = 50.0
    session.run(0.5)
    assert session.operation.state is JoystickState.APPLICATION
    # Each rise is a warning, even if it is lower than the last one.
    joystick.temperature_c = 65.0
    session.run(0.1)
    report = session.handle.report()
    assert report.temperature_warnings == 2
    assert report.hottest_c == 80.5


def test_an_invalid_temperature_is_an_error_without_force():
    session = Session().into_application()
    joystick = session.device.joystick
    for wrong_c in (nan, inf, -inf):
        joystick.temperature_c = wrong_c
        session.run(0.02, force=(500.0, 0.0))
        assert session.operation.state is JoystickState.RECOVERABLE
        assert session.operation.reason == "the thermometer reads no number"
        assert session.handle.force_limit_n == 0.0
        joystick.temperature_c = 23.0
        session.run(6)
        assert session.operation.state is JoystickState.APPLICATION
        assert session.handle.force_limit_n == FACTS.force_limit_n


def test_silence_halts_it_and_the_first_sample_brings_it_back():
    limits = Limits(silence_ns=NS_PER_S)
    session = Session(limits=limits).into_application()
    session.robot = False
    session.run(1.1)
    assert session.operation.state is JoystickState.HALTED
    assert session.operation.reason == "no sample from the robot for 1 s"
    session.run(3)
    assert session.operation.machine.entered == 5
    session.robot = True
    session.run(0.01)
    assert session.operation.state is JoystickState.APPLICATION


def test_a_person_may_halt_and_resume_and_refusals_give_a_reason():
    operation = JoystickOperation(SimulatedDevice(), automatic=False)
    now_ns = 0

    def run(milliseconds):
        nonlocal now_ns
        for _ in range(milliseconds):
            now_ns += NS_PER_MS
            operation.handle_reading(now_ns)
            operation.handle_force(0.0, 0.0)
            operation.device.advance(NS_PER_MS)

    run(30)
    assert operation.state is JoystickState.STANDBY
    assert "not in the state standby" in operation.handle_request(JoystickEvent.HALT, now_ns)
    assert not operation.handle_request(JoystickEvent.CALIBRATE, now_ns)
    run(4000)
    assert operation.state is JoystickState.CALIBRATED
    assert not operation.handle_request(JoystickEvent.START, now_ns)
    assert not operation.handle_request(JoystickEvent.HALT, now_ns, "lunch")
    assert operation.reason == "lunch"
    assert "not a request" in operation.handle_request(JoystickEvent.FAULT, now_ns)
    run(100)
    assert operation.state is JoystickState.HALTED
    assert not operation.handle_request(JoystickEvent.RESUME, now_ns)
    assert operation.state is JoystickState.CALIBRATED


@pytest.mark.parametrize("event", [JoystickEvent.HALT, JoystickEvent.STOP])
def test_a_persons_halt_holds_until_a_person_starts(event):
    session = Session().into_application()
    assert session.handle.handle_command(event) == ""
    session.run(20, force=(3.0, 0.0))
    state = JoystickState.HALTED if event is JoystickEvent.HALT else JoystickState.CALIBRATED
    assert session.operation.state is state and session.handle.force_limit_n == 0.0
    assert session.operation.reason == "by a person's command"
    assert session.handle.handle_command(JoystickEvent.START) == ""
    assert session.run(0.01).operation.state is JoystickState.APPLICATION
    # From now on it goes on by itself again.
    session.device.joystick.temperature_c = 90.0
    session.run(0.1)
    assert session.operation.state is JoystickState.HALTED
    refusal = session.handle.handle_command(JoystickEvent.START)
    assert refusal.startswith("start: not yet, the motors were at 90 °C")
    session.device.joystick.temperature_c = 23.0
    assert session.run(0.1).operation.state is JoystickState.APPLICATION


def test_the_force_ends_with_the_cycle_of_a_persons_halt():
    session = Session().into_application()
    session.run(0.5, force=(3.0, 0.0))
    assert session.device.joystick.motor_x_n == 3.0
    session.handle.handle_command(JoystickEvent.HALT)
    # The controller asks for the limit before it computes the next force.
    assert session.handle.force_limit_n == 0.0
    session.run(0.001, force=(3.0, 0.0))
    assert session.device.joystick.motor_x_n == 0.0


def test_a_persons_halt_ends_a_calibration_and_outlives_what_follows():
    session = Session()
    session.run(1)
    assert session.operation.state is JoystickState.STANDBY
    motors = session.device.joystick
    assert hypot(motors.motor_x_n, motors.motor_y_n) > 0.1
    assert session.handle.handle_command(JoystickEvent.HALT) == ""
    session.run(0.001)
    assert (motors.motor_x_n, motors.motor_y_n) == (0.0, 0.0)
    session.run(10)
    assert session.operation.state is JoystickState.STANDBY
    # A calibration that a person asks for does not end the halt.
    assert session.handle.handle_command(JoystickEvent.CALIBRATE) == ""
    session.run(10)
    assert session.operation.state is JoystickState.CALIBRATED
    read = session.device.read
    session.device.read = lambda: read()._replace(x_m=nan)
    session.run(0.1)
    session.device.read = read
    session.run(10)
    assert session.operation.state is JoystickState.RECOVERABLE and session.operation.given_up
    assert "allowed there: acknowledge" in session.handle.handle_command(JoystickEvent.START)
    assert session.handle.handle_command(JoystickEvent.ACKNOWLEDGE) == ""
    session.run(10)
    assert session.operation.state is JoystickState.STANDBY
    assert session.handle.handle_command(JoystickEvent.START) == ""
    assert session.run(5).operation.state is JoystickState.APPLICATION


def test_a_halted_joystick_may_be_calibrated_and_a_running_one_not():
    session = Session().into_application()
    refusal = session.handle.handle_command(JoystickEvent.CALIBRATE)
    assert refusal == "calibrate: not in the state application; allowed there: stop, halt"
    session.handle.handle_command(JoystickEvent.HALT)
    assert session.handle.handle_command(JoystickEvent.CALIBRATE) == ""
    assert session.run(1).operation.state is JoystickState.STANDBY
    assert session.run(9).operation.state is JoystickState.CALIBRATED


def test_after_a_fatal_error_every_command_is_refused():
    session = Session(SimulatedDevice(FAULTS["unplugged"], hand=Hand())).run(8.1)
    for event in REQUESTS:
        refusal = session.handle.handle_command(event)
        assert "the device is gone: plug it in and restart" in refusal, event


def test_a_handle_outside_its_workspace_is_an_error_until_the_next_calibration():
    session = Session().into_application()
    session.device.set_zero(0.3, 0.0)  # an encoder that has jumped
    session.run(0.01)
    assert session.operation.state is JoystickState.RECOVERABLE
    assert "the workspace ends at ±151 mm" in session.operation.reason
    session.run(6)
    assert session.operation.state is JoystickState.APPLICATION
    joystick = session.device.joystick
    assert abs(session.handle.x_m - joystick.x_m) < 0.002


@pytest.mark.parametrize("seconds", [0.001, 0.9, 1.1, 5])
def test_recovery_works_after_any_duration_and_number_of_faults(seconds):
    session = Session().into_application()
    read = session.device.read
    for _ in range(5):
        session.device.read = lambda: read()._replace(x_m=nan)
        session.run(seconds)
        assert session.operation.state is JoystickState.RECOVERABLE
        session.device.read = read
        session.run(6)
        assert session.operation.state is JoystickState.APPLICATION


def test_motors_give_up_after_three_retries():
    session = Session(SimulatedDevice(FAULTS["stuck-x"]))
    while session.operation.state is not JoystickState.CALIBRATION_ERROR:
        session.run(0.1)
    assert not session.operation.given_up
    session.run(30)
    assert session.operation.state is JoystickState.CALIBRATION_ERROR and session.operation.given_up
    events = [entry.event for entry in session.handle.report().log]
    assert events.count("calibrate") == 4


def into_application():
    operation, now_ns = JoystickOperation(SimulatedDevice()), 0
    while operation.state is not JoystickState.APPLICATION:
        now_ns += NS_PER_MS
        operation.handle_reading(now_ns)
        operation.handle_force(0.0, 0.0)
        operation.device.advance(NS_PER_MS)
    return operation, now_ns


CALIBRATED = into_application()
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


@settings(max_examples=80)
@given(
    st.lists(st.tuples(readings, st.integers(1, 60), st.floats(-50, 50) | numbers), max_size=30),
    st.booleans(),
)
def test_no_sensor_reading_lets_the_force_exceed_its_limit(script, calibrated):
    operation, now_ns = (
        deepcopy(CALIBRATED) if calibrated else (JoystickOperation(SimulatedDevice()), 0)
    )
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
        if operation.state is JoystickState.APPLICATION:
            assert wanted <= operation.force_limit_n <= FACTS.force_limit_n
            assert operation.reading.dead_man or wanted == 0.0
        elif operation.state is not JoystickState.STANDBY:
            assert wanted == 0.0
        return operation.state

    for reading, cycles, force_n in script:
        for _ in range(cycles):
            state = cycle(reading, force_n)
        assert reading.present or state is JoystickState.FATAL


def test_a_sensor_failure_is_noticed_in_the_same_cycle():
    # Not only by the full check, which runs only every ten cycles.
    for wait in range(10):
        session = Session().into_application().run(wait / 1000)
        wrong = session.device.read()._replace(vx_m_s=100.0)
        session.device.read = lambda wrong=wrong: wrong
        session.run(0.001)
        assert session.operation.state is not JoystickState.APPLICATION
        assert session.handle.force_limit_n == 0.0


def test_samples_carry_the_state_and_the_fatal_state_is_final():
    device = SimulatedDevice(FAULTS["unplugged"], hand=Hand())
    handle = OperatedHandle(device)
    joystick_side, robot_side = JoystickSide(handle=handle), RobotSide()
    seen, lights = [], set()
    pushed_after = 0.0
    for millisecond in range(1, 10_000):
        now_ns = millisecond * NS_PER_MS
        joystick_side.handle_cycle(now_ns, NS_PER_MS)
        robot_side.handle_cycle(now_ns, NS_PER_MS)
        sample = joystick_side.poll_transmit(now_ns)
        if not is_greeting(sample):
            value = unpack_command(sample).value
            if value.state not in seen:
                seen.append(value.state)
            assert value.halted == (value.state >= JoystickState.HALTED)
        robot_side.handle_datagram(sample, now_ns)
        answer = robot_side.poll_transmit(now_ns)
        joystick_side.handle_datagram(answer, now_ns)
        feedback = joystick_side.link.latest(now_ns)
        if feedback is not None:
            handle.handle_feedback(feedback)
        lights.add((device.leds, robot_side.lit))
        if millisecond > 8_010:
            pushed_after = max(
                pushed_after, abs(joystick_side.force_x_n), abs(joystick_side.force_y_n)
            )
    assert seen == [0, 1, 2, 3, 7]
    assert pushed_after < 1e-100
    # The LED that the robot lights is lit on the joystick too.
    assert (0b001, 0) in lights
    assert joystick_side.controller.least_observed_uj >= -1


def test_a_trainers_exercise_is_a_fault_until_its_end_and_then_it_recovers_by_itself():
    session = Session().into_application()
    session.handle.handle_exercise(3 * NS_PER_S)
    session.run(0.1)
    assert session.operation.state is JoystickState.RECOVERABLE
    assert "trainer" in session.operation.trouble
    assert session.handle.force_limit_n == 0.0
    session.run(2.8)
    assert session.operation.state is JoystickState.RECOVERABLE
    session.run(6)
    assert session.operation.state is JoystickState.APPLICATION
    session.handle.handle_exercise(-1)
    session.run(0.1)
    assert session.operation.state is JoystickState.APPLICATION, "it is over"
    # A device that is gone is worse than any exercise.
    supervisor = session.operation.supervisor
    supervisor.handle_exercise(NS_PER_S)
    rest = JoystickReading(0.0, 0.0, 0.0, 0.0, dead_man=True)
    assert supervisor.handle_reading(rest, 0).name == "FAULT"
    assert supervisor.handle_reading(rest._replace(present=False), 0).name == "FATAL"
