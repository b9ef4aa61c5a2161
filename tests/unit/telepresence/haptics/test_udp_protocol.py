"""A session by UDP: what is fresh counts, and nothing that was recorded moves anything."""

import pytest
from udp_controller import KEY, MS, MemoryLine, PythonController, connected

from telepresence.haptics.udp_protocol import MOST_UNANSWERED, UdpRole


@pytest.fixture
def line():
    return connected()


@pytest.fixture
def controller(line):
    return line.controller


def cycles(line, count):
    for _ in range(count):
        line.send()
        line.receive()


def silence(line):
    line.controller.answers = False
    cycles(line, MOST_UNANSWERED + 2)
    line.controller.answers = True


def test_a_handshake_gives_the_facts_and_each_cycle_a_reading(line):
    capabilities = line.session.capabilities
    assert (capabilities.name, capabilities.force_limit_n, capabilities.half_m[0]) == (
        "test",
        25.0,
        pytest.approx(0.15),
    )
    cycles(line, 100)
    report = line.session.report()
    assert (report.udp_sessions, report.udp_losses, report.udp_unanswered) == (1, 0, 0)
    assert report.udp_commands == report.udp_readings >= 100
    assert report.udp_foreign == report.udp_late == report.udp_malformed == 0


def test_a_loop_that_runs_several_cycles_at_once_sends_one_command(line):
    sent = len(line.sent)
    for _ in range(20):
        line.now_ns -= MS
        line.send()
    assert len(line.sent) == sent


def test_silence_ends_the_session_and_a_new_one_begins_by_itself(line, controller):
    controller.answers = False
    cycles(line, MOST_UNANSWERED)
    assert not line.session.silent
    cycles(line, 2)
    assert line.session.silent
    controller.restart()
    controller.answers = True
    cycles(line, 102)
    assert not line.session.silent
    report = line.session.report()
    assert (report.udp_sessions, report.udp_losses) == (2, 1)
    assert report.udp_unanswered == MOST_UNANSWERED


def test_what_was_recorded_neither_counts_nor_moves_anything(line, controller):
    controller.position = [0.05, 0.0]
    line.send()
    (old,) = line.came
    line.receive()
    controller.position = [0.01, 0.0]
    cycles(line, 5)
    line.session.handle_datagram(old)
    assert line.session.reading.axes[0] == pytest.approx(0.01)
    assert line.session.report().udp_late == 1
    # An earlier session's commands at the controller, and its readings here.
    recorded = list(line.sent)
    silence(line)
    cycles(line, 110)
    commands = [one for one in recorded if one[1] == 3]
    assert len(commands) > 5
    assert [answer for command in commands for answer in controller.handle(command)] == []
    before = line.session.report().udp_foreign
    line.session.handle_datagram(old)
    assert line.session.report().udp_foreign == before + 1
    # A recorded hello does not end a session that goes on.
    controller.handle(next(one for one in recorded if one[1] == 1))
    cycles(line, 5)
    assert not line.session.silent and line.session.report().udp_sessions == 2


def test_readings_that_are_held_back_do_not_keep_a_session_alive(line):
    """One comes every other cycle, so each is older than the one before."""
    held = []
    for cycle in range(2 * MOST_UNANSWERED + 4):
        line.send()
        held += line.came
        line.came = []
        if cycle % 2:
            line.session.handle_datagram(held.pop(0))
        assert line.session.silent is (cycle >= 2 * MOST_UNANSWERED - 1), cycle


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        # It cannot check the hello either; here it answers all the same.
        ({"handle": lambda data: [bytes([1, 2, 2, 0]) + bytes(90)]}, "another key"),
        ({"axes": 3}, "another form"),
        ({"takes": 2}, "another form"),
        ({"capabilities": bytes(30)}, "facts that no device has"),
    ],
)
def test_a_controller_that_does_not_fit_is_refused_with_its_reason(change, problem):
    controller = PythonController(KEY)
    for name, value in change.items():
        setattr(controller, name, value)
    line = MemoryLine(UdpRole.ROBOT, controller, key=KEY)
    assert line.connect() is None
    assert problem in line.session.problem
    report = line.session.report()
    assert report.udp_sessions == 0 and report.udp_malformed + report.udp_foreign > 0


def test_another_device_at_the_same_address_is_not_taken_over(line, controller):
    silence(line)
    controller.capabilities = controller.capabilities[:-4] + b"rest"
    cycles(line, 300)
    assert line.session.silent and "facts have changed" in line.session.problem


def test_a_measurement_that_is_not_a_number_is_garbage(line, controller):
    controller.position = [float("nan"), 0.0]
    cycles(line, 3)
    assert line.session.reading.axes[0] == 0.0
    assert line.session.report().udp_malformed == 3
    assert "not a number" in line.session.problem
