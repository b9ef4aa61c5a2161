"""A whole session as a user runs it: the real command, in its own process."""

import contextlib
import json
import multiprocessing
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from common import TIMEOUT_S, WORKER, eventually, free_port

from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import SHARED_MEMORY, shared_memory
from pipelines.cli import main
from pipelines.session.command_process import end_with_parent
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import PORTS, RtcLeg
from pipelines.table import topology_of

COMMAND = (sys.executable, "-m", "pipelines.cli")
#: For a session: it shows its figures ten times a second, because many tests wait for such a line.
_SESSION = """
import sys
from pipelines.session import launcher
launcher._SHOW_NS //= 10
from pipelines.cli import main
sys.exit(main())
"""
SESSION_COMMAND = (sys.executable, "-c", _SESSION)
#: A seat, the task board and the streams of SpaceJustin, with pictures that cost less.
SEAT = 'cameras = ["static"]\nuplink_video = {cap_kbps = 90, size = "320x240", fps = 15}\n'
BOARD = """
cameras = ["stereo", "static"]
uplink_video = {cap_kbps = 90, size = "320x240", fps = 15}
"""
SMALL = """
cameras = ["static", "head"]
uplink_video = {cap_kbps = 85, size = "320x240", fps = 15}
uplink_voice = {cap_kbps = 8}
downlink_video = {cap_kbps = 512, size = "320x240", fps = 15}
downlink_voice = {cap_kbps = 64}
"""
#: Another terminal: forked from a process that has loaded the commands, which costs less than a new
#: Python for each of them.
_TERMINALS = multiprocessing.get_context("forkserver")
_ASKED = "authority file maintain record select stop task tc trainer"
_TERMINALS.set_forkserver_preload(
    [__name__, *(f"pipelines.commands.{one}" for one in _ASKED.split())]
)
_LIVE_STREAM = re.compile(r"(\w+) [\d.]+/[\d.]+ kbit/s (\d+) shown")
_LIVE_HAPTIC = re.compile(r"(haptic_\w+) (\d+) received")


def free_base_port():
    """Return the first of a block of free ports, below the kernel's range of ephemeral ports."""
    # `running_part` has the blocks before.
    bases = range(29_400, 32_700 - PORTS, PORTS)[WORKER % 4 :: 4]
    # Another run of the tests on the same machine begins elsewhere.
    first = os.getpid() % len(bases)
    for base in (*bases[first:], *bases[:first]):
        with contextlib.ExitStack() as stack:
            try:
                for port in range(base, base + PORTS):
                    udp = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    udp.bind(("127.0.0.1", port))
            except OSError:
                continue
            return base
    pytest.skip("no block of free UDP ports")


def tcp_port():
    return free_port(socket.SOCK_STREAM)


def free_pair():
    """Return a free UDP port, such that the one after it is free, too."""
    return free_port(more=1)


def alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def restarted(report):
    """Return the last error of each process that was restarted."""
    rows = report["processes"].items()
    return {name: entry.get("last_error") for name, entry in rows if entry["restarts"]}


def _name_of(pid):
    comm = Path(f"/proc/{pid}/comm").read_text().strip()
    return comm if comm.startswith("kav ") else None


def written(setup, directory):
    """Return a setup's name, or the path of the file that its text is written to."""
    if "\n" not in setup:
        return setup
    (file := Path(directory) / "setup.toml").write_text(setup)
    return str(file)


class RunningSession:
    """`kontur-av stream` with options. Its exit ends the session in any case.

    setup: a name, or the text of a file. It runs in `directory`. It has its own directory for
    temporary files, so that no other session is found there.
    Without `--page` among its options it serves no pages.
    """

    #: The words before the command.
    prefix = ()

    def __init__(self, setup, *options, directory, prefix=()):
        self.prefix = prefix
        setup = written(setup, directory)
        pages = "--page" in options
        changes = {"rtc": RtcLeg()} if "--rtc" in options else {}
        self.setup = load_setup(setup, changes=changes)
        topology = topology_of(
            self.setup,
            snapshots="--snapshots" in options,
            pages=pages,
            recorder=True,
            tasks=bool({"--plan", "--tasks"} & {*options}),
            metrics="--metrics" in options,
            foxglove="--foxglove" in options,
            packets="--packets" in options,
            frames="--frames" in options,
            ros2="--ros2" in options,
            files="--files" in options,
            trainer="--trainer" in options,
        )
        auto = self.setup.recorded_cameras == "auto" and "--record-cameras" not in options
        if auto and {"--record", "--runs"} & {*options}:
            # Cameras that nobody watches would cost a busy machine a core.
            options = (*options, "--record-cameras", "carried")
        words = ["stream", "--setup", setup, *options, *([] if pages else ["--no-page"])]
        self._begin(topology.processes, words, directory)

    def _begin(self, processes, words, directory):
        """Start the command with these words, which runs these processes."""
        self.directory = Path(directory)
        self.report_path = self.directory / "report.json"
        # Short, because the path of a Unix socket has at most 107 octets; no disk can stall it.
        self.temporary = Path(tempfile.mkdtemp(prefix="kav", dir=SHARED_MEMORY))
        self.base_port = free_base_port()
        self.environment = {**os.environ, "TMPDIR": str(self.temporary), "COLUMNS": "2000"}
        # A test's next session has the robot of the one before, and its stop.
        self.environment["XDG_STATE_HOME"] = str(self.directory / "state")
        self.names = [row.name for row in processes]
        command = [*self.prefix, *SESSION_COMMAND, *words, "--report", str(self.report_path)]
        command += ["--base-port", str(self.base_port)]
        self._out = (self.directory / "out.txt").open("w+")
        self._error = (self.directory / "error.txt").open("w+")
        self.process = subprocess.Popen(
            command,
            cwd=self.directory,
            stdout=self._out,
            stderr=self._error,
            stdin=subprocess.DEVNULL,
            env=self.environment,
            start_new_session=True,
            preexec_fn=end_with_parent,
        )
        self.session = f"{self.setup.name}-{self.process.pid}"
        self.seen_pids = set()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(TIMEOUT_S)
        # Its process group, so also those that nobody looked for.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        for leftover in self.shared_memory():
            leftover.unlink()
        shutil.rmtree(self.temporary, ignore_errors=True)
        self._out.close()
        self._error.close()

    def children(self):
        """Return the pids of its processes in the order of their start."""
        try:
            text = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text()
        except OSError:
            return []
        pids = [int(pid) for pid in text.split() if alive(int(pid))]
        self.seen_pids.update(pids)
        return pids

    def pids(self):
        """Return the pids by the parts' names, once all have started."""

        def all_started():
            assert self.process.poll() is None, self.errors()
            pids = self.children()
            return pids if len(pids) == len(self.names) else None

        pids = dict(zip(self.names, eventually(all_started, "the start"), strict=True))
        for name, pid in pids.items():
            comm = eventually(lambda pid=pid: _name_of(pid), f"the start of {name}")
            assert f"kav {name}".startswith(comm), (name, comm)
        return pids

    def pages(self):
        """Return the addresses of the pages by seat, and the token to watch only."""
        (path,) = eventually(
            lambda: list(self.temporary.glob("*/*/pages.json")), "the addresses of the pages"
        )
        return json.loads(path.read_text())

    def lines(self):
        """Return the lines of figures so far."""
        text = (self.directory / "out.txt").read_text()
        return [line for line in text.splitlines() if re.match(r" *[\d.]+ s  ", line)]

    def shown(self):
        """Return the counts of what was shown or felt, by the newest line of figures."""
        lines = self.lines()
        if not lines:
            return {}
        found = [*_LIVE_STREAM.findall(lines[-1]), *_LIVE_HAPTIC.findall(lines[-1])]
        return {name: int(count) for name, count in found}

    def wait_for_flow(self, names=None):
        """Wait until every stream (or those of `names`) shows more than before."""
        before = self.shown()

        def flowing():
            now = self.shown()
            return now and all(now[name] > before.get(name, 0) for name in names or now)

        eventually(flowing, "the flow of all streams")

    def wait_for_snapshot(self, prefix, more_than):
        """Wait until the report's directory has more than `more_than` pictures of a kind."""
        eventually(
            lambda: len(list(self.directory.glob(f"{prefix}*.png"))) > more_than,
            f"a snapshot of {prefix}",
        )

    def kill(self, pids, name):
        """Kill a process without warning; `pids` has the pid of its next start afterwards."""
        os.kill(pids[name], signal.SIGKILL)
        before = {*pids.values()}

        def newcomer():
            assert self.process.poll() is None, self.errors()
            return {*self.children()} - before

        (pids[name],) = eventually(newcomer, f"the restart of {name}")

    def select(self, camera):
        return self.ask("select", camera)

    def ask(self, *words):
        """Run a command in another terminal."""
        with tempfile.TemporaryDirectory(dir=self.temporary.parent) as said:
            out, error = Path(said) / "out", Path(said) / "error"
            arguments = (words, self.environment, out, error)
            terminal = _TERMINALS.Process(target=_run_command, args=arguments, daemon=True)
            terminal.start()
            terminal.join(TIMEOUT_S)
            if (code := terminal.exitcode) is None:
                terminal.kill()
            assert code is not None, f"{words} has not ended after {TIMEOUT_S:g} s"
            return subprocess.CompletedProcess(words, code, out.read_text(), error.read_text())

    @contextlib.contextmanager
    def bus(self, monkeypatch):
        """Open our own access to the topics of the session."""
        monkeypatch.setenv("TMPDIR", str(self.temporary))
        with TopicBus(self.session) as bus:
            yield bus
        monkeypatch.undo()

    def errors(self):
        return (self.directory / "error.txt").read_text()

    def interrupt(self):
        """Press Ctrl-C; return the exit code and the report."""
        self.process.send_signal(signal.SIGINT)
        return self.end()

    def finish(self, *, silent=False, clean=False, sound=False):
        """Press Ctrl-C; it must end with 0. Return the report.

        silent: it said nothing on standard error. clean: nothing of it is left. sound: see
        `assert_sound`.
        """
        code, report = self.interrupt()
        assert code == 0, (self.errors(), report["failures"])
        assert not silent or self.errors() == ""
        if clean:
            self.assert_nothing_left()
        if sound:
            assert_sound(report)
        return report

    def end(self):
        """Wait for the end; return the exit code and the report."""
        code = self.process.wait(TIMEOUT_S)
        return code, json.loads(self.report_path.read_text())

    def shared_memory(self):
        return shared_memory(self.session)

    def assert_nothing_left(self):
        assert [pid for pid in self.seen_pids if alive(pid)] == []
        assert self.shared_memory() == []
        assert [path for path in self.temporary.rglob("*") if not path.is_dir()] == []


def _run_command(words, environment, out, error):
    for number, path in enumerate((out, error), 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["kontur-av", *words]
    sys.exit(main())


class RunningReplay(RunningSession):
    """`kontur-av replay` of a recording of all streams of `spacejustin`."""

    def __init__(self, path, *options, directory):
        self.setup = load_setup("spacejustin")
        topology = topology_of(self.setup)
        captured = {row.process for row in topology.inputs} | {"stereo"}
        processes = [row for row in topology.processes if row.name not in captured]
        self._begin(processes, ["replay", str(path), *options], directory)


def assert_sound(report):
    """Assert what holds for every report of every session, however slow the machine is."""
    assert report["failures"] == []
    for name, stream in report["streams"].items():
        assert 0 < stream["payload_bps_max_1s"] <= stream["cap_bps"], name
        assert stream["frames_displayed"] > 0, name
    profiles = {"uplink": 32, "downlink": 500}
    for direction, link in report["link"].items():
        octets = sum(link["octets"].values())
        assert octets == profiles[direction] * link["frames"] > 0, direction


def assert_nothing_lost_in_contact(report):
    """Nothing is lost but in a loss of signal, which a host causes that stops for 50 ms.

    Waiting packets are then dropped on purpose, and packets on the link lose some or all parts.
    Return how often the signal was lost.
    """
    gateways = report["gateways"].values()
    contacts_lost = sum(end["supervision"]["counts"]["signals_lost"] for end in gateways)
    for direction, link in report["link"].items():
        waiting = sum(queue["drops"]["signal_lost"] for queue in link["queue"].values())
        in_part = link["packets_dropped"].get("incomplete", 0)
        assert set(link["packets_dropped"]) <= {"incomplete"}, direction
        assert contacts_lost or waiting == in_part == 0, direction
        streams = [s for name, s in report["streams"].items() if name.startswith(direction)]
        assert len(streams) == 2
        assert sum(stream["rtp_lost"] for stream in streams) <= waiting + in_part + contacts_lost
    return contacts_lost
