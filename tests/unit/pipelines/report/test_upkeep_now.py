"""What a systems operator is told beforehand, and what holds updates back."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from told import gateway, message

from kontur_av.clock import NS_PER_S
from pipelines.mission.mission_metrics import TaskMetrics
from pipelines.report import upkeep_now
from pipelines.report.collector import Collector
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.envelope import Hold, SafetyMetrics
from telepresence.haptics.haptic_metrics import JoystickMetrics
from telepresence.link.link_metrics import ReceiverMetrics, SenderMetrics
from telepresence.link.radio import load_radio
from telepresence.link.radio.profile import Blackout

SETUP = BUILT_IN["taskboard"]


def collector(*, segments=tuple(Segment), joystick="evdev"):
    return Collector(topology_of(SETUP, segments=segments, joystick=joystick, pages=True))


def publish(found, process, *metrics, at_s=0):
    found.handle_message(process, message(*metrics), at_s * NS_PER_S)


def test_signal_drop_outs_and_shadowing_are_announced_with_the_time_left():
    # The mast stands in the way of a pass that began 100 s ago.
    profile = replace(
        load_radio("iss-pass"), start_s=100.0, blackouts=(Blackout(start_s=80.0, seconds=5.0),)
    )
    ahead = upkeep_now.ContactAhead(upkeep_now.planned_contact(profile, profile.contact_windows()))
    said = [
        (round(at_s), words)
        for half in range(2 * 500)
        for at_s, words in ahead.handle_time(100.0 + half / 2)
    ]
    assert said == [
        (120, "shadowing in 60 s"),
        (125, "end of shadowing in 60 s"),
        (170, "shadowing in 10 s"),
        (175, "end of shadowing in 10 s"),
        (180, "shadowing"),
        (185, "end of shadowing"),
        (476, "drop-outs in 60 s"),
        (526, "drop-outs in 10 s"),
        (533, "loss of signal in 60 s"),
        (536, "drop-outs"),
        (583, "loss of signal in 10 s"),
    ]
    assert ahead.next is None


def robot(hold):
    return SafetyMetrics(hold=hold)


def task(result):
    return TaskMetrics(runs={2: SimpleNamespace(name="aiming", run=2, result=result)})


def driven(state):
    names = JoystickMetrics.__dataclass_fields__
    return JoystickMetrics(**{**dict.fromkeys(names, 0), "state": state})


SPACE, GROUND = (Segment.SPACE,), (Segment.GROUND,)


@pytest.mark.parametrize(
    ("options", "process", "metrics", "runs"),
    [
        ({}, "tasks", task("open"), "aiming, run 2"),
        ({}, "tasks", task("finished"), ""),
        ({}, "robot", robot(Hold.NONE), "the robot follows the hand"),
        ({}, "robot", robot(Hold.RELEASED), ""),
        ({}, "page_space", PageMetrics(holder=3), "a page has the handle"),
        # A simulated hand taps all day.
        ({"joystick": "sim"}, "robot", robot(Hold.NONE), ""),
        ({"joystick": "sim", "segments": GROUND}, "robot", robot(Hold.NONE), "the robot follows"),
        # In space alone nobody knows the robot.
        ({"segments": SPACE}, "joystick", driven("application"), "the joystick drives"),
        ({"segments": SPACE}, "joystick", driven("halted"), ""),
        ({"segments": SPACE, "joystick": "page"}, "joystick", driven("application"), ""),
    ],
)
def test_an_experiment_runs_while_a_task_does_or_a_person_has_the_arm(
    options, process, metrics, runs
):
    found = collector(**options)
    watch = upkeep_now.ExperimentWatch(found)
    assert watch.handle_time(NS_PER_S) == ""
    publish(found, process, metrics)
    words = watch.handle_time(2 * NS_PER_S)
    assert words.startswith(runs)
    assert bool(words) is bool(runs)


def test_a_hand_that_lets_go_for_a_moment_has_not_ended_it_and_a_stopped_process_has():
    released, silent = collector(), collector()
    watches = [upkeep_now.ExperimentWatch(one) for one in (released, silent)]
    for one, watch in zip((released, silent), watches, strict=True):
        publish(one, "robot", robot(Hold.NONE), at_s=20)
        assert watch.handle_time(20 * NS_PER_S)
    publish(released, "robot", robot(Hold.RELEASED), at_s=29)
    for seconds, runs in ((29, [True, True]), (30, [False, True]), (38, [False, True])):
        assert [bool(one.handle_time(seconds * NS_PER_S)) for one in watches] == runs
    assert not watches[1].handle_time(39 * NS_PER_S)


def test_of_attached_programs_their_samples_say_it():
    found = collector()
    watch = upkeep_now.ExperimentWatch(found, attached=True)

    def pass_samples(sent, received):
        transmit = SenderMetrics(haptic_sent=sent)
        receive = ReceiverMetrics(haptic_received=received)
        publish(found, "ground_gateway", gateway(transmit=transmit, receive=receive))

    pass_samples(0, 0)
    assert not watch.handle_time(20 * NS_PER_S)
    pass_samples(0, 500)
    assert watch.handle_time(21 * NS_PER_S) == "haptic samples pass"
    assert not watch.handle_time(31 * NS_PER_S)
    pass_samples(700, 500)
    assert watch.handle_time(32 * NS_PER_S) == "haptic samples pass"


def test_media_dropped_for_want_of_bandwidth_are_told_once_until_they_pass_again():
    found = collector()
    watch = upkeep_now.BandwidthWatch(found)

    def look(at_s, **drops):
        queue = {"video": SimpleNamespace(drops=drops)}
        publish(found, "ground_gateway", gateway(transmit=SenderMetrics(queue=queue)))
        return list(watch.handle_time(at_s * NS_PER_S))

    assert look(1, expired=0, signal_lost=7) == []
    assert look(2, expired=2, signal_lost=9) == ["uplink is short of bandwidth: video is dropped"]
    assert look(3, expired=3, signal_lost=9) == []
    assert set(watch.short_ns) == {("uplink", "video")}
    assert look(13, expired=3, signal_lost=30) == ["uplink: video has its bandwidth again"]
    assert not watch.short_ns
