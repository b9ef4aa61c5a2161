"""Telecommands stop and start processes, and telemetry tells how they are."""

from dataclasses import replace

import pytest

from pipelines.mission.supervisor import ProcessSupervisor, session_dictionary
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import CommandUpdate, FunctionAsked, Reported, SendCommand
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.session_switch import ProcessOrder
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.table import SessionOptions
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.xtce import dictionary_xtce

S = 1_000_000_000
TOPOLOGY = topology_of(BUILT_IN["spacejustin"])
#: What commands, carries telecommands, or keeps arm, handle and people safe.
KEPT = {"robot", "joystick", "ground_gateway", "space_gateway", "selector", "console"}
KEPT |= {"page_ground", "page_space"}


class Ground:
    """The end of the ground, with a launcher that a test plays."""

    def __init__(self):
        dictionary = session_dictionary(built_in_dictionary(), TOPOLOGY)
        self.end = TmtcEnd(Segment.GROUND, dictionary, now_ns=0, first_count=1, boot_id=1)
        self.supervisor = ProcessSupervisor(Segment.GROUND, TOPOLOGY)
        self.now_ns = self.number = 0
        self.states = {
            row.name: ProcessNow(name=row.name, state="running") for row in TOPOLOGY.processes
        }
        self.orders = []

    def look(self, seconds=1, **changes):
        """The launcher tells all states once a second, with changes of some."""
        for name, change in changes.items():
            self.states[name] = ProcessNow(name=name, **({"state": "running"} | change))
        news = []
        for _ in range(seconds):
            self.now_ns += S
            self.supervisor.handle_told(list(self.states.values()), self.now_ns)
            news += self.work()
        return news

    def work(self):
        for done in iter(self.supervisor.next_event, None):
            self.end.handle_request(done, self.now_ns)
        list(iter(lambda: self.end.poll_transmit(self.now_ns), None))
        news = []
        for one in iter(self.end.next_event, None):
            news.append(one)
            if isinstance(one, FunctionAsked):
                assert self.supervisor.handle_asked(one)
                news += self.work()
        self.orders += iter(self.supervisor.poll_transmit, None)
        return news

    def ask(self, verb, name, *arguments):
        self.number += 1
        request = SendCommand("test", self.number, "ground_supervisor", verb, name, arguments)
        self.end.handle_request(request, self.now_ns)
        return self.work()


@pytest.fixture
def ground():
    """After its first look."""
    found = Ground()
    found.look()
    return found


def events(news):
    return [one.name for one in news if isinstance(one, Reported) and one.kind == "event"]


def ends(news):
    return [(one.id, one.ok) for one in news if isinstance(one, CommandUpdate) and one.done]


def test_a_stop_is_completed_once_the_process_has_stopped_and_a_start_once_it_runs(ground):
    assert ends(ground.ask("call", "stop", "camera_head")) == []
    assert ground.orders == [ProcessOrder("camera_head", run=False)]
    assert ends(ground.look()) == []
    news = ground.look(camera_head={"state": "stopped"})
    assert (events(news), ends(news)) == (["camera_head_changed"], [(1, True)])
    assert ends(ground.ask("call", "start", "camera_head")) == []
    assert ground.orders[1:] == [ProcessOrder("camera_head", run=True)]
    assert ends(ground.look(camera_head={})) == [(2, True)]
    # A later order ends the earlier one.
    ground.ask("call", "stop", "camera_head")
    assert ends(ground.ask("call", "start", "camera_head")) == [(3, False)]


def test_what_safety_needs_cannot_be_stopped_and_an_end_that_nobody_asked_for_is_off_nominal(
    ground,
):
    names = ("robot", "selector", "ground_gateway", "page_ground", "x", "leds")
    for number, process in enumerate(names, 1):
        assert ends(ground.ask("call", "stop", process)) == [(number, False)]
    assert ground.orders == []
    news = ground.look(leds={"state": "running", "restarts": 1}, stereo={"restarts": 1})
    assert events(news) == ["leds_changed", "leds_off_nominal", "stereo_off_nominal"]


@pytest.mark.parametrize(
    "ill", [{"age_ms": 3_100.0}, {"cycles": 900, "slips": 100}, {"cpu_s": 9.0}]
)
def test_a_silent_a_slipping_and_a_busy_process_are_off_nominal_once_it_lasts(ground, ill):
    ground.look(4)
    found = []
    for second in range(1, 6):
        state = dict(ill)
        if "slips" in ill:
            state |= {"cycles": 900 * second, "slips": 100 * second}
        if "cpu_s" in ill:
            state["cpu_s"] = 0.97 * second
        found += events(ground.look(robot=state))
    assert found == ["robot_off_nominal"]


def test_housekeeping_has_the_metrics_of_every_process_of_the_end(ground):
    loop = {"cycles": 9_990, "slips": 10}
    for number in (1, 2):
        ground.ask("housekeeping_on", f"processes_{number}")
    news = ground.look(11, robot={"restarts": 2, "cpu_s": 1.5, "age_ms": 400.0, **loop})
    values = {}
    for one in news:
        values |= one.values if getattr(one, "kind", "") == "housekeeping" else {}
    rows = [row for row in TOPOLOGY.supervised if row.segment is Segment.GROUND]
    assert {f"{row.name}_state" for row in rows} <= set(values)
    robot = {name: value for name, value in values.items() if name.startswith("robot_")}
    assert robot == {
        "robot_state": "running",
        "robot_restarts": 2,
        "robot_cpu": 0.0,
        "robot_age": 0.4,
        "robot_slips": 10,
        "robot_cycles": 9_990,
        "robot_left_out": 0.0,
    }
    assert (values["camera_head_state"], values["leds_state"]) == ("running", "absent")


def test_both_machines_have_the_same_tables_with_all_cameras_and_few_kept_processes():
    plain = session_dictionary(built_in_dictionary(), TOPOLOGY)
    options = {"pages": True, "tasks": True, "packets": True, "recorder": True, "trainer": True}
    full = topology_of(BUILT_IN["spacejustin"], **options)
    assert session_dictionary(built_in_dictionary(), full) == plain
    assert SessionOptions(**options) != TOPOLOGY.options
    assert "ground_supervisor_robot_slips" in dictionary_xtce(plain)
    names = ("a b", "a-b")
    sources = dict.fromkeys(names, "scene:static")
    setup = replace(BUILT_IN["taskboard"], cameras=names, sources=sources)
    dictionary = session_dictionary(built_in_dictionary(), topology_of(setup))
    table = dictionary.application("ground_supervisor")
    assert table.parameter("camera_a_b_state") != table.parameter("camera_a_b__state")
    assert {"camera_a b", "camera_a-b"} <= set(table.parameter("process").choices)
    kept = {row.name for row in TOPOLOGY.supervised if not row.stoppable}
    assert kept == KEPT
    shared = topology_of(replace(BUILT_IN["spacejustin"], partner_arm="shared"))
    more = {row.name for row in shared.supervised if not row.stoppable}
    assert more == KEPT | {"owner_desk"}
