"""Every event of a session is told once, with its instant, in the order of the instants."""

from dataclasses import fields
from types import SimpleNamespace

import pytest
from told import gateway as told_gateway
from told import message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.streams.staleness import State
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics, SelectorMetrics
from pipelines.mission.mission_metrics import TaskMetrics
from pipelines.report.collector import Collector
from pipelines.report.event_log import DEPTH, EventLog
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.session_switch import Order, SessionSwitch
from pipelines.session.setup.setup_file import BUILT_IN, load_setup
from pipelines.session.task_journal import TaskRow, TaskStep
from pipelines.table import topology_of
from telepresence.haptics.authority import AuthorityEvent
from telepresence.haptics.envelope import SafetyMetrics
from telepresence.haptics.haptic_metrics import JoystickMetrics, RobotMetrics
from telepresence.link.link_metrics import ContactMetrics, ContactWindows
from telepresence.link.peer_path import OpenPath
from telepresence.tasks.experiment import RunStep

SETUP = BUILT_IN["taskboard"]
CONNECTED = {"at_ns": 5000, "from": "configure", "to": "connected", "why": "data both ways"}
SEARCH = {"at_ns": 7050, "from": "connected", "to": "search", "why": "no signal"}


class Session:
    """A collector and the log that looks at it, twice a second from `at_s` on."""

    def __init__(self, setup=SETUP):
        self.collector = Collector(topology_of(setup))
        self.log = EventLog(self.collector)
        self.switch = SessionSwitch()

    def told(self, process, *metrics, at_s=1.0, stream=""):
        told = message(*metrics, stream=stream)
        self.collector.handle_message(process, told, round(at_s * NS_PER_S))

    def look(self, at_s=1.0, processes=()):
        """Return the new events as (instant in µs, what, text)."""
        newest = self.log.events[-1].number if self.log.events else 0
        now_ns = round(at_s * NS_PER_S)
        self.log.handle_look(processes, switch=self.switch, started_ns=0, now_ns=now_ns)
        return [(event.at_us, event.what, event.text) for event in self.log.after(newest)]


@pytest.fixture
def session():
    return Session()


def gateway(contacts=(), history=(), begun_ns=1_000_000, windows=None):
    """The gauges of a gateway whose contacts are (acquired, lost), counted from `begun_ns`."""
    supervision = SimpleNamespace(
        begun_ns=begun_ns,
        contacts=[
            ContactMetrics(acquired_ns=acquired, connected_ns=None, lost_ns=lost)
            for acquired, lost in contacts
        ],
        history=list(history),
    )
    channel = SimpleNamespace(contact=windows)
    return told_gateway(supervision=supervision, radio=SimpleNamespace(channel=channel))


def test_signal_and_state_of_the_link_have_their_own_instants(session):
    between = {**CONNECTED, "at_ns": 4000, "from": "search", "to": "configure"}
    session.told("space_gateway", gateway([(2000, None)], [between, CONNECTED]))
    acquired = (1002, "link", "space: signal acquired")
    connected = (1005, "link", "space: link connected (data both ways)")
    assert session.look() == [acquired, connected]
    assert session.look(1.5) == []
    # The loss is dated back to the last frame, which came before the newest transition told.
    session.told("space_gateway", gateway([(2000, 4500)], [between, CONNECTED, SEARCH]), at_s=2)
    lost = (1004, "link", "space: signal lost")
    assert session.look(2) == [lost, (1007, "link", "space: link search (no signal)")]
    # Both gateways, and a new start of one.
    session.told("ground_gateway", gateway([(2000, None)]), at_s=3)
    session.collector.handle_exit("space_gateway", "")
    session.told("space_gateway", gateway([(2000, None)], begun_ns=3 * NS_PER_S), at_s=3)
    assert session.look(3) == [
        (1002, "link", "ground: signal acquired"),
        (3_000_002, "link", "space: signal acquired"),
    ]


def test_a_pass_begins_and_ends_when_its_orbit_says():
    unknown = dict.fromkeys(("peak_s", "peak_deg", "nearest_km", "farthest_km"), 1)
    unknown |= {"usable_from_s": None, "usable_to_s": None}
    windows = ContactWindows(acquisition="2026-01-01T00:00:00Z", loss_s=300.0, **unknown)
    session = Session(load_setup("taskboard", changes={"radio": "iss-pass"}, radio_start_s=-2.0))
    session.told("ground_gateway", gateway(windows=windows))
    assert session.look(1.9) == []
    assert session.look(2.2) == [(2_000_000, "link", "radio: the pass begins")]
    assert session.look(301.9) == []
    assert session.look(302.4) == [(302_000_000, "link", "radio: the pass ends")]


def test_a_camera_a_restart_and_the_joystick_are_told_once_each(session):
    def robot(restarts, error=""):
        return [ProcessNow(name="robot", restarts=restarts, error=error)]

    session.told("selector", SelectorMetrics(selected="stereo"))
    assert session.look(1, robot(0)) == []
    session.told("selector", SelectorMetrics(selected="static"), at_s=1.7)
    killed = robot(1, "ended by SIGKILL")
    assert session.look(2, killed) == [
        (1_700_000, "camera", "camera static selected"),
        (2_000_000, "process", "robot was started again: ended by SIGKILL"),
    ]
    assert session.look(2.5, killed) == []
    unknown = dict.fromkeys(field.name for field in fields(JoystickMetrics))
    for at_s, state, reason, words in (
        (3, "application", "", "application"),
        (4, "halt", "dead-man released", "halt (dead-man released)"),
    ):
        session.told("joystick", JoystickMetrics(**{**unknown, "state": state, "reason": reason}))
        assert session.look(at_s, killed) == [(at_s * 1_000_000, "joystick", f"joystick: {words}")]
    assert session.look(4.5, killed) == []


def test_a_robots_fault_and_a_process_that_hangs_are_told_once(session):
    robot = ProcessNow(name="robot")
    session.told("robot", RobotMetrics(fault="E217: gripper jammed"))
    told = [(1_000_000, "session", "robot: it is off: E217: gripper jammed")]
    assert session.look(1, [robot]) == told
    for at_s, words in ((2, "it hangs"), (3, "it was killed")):
        hung = [ProcessNow(name="robot", trouble=words)]
        assert session.look(at_s, hung) == [(at_s * 1_000_000, "process", f"robot: {words}")]
        assert session.look(at_s + 0.5, hung) == []
    session.told("robot", RobotMetrics())
    stop = SafetyMetrics(events=(AuthorityEvent(NS_PER_S, "emergency stop by the cosmonaut"),))
    session.told("robot", stop, at_s=3)
    told = [(1_000_000, "session", "robot: emergency stop by the cosmonaut")]
    assert session.look(4, [robot]) == [*told, (4_000_000, "session", "robot: its fault is reset")]


def test_a_stale_picture_and_a_fresh_one_again(session):
    def shown(state, age_ms, at_s):
        gauges = DisplayMetrics(age_ns=age_ms * NS_PER_MS, state=state)
        session.told("space_display", gauges, at_s=at_s, stream="uplink_video")
        return session.look(at_s)

    after_ms = SETUP.stale_after_ns(SETUP.uplink_video) // NS_PER_MS
    assert shown(State.FRESH, 40, 1) == []
    ((at_us, *event),) = shown(State.STALE, after_ms + 100, 2)
    assert event == ["stale", "uplink_video is stale"]
    # It became stale 0.1 s ago; the threshold is no whole number of milliseconds.
    assert abs(at_us - 1_900_000) < 1000
    assert shown(State.STALE, after_ms + 600, 2.5) == []
    assert shown(State.FRESH, 30, 3) == [
        (3_000_000, "stale", "uplink_video is fresh again (30 ms old)")
    ]
    # At the end of the session the picture stops, because that was asked for.
    session.switch.handle_end(4 * NS_PER_S)
    assert shown(State.STALE, after_ms + 100, 4) == []


def test_silent_inputs_and_faults(session):
    session.told("camera_left", CaptureMetrics(captured_ns=NS_PER_S, source_fault="unplugged"))
    assert session.look(1) == [(1_000_000, "input", "camera_left: unplugged")]
    assert session.look(4) == [(4_000_000, "input", "camera_left: no picture for 3 s (unplugged)")]
    assert session.look(4.5) == []
    session.told("camera_left", CaptureMetrics(captured_ns=5 * NS_PER_S), at_s=5)
    assert session.look(5) == [(5_000_000, "input", "camera_left gives again")]


def test_a_stop_on_request_is_one_event_and_nothing_in_it_is_stale_or_silent(session):
    session.told("camera_left", CaptureMetrics(captured_ns=NS_PER_S))
    gauges = DisplayMetrics(age_ns=40 * NS_PER_MS, state=State.FRESH)
    session.told("space_display", gauges, stream="uplink_video")
    assert session.look(1) == []
    session.switch.handle_order(Order.STOP, 1_200_000_000)
    assert session.look(1.5) == [(1_200_000, "session", "session stopped")]
    session.switch.handle_all_ended(1_600_000_000)
    assert session.look(9) == []
    session.switch.handle_order(Order.START, 9 * NS_PER_S)
    session.collector.handle_resumed(9 * NS_PER_S)
    # The picture of before does not count, and there is none yet.
    session.told("space_display", DisplayMetrics(), at_s=9, stream="uplink_video")
    assert session.look(9.5) == [(9_000_000, "session", "session started")]
    session.told("space_display", gauges, at_s=10, stream="uplink_video")
    assert session.look(10) == []


def test_runs_of_tasks_are_told_once_each_with_its_own_instants(session):
    def row(result, steps, reason="", run=7):
        steps = [TaskStep(at_ns=at_us * 1000, step=step.value) for at_us, step in steps]
        zero = dict.fromkeys(("path_m", "force_max_n", "force_mean_n", "delay_ms"), 0.0)
        zero |= {"error_mean": None, "error_max": None, "frames": 0, "frames_lost": 0}
        metrics = {"selected_ns": 0, "seconds": None, "steps": steps, **zero}
        return TaskRow(name="line", run=run, result=result, reason=reason, **metrics)

    first = row("open", [(50, RunStep.SELECTED), (60, RunStep.SHOWN), (70, RunStep.STARTED)])
    session.told("tasks", TaskMetrics(runs={7: first}))
    assert session.look() == [
        (50, "session", "task line, run 7: selected"),
        (70, "session", "task line, run 7: started"),
    ]
    # Its process was killed.
    killed = row("aborted", [], "the task's process was restarted")
    runs = {7: killed, 8: row("open", [(900, RunStep.SELECTED)], run=8)}
    session.told("tasks", TaskMetrics(runs=runs))
    words = "task line, run 7: aborted: the task's process was restarted"
    assert session.look(2) == [
        (900, "session", "task line, run 8: selected"),
        (2_000_000, "session", words),
    ]
    assert session.look(2.5) == []


def test_an_input_is_taken_over_a_path_is_open_and_only_the_newest_events_are_kept(session):
    def look(live, at_s):
        gauges = CaptureMetrics(captured_ns=round(at_s * NS_PER_S), live_source=live)
        session.told("camera_left", gauges, at_s=at_s)
        return session.look(at_s)

    assert look("own", 1) == []
    assert look("page", 2) == [(2_000_000, "input", "left: a page took over")]
    assert look("page", 2.5) == []
    assert look("own", 3) == [(3_000_000, "input", "left: its own source again")]
    # A path without protection is told once.
    path = OpenPath(SETUP.downlink, address=("192.0.2.1", 27000), now_ns=5)
    session.told("ground_gateway", path.report(NS_PER_S))
    (told,) = [text for _, what, text in session.look() if what == "link"]
    assert told == "ground: the path is NOT PROTECTED"
    assert session.look(2) == []
    for number in range(DEPTH + 5):
        session.told("selector", SelectorMetrics(selected=f"camera{number}"))
        session.look(1)
    numbers = [event.number for event in session.log.events]
    assert numbers == list(range(numbers[-1] - DEPTH + 1, numbers[-1] + 1)) and numbers[0] > 5
