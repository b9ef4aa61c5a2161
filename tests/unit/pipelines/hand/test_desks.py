"""Orders, telecommands and status of the robot controller."""

import pytest

from pipelines.hand.desks import STATUS_NS, RobotDesk
from pipelines.session.mission_messages import RobotCommand, RobotOrder
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.loop import robot_link
from telepresence.haptics.sample import MODE_IMPEDANCE
from telepresence.tasks.definitions import ControlMode

MS = 1_000_000
BEGAN_NS = 1000 * MS


def desk(*, tasks):
    return RobotDesk(RobotSide(link=robot_link(life=1)), life=1, tasks=tasks, now_ns=BEGAN_NS)


@pytest.mark.parametrize(("tasks", "powered"), [(True, False), (False, True)])
def test_it_is_off_at_first_only_where_tasks_switch_it_on(tasks, powered):
    one = desk(tasks=tasks)
    assert one.status(BEGAN_NS).powered is powered
    assert (one.control.robot.mode == MODE_IMPEDANCE) is powered


def test_what_was_sent_to_an_earlier_life_changes_nothing():
    one = desk(tasks=True)
    one.handle_order(RobotOrder(5, "power", on=True), BEGAN_NS - 1, BEGAN_NS)
    one.handle_command(RobotCommand(5, "power_on"), BEGAN_NS - 1, BEGAN_NS)
    status = one.status(BEGAN_NS)
    assert (status.powered, status.handled, status.commanded) == (False, 0, None)
    one.handle_order(RobotOrder(6, "power", on=True), BEGAN_NS, BEGAN_NS)
    assert one.status(BEGAN_NS).powered


def test_telecommands_are_answered_with_a_refusal_in_words():
    one = desk(tasks=False)
    answers = []
    for number, function in enumerate(["set_mode", "power_off", "set_mode", "power_on"]):
        command = RobotCommand(number, function, ControlMode.IMPEDANCE)
        one.handle_command(command, BEGAN_NS, BEGAN_NS)
        status = one.poll_status(BEGAN_NS)
        assert status.commanded == number
        answers.append(status.command_refusal)
    assert answers == ["the robot is on: switch it off first", "", "", ""]
    assert (status.powered, status.mode) == (True, "impedance")
    one.control.handle_fault("a wire broke")
    one.handle_command(RobotCommand(9, "power_on"), BEGAN_NS, BEGAN_NS)
    status = one.poll_status(BEGAN_NS)
    assert (status.error, status.fault) == ("other", "a wire broke")
    assert "reset it first: a wire broke" in status.command_refusal


def test_the_status_is_told_at_its_interval_and_at_changes():
    one = desk(tasks=True)
    told = []
    for now_ns in range(BEGAN_NS, BEGAN_NS + 2000 * MS, MS):
        one.step(now_ns)
        if now_ns == BEGAN_NS + 1510 * MS:
            one.handle_order(RobotOrder(1, "power", on=True), now_ns, now_ns)
        if one.poll_status(now_ns) is not None:
            told.append(now_ns)
    assert told[1] - told[0] == STATUS_NS
    assert BEGAN_NS + 1510 * MS in told
    assert one.status(now_ns).step_hz == pytest.approx(1000, rel=0.01)
