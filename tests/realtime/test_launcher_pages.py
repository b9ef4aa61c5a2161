"""A page stops and starts the other processes, gets figures, and holds up nobody if it stalls."""

import json
import subprocess
import sys

PROGRAM = """
import json, os, socket, sys
from pathlib import Path
from kontur_av.clock import MonotonicClock
from pipelines.session.session_switch import Order
from pipelines.session.launcher import Launcher
from pipelines.session.page_sockets import PageListener
from pipelines.report.collector import Collector
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import ProcessRow, Segment, Stage
from pipelines.table import topology_of

def lives(context):
    with open(sys.argv[2], "a") as log:
        log.write(Path("/proc/self/comm").read_text())

def wait(context, until):
    while not context.stopping and not until():
        context.tick(context.clock.now_ns())
        context.clock.sleep_until_ns(context.clock.now_ns() + 10_000_000)

def good(context):
    lives(context)
    wait(context, lambda: False)

def commands(context):
    lives(context)
    assert set(context.pages) == {"page"} and context.pages["page"].socket.fileno() > 0
    for order, state in ((Order.STOP, b"stopped"), (Order.START, b"running")):
        context.order(order, context.clock.now_ns())
        wait(context, lambda: context.receive_figures() == state)
    os.kill(os.getppid(), 15)
    wait(context, lambda: False)

def stalls(context):
    lives(context)
    wait(context, lambda: False)

class Feed:
    def __init__(self):
        self.asked = self.sent = 0

    def poll_messages(self, launcher, now_ns):
        self.asked += 1
        return {"page": launcher.switch.activity.value.encode() + b"." * fill}

    def handle_sent(self, process):
        self.sent += 1

page, _, seconds, fill = sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4])
topology = topology_of(BUILT_IN["taskboard"])
listener = PageListener(
    socket=socket.create_server(("127.0.0.1", 0)), scheme="http", host="127.0.0.1", port=1,
    operator_token="", viewer_token="",
)
feed = Feed()

def row(name, stage, run):
    run = "__main__:" + run
    return ProcessRow(name=name, segment=Segment.GROUND, stage=stage, run=run, what="")

launcher = Launcher(
    session=f"test-{os.getpid()}",
    topology=topology,
    processes=[row("good", Stage.LINK, "good"), row("page", Stage.SINK, page)],
    listener=Collector(topology),
    clock=MonotonicClock(),
    pages={"page": listener},
    feed=feed,
)
launcher.run(seconds)
print(json.dumps({
    "ends": {child.row.name: [child.restarts, child.last_error] for child in launcher.children},
    "stops": len(launcher.stopped_s), "asked": feed.asked, "sent": feed.sent,
}))
"""


def run(page, tmp_path, seconds, fill=0):
    """What the launcher reports, with the names of all lives in the order of their start."""
    log = tmp_path / "lives"
    words = [sys.executable, "-c", PROGRAM, page, str(log), str(seconds), str(fill)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    found = json.loads(done.stdout)
    assert found["ends"] == {"good": [0, ""], "page": [0, ""]}
    return found, log.read_text().splitlines()


def test_a_page_stops_and_starts_the_other_processes(tmp_path):
    found, lives = run("commands", tmp_path, seconds=40)
    assert found["stops"] == 1
    assert lives[-1] == "kav good"
    assert sorted(lives) == ["kav good", "kav good", "kav page"]


def test_a_page_that_reads_nothing_loses_figures_and_holds_up_nobody(tmp_path):
    # Each message takes nearly all of the socket's buffer.
    found, _ = run("stalls", tmp_path, seconds=3, fill=900_000)
    assert 0 < found["sent"] < found["asked"]
