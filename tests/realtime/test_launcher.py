"""However a process ends, the others continue; a page stops and starts them and holds up nobody."""

import json
import signal
import subprocess
import sys

import pytest

#: Runs a launcher with the processes `good` and `bad`, and prints what it has counted.
PROGRAM = """
import json, os, signal, socket, sys, time
import msgspec
from kontur_av.clock import MonotonicClock
from kontur_av.returned import PartError
from pipelines.session.launcher import Launcher
from pipelines.session.page_sockets import PageListener
from pipelines.session.session_metrics import SessionNews
from pipelines.session.session_switch import Activity, Order
from pipelines.report.collector import Collector
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import ProcessRow, Stage
from pipelines.table import topology_of

def good(context, until=lambda: False):
    while not context.stopping and not until():
        context.tick(context.clock.now_ns())
        context.clock.sleep_until_ns(context.clock.now_ns() + 10_000_000)

def open_files():
    return {int(name) for name in os.listdir("/proc/self/fd")}

def no_figures(context):
    def fill():
        raise RuntimeError("no figures")
    context.on_flush(fill)

def falls_without_figures(context):
    no_figures(context)
    raise ValueError("fallen")

def real_time_signal(context):
    os.kill(os.getpid(), 40)

def hangs(context):
    if not context.takes_power:
        context.flush(context.clock.now_ns())
        time.sleep(300)

def hangs_with_power_for_ever(context):
    hangs(context)
    raise PartError("power_off() failed")

def forks(context):
    ours, mine = context.listen(0), socket.socket()
    if os.fork() == 0:
        held = [one.fileno() for one in (ours, mine, context.link) if one.fileno() in open_files()]
        os._exit(held != [mine.fileno()])
    raise ValueError(f"its child ended with {os.wait()[1]}")

def cannot_be_used(context):
    raise PartError("read() failed")

def deaf_to_a_closed_terminal(context):
    os.kill(os.getpid(), signal.SIGHUP)
    good(context)

def closes_the_terminal(context):
    os.kill(os.getppid(), signal.SIGHUP)
    good(context)

def commands(context):
    assert set(context.pages) == {"bad"} and context.pages["bad"].socket.fileno() > 0
    for order, state in ((Order.STOP, "stopped"), (Order.START, "running")):
        context.order(order, context.clock.now_ns())
        good(context, lambda: (news := context.receive_news()) and news.state == state)
    os.kill(os.getppid(), signal.SIGTERM)
    good(context)

class Feed:
    def __init__(self):
        self.asked = self.sent = 0

    def poll_messages(self, launcher, now_ns):
        self.asked += 1
        if fill > 1 and self.asked == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        state = "stopped" if launcher.switch.activity is Activity.STOPPED else "running"
        news = msgspec.json.encode(SessionNews(state=state, problems=["." * (fill - 1)]))
        pids = {child.row.name: child.pid for child in launcher.children}
        return {pids["bad"]: news}

    def handle_sent(self, pid):
        self.sent += 1

class Listener(Collector):
    ends = 0

    def handle_exit(self, process, error):
        super().handle_exit(process, error)
        if process == "bad" and bad in FALLS:
            self.ends += 1
            if self.ends == FALLS[bad]:
                os.kill(os.getpid(), signal.SIGTERM)

FALLS = {"no_figures": 2, "falls_without_figures": 2, "real_time_signal": 2, "hangs": 2, "forks": 2,
    "cannot_be_used": 4}
tries = []

def show(launcher):
    tries.append(1)
    if len(tries) == 2:
        os.kill(os.getpid(), signal.SIGTERM)
    raise {"disk": OSError(28, "full"), "reader": BrokenPipeError()}[gone]

bad, seconds, gone, fill = sys.argv[1], float(sys.argv[2]), sys.argv[3], int(sys.argv[4])
topology, feed = topology_of(BUILT_IN["taskboard"]), Feed()
listener = PageListener(
    socket=socket.create_server(("127.0.0.1", 0)), scheme="http", host="127.0.0.1", port=1,
    operator_token="", viewer_token="",
)

def row(name, stage, run):
    run = "__main__:" + run
    powered = name == "bad"
    return ProcessRow(
        name=name, segment=Segment.GROUND, stage=stage, run=run, what="", powered=powered
    )

launcher = Launcher(
    session=f"test-{os.getpid()}",
    topology=topology,
    processes=[row("good", Stage.LINK, "good"), row("bad", Stage.SINK, bad)],
    listener=Listener(topology),
    clock=MonotonicClock(),
    show=show if gone else None,
    pages={"bad": listener} if fill else {},
    feed=feed if fill else None,
)
launcher.run(seconds or None)
print(json.dumps({
    "failed": {child.row.name: child.health.trouble(0, restarts=0, error="", wanted=False)
        for child in launcher.children},
    "ends": {child.row.name: [child.restarts, child.last_error] for child in launcher.children},
    "tries": len(tries), "stops": len(launcher.stopped_s), "asked": feed.asked, "sent": feed.sent,
}))
"""
WELL = {"good": [0, ""], "bad": [0, ""]}


def run(bad, seconds=0.5, gone="", fill=0, hangup=signal.SIG_DFL):
    """Return what a launcher has counted, with [restarts, last error] of each process.

    gone: what its figures cannot be written to, "disk" or "reader". fill: so many octets are in
    each message to the page. hangup: the disposition of SIGHUP that it inherits.
    """
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, bad, str(seconds), gone, str(fill)],
        capture_output=True,
        text=True,
        timeout=90,
        # These tests may run under nohup themselves.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, hangup),
    )
    assert (done.returncode, done.stderr) == (0, "")
    (line,) = done.stdout.splitlines()
    return json.loads(line)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ("no_figures", "RuntimeError: no figures"),
        ("falls_without_figures", "ValueError: fallen"),
        ("real_time_signal", "ended by signal 40"),
        # A child that a user's driver forks keeps none of the session's sockets.
        ("forks", "ValueError: its child ended with 0"),
    ],
)
def test_a_failing_process_affects_no_other(bad, says):
    ends = run(bad, 0)["ends"]
    assert ends["good"] == [0, ""]
    restarts, last_error = ends["bad"]
    assert restarts >= 1 and last_error.startswith(says)


@pytest.mark.parametrize(
    ("bad", "seconds", "says"),
    [
        ("hangs", 0.5, "killed; its power was taken by a process of its own"),
        # No report of others but one: the time that is observed passes more slowly.
        ("hangs", 0, "it hung, and was killed; its power was taken by a process of its own"),
        ("hangs_with_power_for_ever", 0.5, "could not be taken: power_off() failed: take it there"),
        ("cannot_be_used", 0, "it ended, and is not started again: read() failed; its power"),
    ],
)
def test_a_device_loses_its_power_in_a_life_of_its_own_if_its_process_cannot(bad, seconds, says):
    found = run(bad, seconds)
    assert found["failed"]["good"] == "" and found["ends"]["good"] == [0, ""]
    assert says in found["failed"]["bad"]
    assert found["ends"]["bad"][0] == (2 if bad == "cannot_be_used" else 0)


def test_a_closed_terminal_ends_the_session_by_its_launcher_alone_and_nothing_under_nohup():
    assert run("deaf_to_a_closed_terminal")["ends"] == WELL
    assert run("closes_the_terminal", 0)["ends"] == WELL
    assert run("closes_the_terminal", hangup=signal.SIG_IGN)["ends"] == WELL


def test_metrics_that_cannot_be_shown_break_nothing():
    # What shows them also tells a keeper of versions, so it is called again.
    found = run("good", 0, "disk")
    assert found["tries"] > 1 and found["ends"] == WELL
    # Without a time limit: it ends because nobody reads its figures.
    found = run("good", 0, "reader")
    assert found["tries"] == 1 and found["ends"] == WELL


def test_a_page_stops_and_starts_the_other_processes():
    found = run("commands", 80, fill=1)
    assert found["stops"] == 1 and found["ends"] == WELL


def test_a_page_that_reads_nothing_loses_metrics_and_holds_up_nobody():
    # Each message takes nearly all of the socket's buffer.
    found = run("good", 0, fill=900_000)
    assert 0 < found["sent"] < found["asked"] and found["ends"] == WELL


def test_the_launcher_has_one_thread_when_it_forks():
    code = """
import pathlib
from pipelines.cli import main
main(["stream", "--setup", "there-is-none"])  # loads all that a session loads before it forks
from pipelines.session.launcher import load_libraries
load_libraries()
print(len(list(pathlib.Path("/proc/self/task").iterdir())))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=90, check=True
    )
    assert done.stdout.split() == ["1"], done.stderr
