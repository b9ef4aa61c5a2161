"""`kontur-av link` as a process, and sockets of other programs at its ports."""

import contextlib
import json
import os
import socket
import subprocess
from dataclasses import replace
from pathlib import Path

from programs import running
from running_session import COMMAND, RunningSession, eventually, free_base_port

from pipelines.session.command_process import end_with_parent
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

#: Protects against a hang; no test result depends on it.
TIMEOUT_S = 40.0


def listening(port, host="127.0.0.1"):
    """Open the socket of a program."""
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    udp.bind((host, port))
    return udp


def came(udp):
    """Return all datagrams that have arrived."""
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(udp.recv(65_535))
    return found


class RunningLink(RunningSession):
    """The command with options. Its exit ends the process in any case.

    prefix: command that runs it, such as `ip netns exec NAME`.
    """

    def __init__(self, *options, directory, name="link", prefix=(), base_port=None):
        self.name = name
        self.base_port = base_port or free_base_port()
        self.topology = topology_of(replace(BUILT_IN["spacejustin"], base_port=self.base_port))
        self.report_path = Path(directory) / f"{name}.json"
        self._out_path = Path(directory) / f"{name}.txt"
        command = [*prefix, *COMMAND, "link", "--report", self.report_path]
        command += ["--base-port", self.base_port, *options]
        how = {"stdin": subprocess.DEVNULL, "env": {**os.environ, "TMPDIR": str(directory)}}
        how |= {"start_new_session": True, "preexec_fn": end_with_parent}
        self._running = contextlib.ExitStack()
        run = running(self._out_path, *command, patience_s=TIMEOUT_S, **how)
        self.process = self._running.enter_context(run)
        self.seen_pids = set()

    def __exit__(self, *_):
        self._running.close()

    def output(self):
        return self._out_path.read_text()

    errors = output

    def lines(self):
        """Return the lines of figures so far."""
        return [line for line in self.output().splitlines() if line.lstrip()[:1].isdigit()]

    def wait_for_line(self, word):
        """Wait until a new line of figures contains `word`."""
        seen = len(self.lines())

        def there():
            assert self.process.poll() is None, self.output()
            return [line for line in self.lines()[seen:] if word in line]

        return eventually(there, f"a line with {word!r}")

    def end(self):
        """Wait for the end; return the exit code and the report."""
        code = self.process.wait(TIMEOUT_S)
        assert self.report_path.exists(), self.output()
        return code, json.loads(self.report_path.read_text())


def assert_books_are_right(report, setup):
    """Assert that every octet of every frame is counted."""
    profiles = {"uplink": setup.uplink, "downlink": setup.downlink}
    for direction, link in report["link"].items():
        booked = sum(link["octets"].values())
        assert booked == profiles[direction].frame_octets * link["frames"], direction
