"""The operator's console: how long it waits for space, and which requests it accepts."""

import socket
from dataclasses import replace

import pytest

from pipelines.cores.choosing import telecommand_sender
from pipelines.parts.console import _Client, _read
from pipelines.setup.built_in import BUILT_IN
from telepresence.tmtc import SelectDone, TelecommandReceiver

MS = 1_000_000


@pytest.mark.parametrize("radio_delay_ms", [0.0, 750.0, 10_000.0])
def test_a_telecommand_needs_one_try_at_any_radio_delay(radio_delay_ms):
    setup = replace(BUILT_IN["taskboard"], radio_delay_ms=radio_delay_ms)
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
    terminal, link = socket.socketpair()
    with terminal:
        terminal.sendall(line)
        terminal.shutdown(socket.SHUT_WR)
        client = _Client(link)
        assert _read(client) is None
        assert link.fileno() < 0
