"""However a process of a session ends, the others continue, and the report gives the reason."""

import json
import signal
import subprocess
import sys

import pytest

PROGRAM = """
import json, os, signal, sys
from kontur_av.clock import MonotonicClock
from pipelines.session.launcher import Launcher
from pipelines.report.collector import Collector
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import ProcessRow, Segment, Stage
from pipelines.table import topology_of

def good(context):
    while not context.stopping:
        context.tick(context.clock.now_ns())
        context.clock.sleep_until_ns(context.clock.now_ns() + 10_000_000)

def no_figures(context):
    def fill():
        raise RuntimeError("no figures")
    context.on_flush(fill)

def falls_without_figures(context):
    no_figures(context)
    raise ValueError("fallen")

def real_time_signal(context):
    os.kill(os.getpid(), 40)

def deaf_to_a_closed_terminal(context):
    os.kill(os.getpid(), signal.SIGHUP)
    good(context)

def closes_the_terminal(context):
    os.kill(os.getppid(), signal.SIGHUP)
    good(context)

tries = []

def show(launcher):
    tries.append(1)
    raise {"": None, "disk": OSError(28, "full"), "reader": BrokenPipeError()}[gone]

bad, seconds, gone = sys.argv[1], float(sys.argv[2]), sys.argv[3]
topology = topology_of(BUILT_IN["taskboard"])

def row(name, stage, run):
    run = "__main__:" + run
    return ProcessRow(name=name, segment=Segment.GROUND, stage=stage, run=run, what="")

launcher = Launcher(
    session=f"test-{os.getpid()}",
    topology=topology,
    processes=[row("good", Stage.LINK, "good"), row("bad", Stage.SINK, bad)],
    listener=Collector(topology),
    clock=MonotonicClock(),
    show=show if gone else None,
)
launcher.run(seconds or None)
print(json.dumps({child.row.name: [child.restarts, child.last_error]
                  for child in launcher.children} | ({"tries": len(tries)} if gone else {})))
"""


def ends(bad, seconds=0.5, gone="", hangup=signal.SIG_DFL):
    """Return what a launcher reports of `bad` and of `good`: [restarts, last error] of each.

    gone: what its figures cannot be written to, "disk" or "reader".
    hangup: the disposition of SIGHUP that it inherits.
    """
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, bad, str(seconds), gone],
        capture_output=True,
        text=True,
        timeout=60,
        # These tests may run under nohup themselves.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, hangup),
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    (line,) = done.stdout.splitlines()
    return json.loads(line)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ("no_figures", "RuntimeError: no figures"),
        ("falls_without_figures", "ValueError: fallen"),
        ("real_time_signal", "ended by signal 40"),
    ],
)
def test_a_failing_process_affects_no_other(bad, says):
    figures = ends(bad)
    assert figures["good"] == [0, ""]
    restarts, last_error = figures["bad"]
    assert restarts >= 1
    assert last_error.startswith(says)


def test_a_closed_terminal_ends_the_session_by_its_launcher_alone():
    assert ends("deaf_to_a_closed_terminal") == {"good": [0, ""], "bad": [0, ""]}
    assert ends("closes_the_terminal", 0) == {"good": [0, ""], "bad": [0, ""]}


def test_under_nohup_a_closed_terminal_ends_nothing():
    figures = ends("closes_the_terminal", 0.5, hangup=signal.SIG_IGN)
    assert figures == {"good": [0, ""], "bad": [0, ""]}


def test_figures_that_cannot_be_shown_break_nothing():
    # What shows them also tells a keeper of versions, so it is called again.
    figures = ends("good", 3.5, "disk")
    assert figures.pop("tries") > 1
    assert figures == {"good": [0, ""], "bad": [0, ""]}
    # Without a time limit: it ends because nobody reads its figures.
    assert ends("good", 0, "reader") == {"good": [0, ""], "bad": [0, ""], "tries": 1}
