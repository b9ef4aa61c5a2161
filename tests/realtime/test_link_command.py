"""`kontur-av link` carries the datagrams of programs, and none from unknown senders."""

import contextlib
import os
import signal

import pytest
from running_link import (
    RunningLink,
    assert_books_are_right,
    came,
    eventually,
    free_base_port,
    listening,
)

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.table import PORTS
from pipelines.table import topology_of

SPACEJUSTIN = BUILT_IN["spacejustin"]
FLOWS = [row.flow for row in topology_of(SPACEJUSTIN).streams if row.flow is not None]


@pytest.fixture
def start(tmp_path):
    """start(*options, **how): the running link, which ends after the test in any case."""
    with contextlib.ExitStack() as stack:
        yield lambda *options, **how: stack.enter_context(
            RunningLink(*options, directory=tmp_path, **how)
        )


@pytest.fixture
def program():
    """program(port, host): a socket of a program, which is closed after the test."""
    with contextlib.ExitStack() as stack:
        yield lambda port, host="127.0.0.1": stack.enter_context(listening(port, host))


def until_through(sender, to, receiver, data):
    """Send `data` repeatedly until it comes out; `sender` never gets an answer."""

    def through():
        sender.sendto(data, to)
        return data in came(receiver)

    eventually(through, f"{data!r} from {to} through the link")


def test_programs_talk_through_it_and_strangers_do_not(start, program):
    link = start("--setup", "spacejustin")
    session = link.topology
    anyone = program(0)
    # Packets of all kinds in both directions, and samples.
    exits = {flow.name: program(session.exit_port(flow.name)) for flow in FLOWS}
    for name in ("uplink_maintenance", "downlink_maintenance"):
        until_through(anyone, ("127.0.0.1", session.entry_port(name)), exits[name], name.encode())
    for name in ("uplink_video", "downlink_video", "uplink_voice", "downlink_voice"):
        where = "127.0.0.1", session.entry_port(name)
        until_through(anyone, where, exits[name], b"\x80\x60\0\7" + bytes(8) + b"payload")
    joystick, robot = (
        program(session.exit_port("uplink_haptic")),
        program(session.exit_port("downlink_haptic")),
    )
    for sender, entry, receiver in (
        (robot, "uplink_haptic", joystick),
        (joystick, "downlink_haptic", robot),
    ):
        until_through(sender, ("127.0.0.1", session.entry_port(entry)), receiver, b"twelve or so")

    children = link.children()
    assert len(children) == 2
    entries = [session.entry_port(flow.name) for flow in FLOWS]
    every = [
        session.radio_port(Segment.GROUND),
        session.radio_port(Segment.SPACE),
        session.entry_port("uplink_haptic"),
        session.entry_port("downlink_haptic"),
    ]
    for port in every + entries:
        for size in (0, 1, 12, 32, 500, 1400, 9000):
            anyone.sendto(os.urandom(size), ("127.0.0.1", port))
            anyone.sendto(bytes(size), ("127.0.0.1", port))
    link.wait_for_line("unknown senders")
    for name in ("uplink_maintenance", "downlink_maintenance"):
        until_through(anyone, ("127.0.0.1", session.entry_port(name)), exits[name], b"still there")
    assert link.children() == children

    def connected():
        for name in ("uplink_maintenance", "downlink_maintenance"):
            anyone.sendto(b"both ways", ("127.0.0.1", session.entry_port(name)))
        return any("ground connected" in line for line in link.lines())

    eventually(connected, "application data both ways")
    report = link.finish()

    assert_books_are_right(report, SPACEJUSTIN)
    assert report["failures"] == []
    for end in ("ground", "space"):
        assert report["gateways"][end]["unknown_senders"] == {"radio": 14}
        assert report["gateways"][end]["supervision"]["contacts"]
    for link_report in report["link"].values():
        assert link_report["refused"]["garbage"] > 0
        assert link_report["refused"]["oversize"] > 0
        assert link_report["frames_dropped"] == {}
        assert link_report["lateness_us"]["max"] <= link_report["sent_after_us"]["max"]
    assert report["link"]["uplink"]["octets"]["haptic"] > 0


def test_two_ends_that_trust_each_other_carry_datagrams_and_heed_no_stranger(start, program, keys):
    bases = [free_base_port(), None]
    bases[1] = bases[0] + PORTS
    where = f"127.0.0.2:{bases[0]}"
    options = ("--setup", "taskboard", "--radio", "clean", "--seed", "5")
    # The end that calls may start first.
    space = start(
        *(*options, "--end", "space", "--peer", where, "--key", str(keys["space"])),
        *("--apps", "127.0.0.3", "--apps-bind", "127.0.0.2"),
        base_port=bases[1],
        name="space",
    )
    ground = start(
        *(*options, "--end", "ground", "--listen", where, "--key", str(keys["ground"])),
        base_port=bases[0],
        name="ground",
    )
    here, there, unknown = program(0), program(0, "127.0.0.3"), program(0, "127.0.0.4")
    up = program(space.topology.exit_port("uplink_maintenance"), "127.0.0.3")
    down = program(ground.topology.exit_port("downlink_maintenance"))
    until_through(here, ("127.0.0.1", ground.topology.entry_port("uplink_maintenance")), up, b"up")
    entry = "127.0.0.2", space.topology.entry_port("downlink_maintenance")
    for _ in range(3):
        unknown.sendto(b"not from the programs", entry)
        # A whole frame, but not in a record.
        here.sendto(bytes(500), ("127.0.0.2", bases[0]))
    until_through(there, entry, down, b"down")
    report = ground.finish()
    assert report["ends"] == ["ground"]
    assert report["link"]["downlink"]["packets"]["downlink_maintenance"] > 0
    assert_books_are_right(report, BUILT_IN["taskboard"])
    path = report["gateways"]["ground"]["peer"]
    assert path["protected"]
    assert path["session_ns"] is not None
    assert path["dropped"]["malformed"] == 3
    report = space.finish()
    assert report["gateways"]["space"]["unknown_senders"] == {"downlink_maintenance": 3}
    assert report["gateways"]["space"]["peer"]["address"] == where
    assert set(came(down)) <= {b"down"}
    # No report, line or file of an end has its private key.
    for end in (ground, space):
        secret = keys[end.name].read_text().splitlines()[1]
        assert secret not in end.output() + end.report_path.read_text()


def test_a_killed_gateway_is_restarted_and_reported(start, program):
    link = start("--setup", "taskboard")
    session = link.topology
    anyone, out = program(0), program(session.exit_port("uplink_maintenance"))
    entry = "127.0.0.1", session.entry_port("uplink_maintenance")
    until_through(anyone, entry, out, b"before")
    os.kill(link.children()[0], signal.SIGKILL)
    until_through(anyone, entry, out, b"after")
    code, report = link.interrupt()
    assert code == 1
    assert ["ground_gateway" in failure for failure in report["failures"]] == [True]


def test_it_ends_by_itself_and_two_do_not_share_ports(start, capsys):
    from pipelines.cli import main

    link = start("--setup", "taskboard", name="endless")
    eventually(lambda: len(link.children()) == 2, "the start")
    assert main(["link", "--setup", "taskboard", "--base-port", str(link.base_port)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "busy" in line
    link = start("--setup", "taskboard", "--seconds", "2", "-q")
    code, report = link.end()
    assert (code, link.output()) == (0, "")
    assert report["seconds"] >= 2
