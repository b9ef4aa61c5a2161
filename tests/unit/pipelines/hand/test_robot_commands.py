"""Orders, telecommands and status of the robot's controller and of the joystick."""

import pytest

from pipelines.hand.hand_topics import HandRequest
from pipelines.hand.robot_commands import STATUS_NS, JoystickStatusTeller, RobotCommands
from pipelines.session.mission_messages import RobotCommand, RobotOrder
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.haptics.hand import Hand
from telepresence.haptics.loop import robot_link
from telepresence.haptics.sample import MODE_IMPEDANCE
from telepresence.tasks.definitions import ControlMode

MS = 1_000_000
BEGAN_NS = 1000 * MS


def robot_commands(*, tasks):
    return RobotCommands(
        RobotSide(link=robot_link(boot_id=1)), boot_id=1, tasks=tasks, now_ns=BEGAN_NS
    )


@pytest.mark.parametrize(("tasks", "powered"), [(True, False), (False, True)])
def test_it_is_off_at_first_only_where_tasks_switch_it_on(tasks, powered):
    service = robot_commands(tasks=tasks)
    assert service.status(BEGAN_NS).powered is powered
    assert (service.control.robot.mode == MODE_IMPEDANCE) is powered


@pytest.mark.rule("S10")
def test_what_was_sent_to_an_earlier_life_changes_nothing_and_the_status_has_an_interval():
    service = robot_commands(tasks=True)
    service.handle_order(RobotOrder(5, "power", on=True), BEGAN_NS - 1, BEGAN_NS)
    service.handle_command(RobotCommand(5, "power_on"), BEGAN_NS - 1, BEGAN_NS)
    status = service.status(BEGAN_NS)
    assert (status.powered, status.handled, status.commanded) == (False, 0, None)
    service.handle_order(RobotOrder(6, "power", on=True), BEGAN_NS, BEGAN_NS)
    assert service.status(BEGAN_NS).powered
    service, told = robot_commands(tasks=True), []
    ordered_ns = BEGAN_NS + 1510 * MS
    for now_ns in range(BEGAN_NS, BEGAN_NS + 2000 * MS, MS):
        service.step(now_ns)
        if now_ns == ordered_ns:
            service.handle_order(RobotOrder(1, "power", on=True), now_ns, now_ns)
        if service.poll_status(now_ns) is not None:
            told.append(now_ns)
    assert told[1] - told[0] == STATUS_NS and ordered_ns in told
    assert service.status(now_ns).step_hz == pytest.approx(1000, rel=0.01)


def test_telecommands_are_answered_with_a_refusal_in_words():
    service = robot_commands(tasks=False)
    on = "the robot is on: switch it off first"
    told = (("set_mode", on), ("power_off", ""), ("set_mode", ""), ("power_on", ""))
    for number, (function, refusal) in enumerate(told):
        command = RobotCommand(number, function, ControlMode.IMPEDANCE)
        service.handle_command(command, BEGAN_NS, BEGAN_NS)
        status = service.poll_status(BEGAN_NS)
        assert (status.commanded, status.command_refusal) == (number, refusal)
    assert (status.powered, status.mode) == (True, "impedance")
    for number, function in enumerate(("emergency_stop", "power_on", "release_stop", "power_on")):
        service.handle_command(RobotCommand(number, function), BEGAN_NS, BEGAN_NS)
        service.step(BEGAN_NS)
        assert service.status(BEGAN_NS).stopped_by == ("a telecommand" if number < 2 else "")
    _, *told = [event.what.partition(":")[0] for event in service._envelope.report().events]
    assert told == [
        "emergency stop by a telecommand",
        "power_on refused",
        "a telecommand released the emergency stop by a telecommand",
    ]
    service.control.handle_fault("a wire broke")
    service.handle_command(RobotCommand(9, "power_on"), BEGAN_NS, BEGAN_NS)
    status = service.poll_status(BEGAN_NS)
    assert (status.error, status.fault) == ("other", "a wire broke")
    assert "reset it first: a wire broke" in status.command_refusal


class JoystickClient:
    """An operated handle on virtual time, with what its process tells."""

    def __init__(self, **orders):
        self.handle = OperatedHandle(SimulatedDevice(hand=Hand()), **orders)
        self.teller = JoystickStatusTeller(self.handle)
        self.told = []

    def run(self, milliseconds):
        for _ in range(milliseconds):
            self.handle.step(0.0, 0.0, MS)
            if self.handle.now_ns % (10 * MS) == 0:
                status = self.teller.poll_status(self.handle.now_ns)
                if status is not None:
                    self.told.append(status)

    def request(self, number, event):
        self.told.clear()
        self.teller.handle_request(HandRequest(number, event))
        self.run(20)
        return self.told[0]


def test_a_command_is_answered_with_the_state_that_it_led_to():
    service = JoystickClient()
    # The state is told only while somebody reads.
    service.run(500)
    assert service.told == []
    service.teller.handle_watched(True)
    service.run(10)
    assert [one.state for one in service.told] == [JoystickState.STANDBY]
    service.run(3500)
    status = service.told[-1]
    assert status.state == JoystickState.APPLICATION
    assert status.answered is None and status.force_limit_n == 12.0
    for number, event, state in (
        (7, JoystickEvent.HALT, JoystickState.HALTED),
        (9, JoystickEvent.START, JoystickState.APPLICATION),
    ):
        status = service.request(number, event)
        assert (status.state, status.answered, status.refusal) == (state, number, "")
        if number == 7:
            assert status.reason == "by a person's command"
            status = service.request(8, JoystickEvent.ACKNOWLEDGE)
            assert status.answered == 8 and "not in the state halted" in status.refusal
    service.told.clear()
    service.teller.handle_request(HandRequest(10, JoystickEvent.FAULT))
    service.run(1000)
    # Nothing has changed but the hand that took the handle.
    assert 10 <= len(service.told) <= 13 and {one.answered for one in service.told} == {9}


def test_a_halt_is_named_with_who_gave_it_in_the_next_life_of_its_process_too():
    service = JoystickClient()
    service.teller.handle_watched(True)
    service.run(3500)
    service.teller.handle_telecommand(HandRequest(1, JoystickEvent.HALT))
    service.run(20)
    assert (service.told[-1].state, service.told[-1].reason) == (
        JoystickState.HALTED,
        "by a telecommand",
    )
    # Its process is killed, and goes on with its orders.
    service = JoystickClient(paused=service.handle.operation.paused)
    service.teller.handle_watched(True)
    service.run(5000)
    named = JoystickState.STANDBY, "halt by a telecommand"
    assert (service.told[-1].state, service.told[-1].reason) == named
    assert service.handle.report().reason == "halt by a telecommand"
    service.request(2, JoystickEvent.START)
    service.run(5000)
    assert (service.told[-1].state, service.told[-1].reason) == (JoystickState.APPLICATION, "")
