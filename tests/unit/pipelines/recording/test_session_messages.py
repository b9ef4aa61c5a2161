"""What a run of a task was can be found again in its recording."""

from math import hypot

import pytest

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from pipelines.recording.channels import sources_of
from pipelines.recording.recorded_messages import (
    RecordedExperiment,
    RecordedLeds,
    RecordedPanel,
    unpack,
)
from pipelines.recording.session_messages import Instants, SessionMessages
from pipelines.session.mission_messages import ExperimentShown, LedsShown, PanelShown, RunShown
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.tasks.definitions import Pattern
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.tasks.positions import spot_at
from telepresence.tasks.scores import ScoreKeeper
from telepresence.tasks.task_files import built_in_tasks
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

TICK_NS = 100 * NS_PER_MS
PURSUE = built_in_tasks().elemops["pursueSpot"]
AIM = {"phase": "running", "task": "pursuit", "run": 3, "panel": "running", "tasks": ()}


@pytest.fixture
def told():
    """told(channel, kind, sample, tick): what the recording has of a sample."""
    session = topology_of(BUILT_IN["taskboard"], tasks=True)
    sources = {source.name: source for source in sources_of(session)}
    numbers = []
    messages = SessionMessages(0, built_in_dictionary())

    def publish(channel, kind, sample, tick):
        now_ns = tick * TICK_NS
        stamp, at = CaptureStamp(now_ns, tick, channel), Instants(now_ns, now_ns)
        found = messages.of_sample(sources[channel], sources[channel].topic.pack(sample), stamp, at)
        # Those of a channel are counted without a gap.
        numbers.extend(one.sequence for one in found)
        assert numbers == [*range(1, len(numbers) + 1)]
        return [unpack(kind, one.data) for one in found]

    return publish


def test_the_error_of_a_pursuit_is_computed_again(told):
    keeper, recorded, tips = ScoreKeeper(), [], {}
    for tick in range(200):
        picture = PanelPicture(Pattern.SPOT, spot_m=spot_at(PURSUE.path, tick / 80))
        tips[tick] = 0.002 * (tick % 20), -0.0005 * tick
        keeper.handle_robot(*tips[tick], 0.0, PURSUE, picture)
        recorded += told("leds", RecordedLeds, LedsShown.of(picture), tick)
    spots = {one.session_ns // TICK_NS: (one.spot_x_m, one.spot_y_m) for one in recorded}
    errors = [hypot(x - spots[tick][0], y - spots[tick][1]) for tick, (x, y) in tips.items()]
    assert sum(errors) / len(errors) == pytest.approx(keeper.report().error_mean, abs=1e-6)


def test_steps_and_result_of_a_run_are_told_at_each_change(told):
    begun = ExperimentShown(**AIM, elemop="pursueSpot")
    ended = ExperimentShown(
        **{**AIM, "phase": "idle", "task": "", "run": 0},
        elemop="",
        runs=(RunShown("pursuit", 3, "aborted", "the joystick is halted", 4.5),),
    )
    found = [
        told("experiment", RecordedExperiment, sample, tick)
        for tick, sample in enumerate((begun, begun, ended))
    ]
    assert [len(one) for one in found] == [1, 0, 1]
    (first,), (last,) = found[0], found[2]
    assert (first.elemop, first.run, first.ended_run) == ("pursueSpot", 3, 0)
    assert (last.ended_run, last.result, last.reason) == (3, "aborted", "the joystick is halted")


def test_the_steps_of_the_panel_are_told_and_its_handle_is_not(told):
    panel = {"task": "aiming", "run": 2, "text": "", "start_m": (0.0, 0.0), "held_s": 0.0}
    shown = [
        PanelShown(mode="hold", words="Hold", handle_m=(0.001 * tick, 0.0), **panel)
        for tick in range(3)
    ]
    shown.append(PanelShown(mode="running", words="Go", goal="reach", step=1, steps=4, **panel))
    found = [told("panel", RecordedPanel, sample, tick) for tick, sample in enumerate(shown)]
    assert [len(one) for one in found] == [1, 0, 0, 1]
    assert (found[0][0].mode, found[3][0].goal, found[3][0].steps) == ("hold", "reach", 4)
