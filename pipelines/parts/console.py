"""The operator's console in space: sends telecommands, receives telemetry, answers `select`."""

import os
import secrets
import select
import socket
from contextlib import suppress

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.topics.session_files import make_session_root
from pipelines.cores.choosing import Console
from pipelines.runtime.control import MAX_LINE_OCTETS, Answer, Request, console_path
from pipelines.runtime.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.topology import TELECOMMAND, TELEMETRY
from telepresence.tmtc import SelectDone

#: The most terminals that may ask at once; others are refused.
_MOST_CLIENTS = 8


class _Client:
    """A terminal with a request. token: of the telecommand for which it waits."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.line = b""
        self.token: int | None = None


def run_console(context: Context) -> None:
    """Turn requests from the control socket into telecommands, and their results into answers."""
    clock, setup, topology = context.clock, context.setup, context.topology
    udp = context.listen(topology.exit_port(TELEMETRY))
    gateway = (LOOPBACK, topology.entry_port(TELECOMMAND))
    console = Console(setup, context.probe, first_token=secrets.randbits(16))
    patience_s = console.sender.tries * console.sender.timeout_ns / NS_PER_S
    listener = _listen(context)
    clients: list[_Client] = []

    def answer(token: int, content: Answer) -> None:
        for client in [client for client in clients if client.token == token]:
            _answer(client, content)
            clients.remove(client)

    context.on_flush(console.tell)
    while not context.stopping:
        now_ns = clock.now_ns()
        context.tick(now_ns)
        due_ns = console.poll_timeout()
        wait_ns = PATIENCE_NS if due_ns is None else min(PATIENCE_NS, max(0, due_ns - now_ns))
        asking = [client.link for client in clients if client.token is None]
        ready = select.select([udp, listener, *asking], [], [], wait_ns / NS_PER_S)[0]
        now_ns = clock.now_ns()
        if listener in ready:
            link, _ = listener.accept()
            link.setblocking(False)
            if len(clients) < _MOST_CLIENTS:
                clients.append(_Client(link))
            else:
                link.close()
        for client in [client for client in clients if client.link in ready]:
            request = _read(client)
            if request is None:
                continue
            camera = request.select
            if not isinstance(camera, str) or camera not in setup.cameras:
                known = ", ".join(setup.cameras)
                error = f"unknown camera {camera}: choose one of {known}"
                _answer(client, Answer(ok=False, error=error, mistake=True))
                clients.remove(client)
            else:
                client.token = console.select(camera, now_ns)
                _tell(client, Answer(wait_s=patience_s))
        while (datagram := context.receive(udp)) is not None:
            console.handle_packet(datagram, now_ns)
        while (packet := console.poll_transmit(now_ns)) is not None:
            udp.sendto(packet, gateway)
        while (event := console.next_event()) is not None:
            if isinstance(event, SelectDone):
                round_trip_ms = event.round_trip_ns / NS_PER_MS
                answer(
                    event.token,
                    Answer(ok=event.ok, camera=event.name, round_trip_ms=round_trip_ms),
                )
            else:
                why = "a later request came" if event.superseded else "no acknowledgement came"
                answer(event.token, Answer(ok=False, error=f"select {event.name}: {why}"))
        gone = [client for client in clients if client.link.fileno() < 0]
        for client in gone:
            clients.remove(client)
    console_path(context.session).unlink(missing_ok=True)


def _listen(context: Context) -> socket.socket:
    path = console_path(context.session)
    make_session_root(context.session)
    path.unlink(missing_ok=True)  # of a console that was killed
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.setblocking(False)
    listener.bind(os.fspath(path))
    listener.listen(_MOST_CLIENTS)
    return listener


def _read(client: _Client) -> Request | None:
    """Return the request if its line is complete. A client that sends anything else is closed."""
    try:
        data = client.link.recv(MAX_LINE_OCTETS)
    except BlockingIOError:
        return None
    except OSError:
        data = b""
    client.line += data
    if b"\n" not in client.line and data and len(client.line) < MAX_LINE_OCTETS:
        return None
    try:
        return msgspec.json.decode(client.line, type=Request)
    except (msgspec.DecodeError, RecursionError):  # RecursionError: "[[[[" without end
        client.link.close()
        return None


def _tell(client: _Client, content: Answer) -> None:
    with suppress(OSError):  # the terminal may have gone
        client.link.sendall(msgspec.json.encode(content) + b"\n")


def _answer(client: _Client, content: Answer) -> None:
    _tell(client, content)
    client.link.close()
