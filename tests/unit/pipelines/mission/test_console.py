"""The operator's console: what terminals are answered, and how long it waits for the ground."""

from dataclasses import replace

import pytest

from pipelines.mission.console import Console, telecommand_sender
from pipelines.session.probe import Probe
from pipelines.session.requests import Answer, Request, pack_line, parse_answer
from pipelines.session.setup.built_in import BUILT_IN
from pipelines.session.terminal_lines import MOST_TERMINALS
from telepresence.tmtc import SelectDone, TelecommandReceiver

MS = 1_000_000
SETUP = BUILT_IN["taskboard"]


class Ground:
    """A console and the ground's side of its telecommands, and what its terminals read."""

    def __init__(self, setup=SETUP):
        self.console = Console(setup, Probe(), first_token=5)
        self.receiver = TelecommandReceiver()
        self.read = {}
        self.closed = set()
        self.opened = 0

    def ask(self, line, now_ns=0):
        terminal, self.opened = self.opened, self.opened + 1
        self.console.handle_terminal(terminal)
        self.drain()
        if terminal in self.console.asking:
            self.console.handle_octets(terminal, line, now_ns)
            self.drain()
        return terminal

    def select(self, camera, now_ns=0):
        return self.ask(pack_line(Request(camera)), now_ns)

    def drain(self):
        while (reply := self.console.next_event()) is not None:
            assert reply.terminal not in self.closed
            self.read[reply.terminal] = self.read.get(reply.terminal, b"") + reply.octets
            if reply.last:
                self.closed.add(reply.terminal)

    def travel(self, now_ns, ok=True):
        """Telecommands go down and are acknowledged, without a delay."""
        while (packet := self.console.poll_transmit(now_ns)) is not None:
            self.receiver.handle_packet(packet, now_ns)
        while (request := self.receiver.next_event()) is not None:
            self.receiver.handle_result(request, ok=ok, selected=request.name, now_ns=now_ns)
        while (packet := self.receiver.poll_transmit(now_ns)) is not None:
            self.console.handle_packet(packet, now_ns)
        self.drain()

    def answers(self, terminal):
        return [parse_answer(line) for line in self.read.get(terminal, b"").splitlines()]


@pytest.mark.parametrize("radio_delay_ms", [0.0, 750.0, 10_000.0])
def test_a_telecommand_needs_one_try_at_any_radio_delay(radio_delay_ms):
    setup = replace(SETUP, radio_delay_ms=radio_delay_ms)
    sender, receiver = telecommand_sender(setup, first_token=5), TelecommandReceiver()
    sender.select("static", 0)
    delay_ns = round(radio_delay_ms * MS) + 50 * MS
    receiver.handle_packet(sender.poll_transmit(0), delay_ns)
    receiver.handle_result(receiver.next_event(), ok=True, selected="static", now_ns=delay_ns)
    assert sender.poll_timeout() > 2 * delay_ns
    sender.handle_packet(receiver.poll_transmit(delay_ns), 2 * delay_ns)
    assert sender.next_event() == SelectDone("static", 5, ok=True, round_trip_ns=2 * delay_ns)


@pytest.mark.parametrize("line", [b"[" * 4096, b"\xff\n", b"7\n", b""])
def test_a_terminal_without_a_valid_request_is_disconnected(line):
    ground = Ground()
    terminal = ground.ask(line)
    assert ground.closed == {terminal}
    assert ground.answers(terminal) == []


def test_a_request_in_pieces_is_read_until_its_end():
    ground = Ground()
    terminal = ground.ask(b'{"select":')
    assert ground.console.asking == [terminal]
    ground.console.handle_octets(terminal, b' "static"}\n', 0)
    ground.drain()
    assert len(ground.answers(terminal)) == 1
    assert ground.console.asking == []


def test_the_terminal_is_told_how_long_to_wait_and_then_what_came_of_it():
    ground = Ground(replace(SETUP, radio_delay_ms=100.0))
    accepted = ground.select("static")
    assert ground.answers(accepted) == [Answer(wait_s=2.1)]
    ground.travel(20 * MS)
    assert ground.answers(accepted)[1:] == [Answer(ok=True, camera="static", round_trip_ms=20.0)]
    refused = ground.select("stereo", 50 * MS)
    ground.travel(60 * MS, ok=False)
    assert ground.answers(refused)[1:] == [Answer(ok=False, camera="stereo", round_trip_ms=10.0)]
    assert ground.closed == {accepted, refused}


def test_the_wait_that_is_told_is_the_one_after_which_the_console_gives_up():
    ground = Ground(replace(SETUP, radio_delay_ms=100.0))
    terminal = ground.select("static")
    gone_ns, tries = 0, 0
    while terminal not in ground.closed:
        gone_ns = ground.console.poll_timeout() or 0
        tries += ground.console.poll_transmit(gone_ns) is not None
        ground.drain()
    told, failed = ground.answers(terminal)
    assert gone_ns == round(told.wait_s * 1000) * MS
    assert tries == 3
    assert failed == Answer(ok=False, error="select static: no acknowledgement came")


@pytest.mark.parametrize("camera", ["roof", 7, None, ["static"]])
def test_an_unknown_camera_is_the_mistake_of_the_asker_and_costs_no_telecommand(camera):
    ground = Ground()
    terminal = ground.select(camera)
    (answer,) = ground.answers(terminal)
    assert answer.mistake and not answer.ok
    assert answer.error == f"unknown camera {camera}: choose one of stereo, static"
    assert ground.closed == {terminal}
    assert ground.console.poll_transmit(0) is None


def test_a_later_request_supersedes_an_open_one():
    ground = Ground()
    first, second = ground.select("static"), ground.select("stereo")
    assert ground.closed == {first}
    assert ground.answers(first)[1].error == "select static: a later request came"
    ground.travel(MS)
    assert ground.answers(second)[1].ok


def test_one_terminal_too_many_is_refused_until_another_has_gone():
    ground = Ground()
    waiting = [ground.ask(b"{") for _ in range(MOST_TERMINALS)]
    refused = ground.select("static")
    assert ground.closed == {refused}
    ground.console.handle_octets(waiting[0], b"", 0)
    ground.drain()
    ground.travel(0)
    terminal = ground.select("static")
    ground.travel(MS)
    assert ground.answers(terminal)[1].ok
