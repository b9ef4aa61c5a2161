"""Orders, telecommands and status of the robot's controller and of the joystick."""

import pytest

from pipelines.hand.desks import STATUS_NS, JoystickStatusTeller, RobotDesk
from pipelines.hand.hand_topics import STATUS_OCTETS, HandRequest, pack_request, unpack_status
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


def robot_desk(*, tasks):
    return RobotDesk(RobotSide(link=robot_link(life=1)), life=1, tasks=tasks, now_ns=BEGAN_NS)


@pytest.mark.parametrize(("tasks", "powered"), [(True, False), (False, True)])
def test_it_is_off_at_first_only_where_tasks_switch_it_on(tasks, powered):
    desk = robot_desk(tasks=tasks)
    assert desk.status(BEGAN_NS).powered is powered
    assert (desk.control.robot.mode == MODE_IMPEDANCE) is powered


@pytest.mark.rule("S10")
def test_what_was_sent_to_an_earlier_life_changes_nothing_and_the_status_has_an_interval():
    desk = robot_desk(tasks=True)
    desk.handle_order(RobotOrder(5, "power", on=True), BEGAN_NS - 1, BEGAN_NS)
    desk.handle_command(RobotCommand(5, "power_on"), BEGAN_NS - 1, BEGAN_NS)
    status = desk.status(BEGAN_NS)
    assert (status.powered, status.handled, status.commanded) == (False, 0, None)
    desk.handle_order(RobotOrder(6, "power", on=True), BEGAN_NS, BEGAN_NS)
    assert desk.status(BEGAN_NS).powered
    desk, told = robot_desk(tasks=True), []
    ordered_ns = BEGAN_NS + 1510 * MS
    for now_ns in range(BEGAN_NS, BEGAN_NS + 2000 * MS, MS):
        desk.step(now_ns)
        if now_ns == ordered_ns:
            desk.handle_order(RobotOrder(1, "power", on=True), now_ns, now_ns)
        if desk.poll_status(now_ns) is not None:
            told.append(now_ns)
    assert told[1] - told[0] == STATUS_NS and ordered_ns in told
    assert desk.status(now_ns).step_hz == pytest.approx(1000, rel=0.01)


def test_telecommands_are_answered_with_a_refusal_in_words():
    desk = robot_desk(tasks=False)
    on = "the robot is on: switch it off first"
    told = (("set_mode", on), ("power_off", ""), ("set_mode", ""), ("power_on", ""))
    for number, (function, refusal) in enumerate(told):
        command = RobotCommand(number, function, ControlMode.IMPEDANCE)
        desk.handle_command(command, BEGAN_NS, BEGAN_NS)
        status = desk.poll_status(BEGAN_NS)
        assert (status.commanded, status.command_refusal) == (number, refusal)
    assert (status.powered, status.mode) == (True, "impedance")
    for number, function in enumerate(("emergency_stop", "power_on", "release_stop", "power_on")):
        desk.handle_command(RobotCommand(number, function), BEGAN_NS, BEGAN_NS)
        desk.step(BEGAN_NS)
        assert desk.status(BEGAN_NS).stopped_by == ("a telecommand" if number < 2 else "")
    _, *told = [event.what.partition(":")[0] for event in desk._envelope.report().events]
    assert told == [
        "emergency stop by a telecommand",
        "power_on refused",
        "a telecommand released the emergency stop by a telecommand",
    ]
    desk.control.handle_fault("a wire broke")
    desk.handle_command(RobotCommand(9, "power_on"), BEGAN_NS, BEGAN_NS)
    status = desk.poll_status(BEGAN_NS)
    assert (status.error, status.fault) == ("other", "a wire broke")
    assert "reset it first: a wire broke" in status.command_refusal


class JoystickDesk:
    """An operated handle on virtual time, with what its process tells."""

    def __init__(self, **orders):
        self.handle = OperatedHandle(SimulatedDevice(hand=Hand()), **orders)
        self.teller = JoystickStatusTeller(self.handle)
        self.told = []

    def run(self, milliseconds):
        for _ in range(milliseconds):
            self.handle.step(0.0, 0.0, MS)
            if self.handle.now_ns % (10 * MS) == 0:
                data = self.teller.poll_status(self.handle.now_ns)
                if data is not None:
                    assert len(data) <= STATUS_OCTETS
                    self.told.append(unpack_status(data))

    def request(self, number, event):
        self.told.clear()
        self.teller.handle_request(pack_request(HandRequest(number, event)))
        self.run(20)
        return self.told[0]


def test_a_command_is_answered_with_the_state_that_it_led_to():
    desk = JoystickDesk()
    # The state is told only while somebody reads.
    desk.run(500)
    assert desk.told == []
    desk.teller.handle_watched(True)
    desk.run(10)
    assert [one.state for one in desk.told] == [JoystickState.STANDBY]
    desk.run(3500)
    status = desk.told[-1]
    assert status.state == JoystickState.APPLICATION
    assert status.answered is None and status.force_limit_n == 12.0
    for number, event, state in (
        (7, JoystickEvent.HALT, JoystickState.HALTED),
        (9, JoystickEvent.START, JoystickState.APPLICATION),
    ):
        status = desk.request(number, event)
        assert (status.state, status.answered, status.refusal) == (state, number, "")
        if number == 7:
            assert status.reason == "by a person's command"
            status = desk.request(8, JoystickEvent.ACKNOWLEDGE)
            assert status.answered == 8 and "not in the state halted" in status.refusal
    desk.told.clear()
    desk.teller.handle_request(b"nonsense")
    desk.run(1000)
    # Nothing has changed but the hand that took the handle.
    assert 10 <= len(desk.told) <= 13 and {one.answered for one in desk.told} == {9}


def test_a_halt_is_named_with_who_gave_it_in_the_next_life_of_its_process_too():
    desk = JoystickDesk()
    desk.teller.handle_watched(True)
    desk.run(3500)
    desk.teller.handle_telecommand(pack_request(HandRequest(1, JoystickEvent.HALT)))
    desk.run(20)
    assert (desk.told[-1].state, desk.told[-1].reason) == (JoystickState.HALTED, "by a telecommand")
    # Its process is killed, and goes on with its orders.
    desk = JoystickDesk(paused=desk.handle.operation.paused)
    desk.teller.handle_watched(True)
    desk.run(5000)
    named = JoystickState.STANDBY, "halt by a telecommand"
    assert (desk.told[-1].state, desk.told[-1].reason) == named
    assert desk.handle.report().reason == "halt by a telecommand"
    desk.request(2, JoystickEvent.START)
    desk.run(5000)
    assert (desk.told[-1].state, desk.told[-1].reason) == (JoystickState.APPLICATION, "")
