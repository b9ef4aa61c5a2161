"""Whether each process of a session did its work, as its launcher observes them."""

from itertools import product
from random import Random

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.session_switch import NO_REASON
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.rows import WATCHER_PRIORITY
from pipelines.session.verdict import ObservedTime, ProcessHealth, process_failures
from pipelines.table import topology_of

ROWS = topology_of(BUILT_IN["spacejustin"], pages=True).processes
STEP_NS = 50 * NS_PER_MS
ENDS_S = 20
#: What is done to a process from an instant on, and what then is said of it.
WAYS = {
    "hangs": "ended no cycle for more than 1 s",
    "starves": "ended no cycle for more than 1 s",
    "is killed each second": "more than 2 times: ended by SIGKILL",
    "ends": "it ended without a reason",
    "is killed, never comes up": "has not come up in 15 s: ended by SIGKILL",
    "is deaf": "did not end when it was asked to",
}


class Session:
    """The launcher's calls. stalls: from when to when nothing reports; dead: nor it runs itself.
    late_s: a report may be so late.
    """

    def __init__(self, seed, *, victim=None, way="", from_s=0.0, stalls=(), dead=True, late_s=0.1):
        self.random, self.observed, self.late_s = Random(seed), ObservedTime(), late_s
        self.health = {
            row.name: ProcessHealth(idle=row.priority == WATCHER_PRIORITY) for row in ROWS
        }
        self.due_ns = {name: self.pause() for name in self.health}
        self.restarts = dict.fromkeys(self.health, 0)
        self.said = {}
        for now_ns in range(0, (ENDS_S + 15 * ("never" in way)) * NS_PER_S, STEP_NS):
            stalled = any(begin <= now_ns / NS_PER_S < end for begin, end in stalls)
            if stalled and dead:
                continue
            if now_ns % NS_PER_S == 0:
                self.observed.handle_second(now_ns)
            self.step(now_ns, stalled, victim, way if now_ns >= from_s * NS_PER_S else "")
        if way == "is deaf":
            self.health[victim].handle_killed()
            self.look()

    def pause(self):
        return round(self.random.uniform(0.5, 0.6 + self.late_s) * NS_PER_S)

    def step(self, now_ns, stalled, victim, way):
        for name, health in self.health.items():
            if stalled:
                # They wake one after the other.
                self.due_ns[name] = max(self.due_ns[name], now_ns + self.pause())
            elif now_ns >= self.due_ns[name]:
                self.due_ns[name] = now_ns + self.pause()
                self.report(name, health, now_ns, way if name == victim else "")
        self.look()

    def report(self, name, health, now_ns, way):
        at_ns = self.observed.now_ns
        if way in ("is killed each second", "ends", "is killed, never comes up"):
            if "each" in way or not self.restarts[name]:
                health.handle_end(NO_REASON if way == "ends" else "ended by SIGKILL", at_ns)
                health.handle_start(at_ns)
                self.restarts[name] += 1
            if "never" in way:
                return
        elif way == "hangs":
            return
        elif way == "starves":
            self.due_ns[name] = now_ns + 6 * NS_PER_S
        self.observed.handle_report(now_ns, len(self.health))
        health.handle_report(self.observed.now_ns)

    def look(self):
        """What is said last of each process."""
        for name, health in self.health.items():
            error = "ended by SIGKILL" if self.restarts[name] else ""
            restarts, at_ns = self.restarts[name], self.observed.now_ns
            words = health.trouble(at_ns, restarts=restarts, error=error, wanted=True)
            self.said |= {name: words} if words else {}


@pytest.mark.parametrize("way", WAYS)
def test_each_process_that_does_not_do_its_work_is_named_in_every_phase_and_no_other(way):
    victims = [row.name for row in ROWS if row.priority != WATCHER_PRIORITY]
    for seed, (victim, from_s) in enumerate(product(victims, (1.0, 8.0, ENDS_S - 5.0))):
        said = Session(seed, victim=victim, way=way, from_s=from_s).said
        assert list(said) == [victim] and WAYS[way] in said[victim], (victim, from_s, said)


@pytest.mark.parametrize("dead", [True, False], ids=["launcher, too", "processes"])
def test_a_machine_that_stalls_for_seconds_is_no_hung_process(dead):
    for seed in range(20):
        begin_s = Random(seed).uniform(1.0, 8.0)
        stalls = ((begin_s, begin_s + 4.0), (begin_s + 5.0, begin_s + 8.0))
        assert Session(seed, stalls=stalls, dead=dead).said == {}
        # On a machine that is too busy, all are late.
        assert Session(seed, late_s=2.0).said == {}


def test_one_that_hung_shortly_and_ends_when_asked_has_not_failed():
    health = ProcessHealth()
    health.handle_report(NS_PER_S)
    for at_s, ended, hangs in ((3, False, True), (3, True, False), (7, True, True)):
        capabilities = {"restarts": 0, "error": "", "wanted": True, "ended": ended}
        assert bool(health.trouble(at_s * NS_PER_S, **capabilities)) is hangs, (at_s, ended)


def test_one_that_was_killed_twice_is_late_or_is_not_to_run_has_not_failed():
    health, capabilities = ProcessHealth(idle=True), {"restarts": 2, "error": "ended by SIGSEGV"}
    for at_s, report in ((0.5, True), (15.4, False), (15.4, True), (25.0, False)):
        assert health.trouble(round(at_s * NS_PER_S), **capabilities, wanted=True) == ""
        if report:
            health.handle_report(round(at_s * NS_PER_S))
    health.handle_killed()
    assert health.trouble(99 * NS_PER_S, **capabilities, wanted=False) == ""
    assert "it hangs" in health.trouble(99 * NS_PER_S, **capabilities, wanted=True)
    # One that hung for long has failed, even if it goes on.
    health.handle_report(99 * NS_PER_S)
    words = health.trouble(99 * NS_PER_S, **capabilities, wanted=False)
    now = ProcessNow(name="files", trouble=words)
    assert process_failures([now]) == [f"files: {words}"] and "it hangs" in words


def test_a_process_with_a_device_is_lost_after_5_s_and_at_once_if_a_stop_is_unanswered():
    health = ProcessHealth()
    health.handle_start(0)
    # It may open its device.
    assert not health.is_lost(29 * NS_PER_S, unanswered=True)
    assert health.is_lost(30 * NS_PER_S, unanswered=False)
    health.handle_report(0)
    lost = [health.is_lost(s * NS_PER_S, unanswered=one) for s in (1, 2, 5) for one in (0, 1)]
    assert lost == [False, False, False, True, True, True]
