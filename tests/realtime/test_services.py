"""TCP services beside a live session: two programs at once, a loss of signal, and again."""

import contextlib
import socket
import socketserver
import threading

from running_session import PATIENCE_S, RunningSession, assert_sound, eventually

OCTETS = bytes(range(256)) * 8
HOST = "127.0.0.1"


class Echo(socketserver.BaseRequestHandler):
    def handle(self):
        with contextlib.suppress(ConnectionError):
            while octets := self.request.recv(4096):
                self.request.sendall(octets)
        self.server.left.release()


class Lines(socketserver.StreamRequestHandler):
    """Answers each line in capitals, behind a prompt, as a shell does."""

    def handle(self):
        with contextlib.suppress(ConnectionError):
            self.wfile.write(b"> ")
            for line in self.rfile:
                self.wfile.write(line.upper() + b"> ")
            self.wfile.write(b"bye\n")
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


def free_tcp_port():
    with socket.socket() as one:
        one.bind((HOST, 0))
        return one.getsockname()[1]


def connected(port):
    return socket.create_connection((HOST, port), timeout=PATIENCE_S)


def read(link, octets):
    """Read so many octets; fewer if the connection ends or is cut off."""
    found = b""
    with contextlib.suppress(ConnectionError):
        while len(found) < octets and (more := link.recv(octets - len(found))):
            found += more
    return found


def converse(port):
    """A short conversation; whether it went to its end."""
    with contextlib.suppress(ConnectionError), connected(port) as link:
        for word in (b"who\n", b"where is it\n"):
            if read(link, 2) != b"> ":
                return False
            link.sendall(word)
            assert read(link, len(word)) == word.upper()
        link.shutdown(socket.SHUT_WR)
        return read(link, 100) == b"> bye\n"
    return False


def test_two_programs_use_services_and_a_loss_of_signal_cuts_them_off(tmp_path):
    ports = {"echo": free_tcp_port(), "lines": free_tcp_port()}
    with serving(Echo) as echo, serving(Lines) as lines:
        options = ["--files", str(tmp_path / "files"), "--trainer"]
        for name, server in (("echo", echo), ("lines", lines)):
            options += ["--service", f"{name}={ports[name]}"]
            options += ["--service-allow", f"{name}={HOST}:{server.server_address[1]}"]
        with RunningSession("taskboard", *options, directory=tmp_path) as session:
            session.wait_for_flow()
            with connected(ports["echo"]) as first, connected(ports["lines"]) as second:
                first.sendall(OCTETS)
                assert converse(ports["lines"])
                assert read(first, len(OCTETS)) == OCTETS
                assert read(second, 2) == b"> "

                assert session.ask("trainer", "los", "3").returncode == 0
                assert read(first, 1) == b""
                assert read(second, 1) == b""
            # The conversation, and those that were cut off.
            for server in (echo, lines, lines):
                assert server.left.acquire(timeout=PATIENCE_S)
            eventually(lambda: converse(ports["lines"]), "a conversation in the next contact")
            # The picture comes later, and a session that ends before has failed.
            session.wait_for_flow()
            code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert_sound(report)
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
