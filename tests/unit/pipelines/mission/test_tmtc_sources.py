"""Parameters of joystick, robot and gateways, and the rules of the built-in dictionary."""

import pytest

from pipelines.hand.hand_topics import JoystickStatus
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import CommandUpdate, FunctionAsked, Reported, SendCommand
from pipelines.mission.tmtc_sources import MOST_JOINTS, GatewaySource, JoystickSource, RobotSource
from pipelines.session.mission_messages import RobotStatus
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.haptics.envelope import Hold
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import Feedback
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import Fault
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.world import WorldState

S = 1_000_000_000
LINK = {
    **dict.fromkeys(("frames", "frames_lost", "haptic_received", "waiting", "dropped"), 0),
    "state": "connected",
}


class Space:
    """The end in space, with a joystick that a test plays."""

    def __init__(self, segment=Segment.SPACE):
        self.end = TmtcEnd(segment, built_in_dictionary(), now_ns=0, first_count=1, boot_id=1)
        self.service = JoystickSource(self.end, first_number=100)
        self.now_ns = 0

    def status(self, state=JoystickState.APPLICATION, temperature_c=23.0, **more):
        self.now_ns += S
        values = {"reason": "", "dead_man": True, "force_limit_n": 12.0, "device": "test"}
        values |= {"half_width_m": 0.1, "half_height_m": 0.1, "temperature_c": temperature_c}
        self.service.handle_status(JoystickStatus(state=state, **(values | more)), self.now_ns)
        return self.news()

    def news(self):
        list(iter(lambda: self.end.poll_transmit(self.now_ns), None))
        return list(iter(self.end.next_event, None))

    def ask(self, application, verb, name, *arguments):
        request = SendCommand("test", 1, application, verb, name, arguments)
        self.end.handle_request(request, self.now_ns)
        return self.news()


@pytest.fixture
def space():
    return Space()


@pytest.fixture
def ground():
    return Space(Segment.GROUND)


@pytest.fixture
def robot(ground):
    return RobotSource(ground.end, first_number=7)


def reports(news):
    return [one for one in news if isinstance(one, Reported) and one.kind == "event"]


def events(news):
    return [report.name for report in reports(news)]


def ended(news):
    return [one for one in news if isinstance(one, CommandUpdate) and one.done]


def measured(report):
    """Values that are numbers."""
    return {name: value for name, value in report.values.items() if value == value}


def requests(space, news):
    asked = [one for one in news if isinstance(one, FunctionAsked)]
    return [space.service.handle_asked(one, 0) for one in asked]


def test_a_hot_joystick_is_halted_by_a_rule_of_the_dictionary(space):
    assert requests(space, space.status(temperature_c=85.0)) == []
    news = space.status(temperature_c=85.0)
    assert events(news) == ["too_hot"]
    assert [request.event for request in requests(space, news)] == [JoystickEvent.HALT]
    # It must cool down before the rule acts again; it does not resume by itself.
    assert requests(space, space.status(temperature_c=85.0)) == []
    space.status(temperature_c=50.0)
    news = space.status(temperature_c=50.0)
    assert (events(news), requests(space, news)) == (["cooled"], [])


def test_a_joystick_without_a_thermometer_is_reported_and_never_hot(space):
    heard = [*space.status(temperature_c=None), *space.status(temperature_c=None)]
    told = [one for one in heard if isinstance(one, Reported)]
    assert {one.kind for one in told} == {"housekeeping"}
    assert "temperature" in told[0].values and "temperature" not in measured(told[0])

    # A function that nobody carries out fails.
    news = space.ask("joystick", "call", "test")
    assert [one.function for one in news if isinstance(one, FunctionAsked)] == ["test"]
    space.now_ns += 11 * S
    (done,) = ended(space.news())
    assert (done.ok, done.verified, done.reason) == (False, True, "nobody carried it out")


def test_a_halt_is_an_event_and_its_telecommand_is_verified_with_the_joysticks_own_words(space):
    space.status()
    (request,) = requests(space, space.ask("joystick", "call", "resume"))
    assert request.number == 101
    news = space.status(commanded=request.number, command_refusal="resume: not in this state")
    (done,) = ended(news)
    assert (done.ok, done.reason) == (False, "resume: not in this state")
    assert events(space.status(JoystickState.HALTED)) == ["state_changed", "off_nominal"]
    assert events(space.status(JoystickState.CALIBRATED)) == ["state_changed"]


def test_a_functional_test_is_an_application_and_its_end_an_event(space):
    calibrated = JoystickState.CALIBRATED
    space.status(calibrated, test="aborted", test_part="force", test_number=1)
    running = space.status(calibrated, test="running", test_number=2)
    again = space.status(calibrated, test="running", test_number=2)
    assert events(running) == events(again) == []
    values = space.end.applications["joystick"].values
    assert values["application"] == "joystick test"
    failed = {"test": "failed", "test_part": "place", "test_number": 2}
    news = space.status(calibrated, **failed)
    (event,) = reports(news)
    assert (event.name, event.values) == ("test_failed", {"test": "failed", "test_part": "place"})
    assert events(space.status(calibrated, **failed)) == []
    assert events(space.status(calibrated, test="passed", test_number=3)) == ["test_passed"]
    assert values["application"] == "none"


def test_signal_and_force_are_watched_and_joints_are_housekeeping(ground, robot):
    space, heard = ground, []
    gateway = GatewaySource(space.end, "ground_gateway")
    for signal in (False, True, True, False):
        gateway.handle_values({**LINK, "signal": signal}, space.now_ns)
        heard += events(space.news())
    assert heard == ["signal_acquired", "signal_lost"]
    for force_n in (5.0, 25.0, 25.0):
        space.now_ns += S
        state = WorldState(space.now_ns, 0.01, -0.02, force_n, contact=True)
        robot.handle_state(state, space.now_ns)
    assert events(space.news()) == ["force_too_high"]
    space = ground
    space.ask("robot", "housekeeping_on", "joints")
    space.now_ns += 11 * S
    robot.handle_status(robot_status(joints=((0.05, 1.5), (-0.1, -0.5))), space.now_ns)
    # Reports that are known at one instant go out one after the other.
    space.now_ns += S
    (report,) = [one for one in space.news() if getattr(one, "name", "") == "joints"]
    wanted = {"joint_1_angle": 0.05, "joint_1_torque": 1.5}
    wanted |= {"joint_2_angle": -0.1, "joint_2_torque": -0.5}
    assert measured(report) == pytest.approx(wanted)
    assert len(report.values) == 2 * MOST_JOINTS


def test_what_the_functional_test_measured_is_an_event(space):
    space.status(test="running", test_number=1)
    metrics = {"left end": 99.5, "stiffness x": None, "Coulomb friction y": 0.5}
    pressed = {f"button {number} pressed and let go": float(number != 2) for number in range(1, 5)}
    failed = {"test": "failed", "test_part": "buttons", "test_number": 1}
    news = space.status(**failed, test_metrics=metrics | pressed)
    assert events(news) == ["test_failed", "test_measured"]
    report = next(one for one in news if getattr(one, "name", "") == "test_measured")
    wanted = {"test_left_end": 99.5, "test_Coulomb_friction_y": 0.5, "test_buttons": 3.0}
    assert measured(report) == pytest.approx(wanted)


def test_the_dictionary_has_each_measure_of_the_functional_test_and_the_modes_of_the_robot():
    handle = OperatedHandle(SimulatedDevice(hand=Hand()))
    quiet = Feedback(0.0, 0.0, 0, False)
    for cycle in range(60_000):
        if cycle == 4000:
            assert handle.handle_command(JoystickEvent.STOP) == ""
            assert handle.handle_command(JoystickEvent.TEST) == ""
        if cycle > 4000 and not handle.operation.testing:
            break
        handle.handle_feedback(quiet)
        handle.step(0.0, 0.0, S // 1000)
    report = handle.operation.test
    assert report.outcome == "passed"
    names = {f"test_{metric.name.replace(' ', '_')}" for metric in report.metrics if metric.unit}
    known = {one.name for one in built_in_dictionary().application("joystick").parameters}
    assert names and names <= known
    mode = built_in_dictionary().application("robot").parameter("mode")
    assert mode.choices == tuple(one.value for one in ControlMode)


def robot_status(**changes):
    known = {"powered": True, "mode": ControlMode.TELEPRESENCE, "push_n": 0.0}
    return RobotStatus(boot_id=1, x_m=0.0, y_m=0.0, **{**known, **changes})


@pytest.mark.parametrize(
    ("parameter", "states"), [("hold", Hold), ("mode", ControlMode), ("error_kind", Fault)]
)
def test_each_state_is_a_choice_of_its_parameter(parameter, states):
    (found,) = built_in_dictionary().application("robot").named([parameter])
    assert {str(state) or "none" for state in states} <= {"none", *found.choices}


def test_the_robot_answers_its_functions_and_a_fault_is_an_event(ground, robot):
    space = ground
    assert robot.handle_asked(FunctionAsked("tasks", 1, "power_on"), 0) is None
    news = space.ask("robot", "call", "set_mode", "position")
    (asked,) = [one for one in news if isinstance(one, FunctionAsked)]
    command = robot.handle_asked(asked, 0)
    assert (command.function, command.mode) == ("set_mode", "position")
    robot.handle_status(robot_status(commanded=command.number - 1), space.now_ns)
    assert not ended(space.news())
    answer = robot_status(commanded=command.number, command_refusal="it is on")
    robot.handle_status(answer, space.now_ns)
    (done,) = ended(space.news())
    assert (done.ok, done.reason) == (False, "it is on")
    said = "E217: захват " + 64 * "!"
    for number, (error, fault, told) in enumerate(
        (("force", "force above 28 N", "force"), ("other", said, "E217: ?????? " + 51 * "!")), 1
    ):
        told_status = robot_status(powered=False, error=error, fault=fault, faults=number)
        for _ in range(2):
            robot.handle_status(told_status, space.now_ns)
        (event,) = reports(space.news())
        assert (event.name, event.values) == ("error", {"error": told})
