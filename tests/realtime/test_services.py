"""TCP services beside a live session: two programs at once, a loss of signal, and again."""

import contextlib
import socket
import socketserver
import threading

from running_session import BOARD, TIMEOUT_S, RunningSession, eventually, tcp_port

OCTETS = bytes(range(256)) * 8
HOST = "127.0.0.1"


class Echo(socketserver.BaseRequestHandler):
    def handle(self):
        with contextlib.suppress(ConnectionError):
            while octets := self.request.recv(4096):
                self.request.sendall(octets)
        self.server.left.release()


@contextlib.contextmanager
def serving(handler):
    """Serve TCP on a port of its own. `left` counts the connections that are over."""
    with socketserver.ThreadingTCPServer((HOST, 0), handler) as server:
        server.left = threading.Semaphore(0)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server
        finally:
            # Else its thread would go on with a descriptor that something else gets next.
            server.shutdown()


def connected(port):
    return socket.create_connection((HOST, port), timeout=TIMEOUT_S)


def read(link, octets):
    """Read so many octets; fewer if the connection ends or is cut off."""
    found = b""
    with contextlib.suppress(ConnectionError):
        while len(found) < octets and (more := link.recv(octets - len(found))):
            found += more
    return found


def converse(port):
    """Whether a conversation went to its end."""
    with contextlib.suppress(ConnectionError), connected(port) as link:
        link.sendall(OCTETS)
        if read(link, len(OCTETS)) == OCTETS:
            link.shutdown(socket.SHUT_WR)
            return read(link, 1) == b""
    return False


def test_programs_use_services_and_a_loss_of_signal_cuts_them_off(tmp_path):
    ports = {"first": tcp_port(), "second": tcp_port()}
    with serving(Echo) as echo:
        options = ["--files", str(tmp_path / "files"), "--trainer"]
        for name, port in ports.items():
            options += ["--service", f"{name}={port}"]
            options += ["--service-allow", f"{name}={HOST}:{echo.server_address[1]}"]
        with RunningSession(BOARD, *options, directory=tmp_path) as session:
            session.wait_for_flow()
            with connected(ports["first"]) as first, connected(ports["second"]) as second:
                first.sendall(OCTETS)
                assert converse(ports["second"])
                assert read(first, len(OCTETS)) == OCTETS
                second.sendall(b"!")
                assert read(second, 1) == b"!"
                assert session.ask("trainer", "los", "2").returncode == 0
                assert read(first, 1) == read(second, 1) == b""
            # The conversation, and those that were cut off.
            for _ in range(3):
                assert echo.left.acquire(timeout=TIMEOUT_S)
            eventually(lambda: converse(ports["second"]), "a conversation in the next contact")
            # The picture comes later, and a session that ends before has failed.
            session.wait_for_flow()
            report = session.finish(sound=True)
    for link in report["link"].values():
        drops = link["queue"]["maintenance"]["drops"]
        assert (drops["full"], drops["expired"]) == (0, 0)
    ground, space = (report["processes"][f"files_{end}"]["counts"] for end in ("ground", "space"))
    for counts in (ground, space):
        assert counts["service_streams_reset"] == 2
        # The session's end may overtake the last word of the last conversation.
        assert counts["service_streams_ended"] in (1, 2)
        assert counts["service_garbage"] == counts["file_garbage"] == 0
        assert counts["service_octets_received"] > len(OCTETS)
    assert space["service_octets_received"] == ground["service_octets_sent"]
