"""A user's component: telecommands reach it, what it says is reported, and nothing storms."""

import numpy as np
import pytest
from battery import Mission, recharges

from kontur_av.errors import ConfigError
from kontur_av.returned import PartError
from pipelines.mission.tmtc_messages import Reported
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.routes import read_routes
from telepresence.tmtc.telemetry_source import FunctionCall, TelemetryReading


@pytest.fixture
def mission():
    return Mission()


def reported(mission, kind):
    return [one for one in mission.told if isinstance(one, Reported) and one.kind == kind]


def test_values_come_as_housekeeping_and_when_they_are_asked_for(mission):
    mission.battery.values = {"voltage": 12.25, "limit": 20}
    mission.run(2)
    reports = reported(mission, "housekeeping")
    (report, *_) = [one for one in reports if one.application == "battery"]
    assert report.values == {"voltage": 12.25, "limit": 20}
    assert mission.ask("parameters", "", "voltage").ok
    assert reported(mission, "parameters")[-1].values == {"voltage": 12.25}
    assert not mission.ask("parameters", "", "target").ok  # it never had a value


def test_a_function_gets_its_arguments_by_name_and_may_refuse_or_raise(mission):
    assert mission.ask("call", "recharge", 12.5).ok
    assert mission.battery.calls == [("recharge", {"target": 12.5})]
    mission.battery.answer = "no charger"
    refused = mission.ask("call", "use", "b")
    assert (refused.stage, refused.reason) == ("failed", "no charger")
    assert mission.metrics().faults == 0
    mission.battery.answer = OSError("no such port\nat all")
    assert mission.ask("call", "recharge", 12.5).reason == "OSError: no such port"
    metrics = mission.metrics()
    assert (metrics.faults, metrics.fault) == (1, "recharge: OSError: no such port")
    mission.battery.answer = None
    assert mission.ask("call", "recharge", 12.5).ok


def test_what_a_telecommand_has_set_outlives_the_process_and_its_range_is_checked(mission):
    assert mission.ask("set", values={"limit": 30}).ok
    assert mission.battery.settings == [("limit", 30)]
    refused = mission.ask("set", values={"limit": 41})
    assert refused.reason == "limit is 41: give at most 40"
    mission.restart(mission.service.settings)
    assert mission.battery.settings == [("limit", 30), ("limit", 30)]
    mission.run(1)
    assert mission.ask("parameters", "", "limit").ok
    assert reported(mission, "parameters")[-1].values == {"limit": 30}
    for value in (11.0, float("nan"), float("inf")):
        line = f"target is {value:g}: give at least 11.1 and at most 14.4"
        assert mission.ask("call", "recharge", value).reason == line
    assert mission.battery.calls == []
    # The limits themselves are within, although no single-precision number is exactly 11.1.
    assert mission.ask("call", "recharge", 11.1).ok
    assert mission.ask("call", "recharge", 14.4).ok


def test_its_own_events_and_those_of_its_limits_are_reported_and_kept_for_the_report(mission):
    mission.battery.raised = ["opened"]
    mission.run(1)
    mission.battery.values = {"voltage": 11.0}
    mission.run(2)
    names = [(one.name, one.severity) for one in reported(mission, "event")]
    # Both ends report it to their processes.
    assert names == [("opened", "info")] * 2 + [("low", "medium")] * 2
    assert [event.what for event in mission.metrics().events] == ["opened", "low: voltage 11 V"]


def test_a_value_at_its_limit_raises_no_second_event_before_it_has_come_back(mission):
    below = (11.0, 11.0, 11.15, 11.0, 11.15, 11.0, 11.0)
    for voltages_v, events in ((below, ["low"]), ((12.0, 12.0, 11.0, 11.0), ["low", "low"])):
        for voltage_v in voltages_v:
            mission.battery.values = {"voltage": voltage_v}
            mission.run(1)
        assert [one[1] for one in mission.battery.heard] == events


def test_an_action_follows_an_event_also_of_another_application(mission):
    mission.battery.follows = recharges
    mission.battery.raised = ["opened"]
    mission.run(1)
    assert mission.battery.calls == [("recharge", {"target": 12.5})]
    assert (mission.metrics().actions, mission.metrics().actions_failed) == (1, 0)
    mission.battery.follows = lambda event: [FunctionCall("battery", "recharge", (99.0,))]
    mission.ends_event("robot", "error")
    mission.run(1)
    metrics = mission.metrics()
    assert (metrics.actions, metrics.actions_failed) == (2, 1)
    assert metrics.events[-1].what.startswith("action failed: battery: target is 99: give at least")


@pytest.mark.parametrize(
    "follows",
    [
        lambda event: 1 / 0,
        lambda event: [("battery", "recharge")],
        lambda event: [FunctionCall("battery", "recharge", (object(),))],
        lambda event: [FunctionCall("battery", "recharge", ("x" * 5000,))],
        lambda event: 7,
    ],
)
def test_an_exception_after_an_event_is_counted_told_and_ends_nothing(mission, follows):
    mission.battery.follows = follows
    mission.battery.raised = ["opened"]
    mission.run(1)
    metrics = mission.metrics()
    assert (metrics.faults, metrics.actions) == (1, 0)
    assert metrics.events[-1].what.startswith("fault: after battery opened: ")
    assert mission.ask("call", "recharge", 12.5).ok


def test_neither_events_nor_actions_storm(mission):
    mission.battery.follows = lambda event: [FunctionCall("battery", "recharge", (12.0,))] * 20
    mission.battery.read = lambda: TelemetryReading({"voltage": 12.0}, ["opened"] * 100)
    mission.run(20)
    metrics = mission.metrics()
    # Eight at once, then one a second.
    assert 8 < len(reported(mission, "event")) / 2 <= 8 + 21
    assert 8 < metrics.actions <= 8 + 21
    assert metrics.events_dropped > 500 and metrics.actions_dropped > 100
    # Telecommands of others still come through.
    assert mission.ask("ping").ok


def test_what_no_table_has_and_unfit_values_are_faults_and_the_rest_is_told(mission):
    mission.battery.values = {"voltage": 12.5, "limit": None, "amps": 3.0}
    mission.battery.raised = ["exploded"]
    mission.run(1)
    assert mission.metrics().faults > 2
    assert mission.ask("parameters", "", "voltage").ok
    assert "exploded" in str([event.what for event in mission.metrics().events])


def test_a_component_that_says_nothing_is_reported_no_more(mission):
    mission.run(3)
    assert mission.ask("report", "report_1").ok is False  # limit has no value
    mission.battery.values = {"voltage": 12.0, "limit": 1}
    mission.run(1)
    assert mission.ask("report", "report_1").ok
    mission.taken = False
    mission.run(8)
    told = len(mission.told)
    mission.run(5)
    late = mission.told[told:]
    assert not [one for one in late if getattr(one, "application", "") == "battery"]
    assert "no value yet" in mission.ask("parameters", "", "voltage").reason


def test_events_wait_for_an_end_that_is_started_again_and_a_late_action_is_given_up(mission):
    mission.run(1)
    mission.taken = False
    mission.battery.raised = ["opened"]
    mission.run(3)
    assert reported(mission, "event") == []
    mission.taken = True
    mission.run(1)
    assert len(reported(mission, "event")) == 2
    assert mission.metrics().requests_waited_ms > 1000
    mission.taken = False
    mission.battery.follows = lambda event: [FunctionCall("battery", "recharge", (12.5,))]
    mission.ends_event("robot", "error")
    mission.run(8)
    mission.taken = True
    mission.run(2)
    assert (mission.battery.calls, mission.metrics().actions_failed) == ([], 1)


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (OSError("E3: no bus"), "battery: read() failed: OSError: E3: no bus"),
        (ConfigError("no bus: plug it in"), "no bus: plug it in"),
        (None, "battery: read() returned None: give a TelemetryReading"),
        (TelemetryReading(7), "battery: read() returned values = 7: give a Mapping"),
    ],
)
def test_a_reading_that_cannot_be_is_one_line_with_its_name_and_the_mend(mission, returned, said):
    def read():
        if isinstance(returned, Exception):
            raise returned
        return returned

    mission.battery.read = read
    with pytest.raises(ConfigError) as refused:
        mission.run(1)
    assert str(refused.value) == said
    # What its own ConfigError says may pass; all else is to be fixed.
    assert isinstance(refused.value, PartError) is not isinstance(returned, ConfigError)


def test_values_may_be_those_of_numpy_and_a_reading_a_plain_tuple(mission):
    mission.battery.read = lambda: ({"voltage": np.array([12.25]), "limit": np.int64(20)},)
    mission.run(2)
    assert reported(mission, "housekeeping")[0].values == {"voltage": 12.25, "limit": 20}
    assert mission.metrics().faults == 0


def test_a_file_routes_data_to_a_component_and_to_ground():
    mission = Mission(
        routes=read_routes(
            b"""<Routes>
  <Route from="battery" data="voltage" to="ground" period_s="2"/>
  <Route from="robot" data="x force" to="battery"/>
  <Route from="joystick" data="temperature" to="battery"/>
</Routes>"""
        )
    )
    ground, space = mission.ends[Segment.GROUND], mission.ends[Segment.SPACE]
    for step in range(100):
        ground.handle_values("robot", {"x": 0.001 * step, "y": 0.5, "force": 1.0}, mission.now_ns)
        space.handle_values("joystick", {"temperature": 31.5}, mission.now_ns)
        mission.run(0.05)
    own = [one.values for one in reported(mission, "housekeeping") if one.application == "battery"]
    # Its class would report `limit`, too.
    assert own and all(values == {"voltage": 12.0} for values in own)
    robot = [values for name, values in mission.battery.data if name == "robot"]
    assert len(robot) >= 9 and all(values.keys() == {"x", "force"} for values in robot)
    assert robot[-1]["x"] > robot[0]["x"]
    assert ("joystick", {"temperature": 31.5}) in mission.battery.data
