"""What a display draws and keeps, and what the detectors at the operator report."""

from itertools import pairwise

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp, empty_picture
from pipelines.media import showing
from pipelines.media.process_display import _write
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import ClickRow, LightRow
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SETUP = BUILT_IN["spacejustin"]
VIDEO, VOICE = SETUP.uplink_video, SETUP.uplink_voice
STALE_MS = SETUP.stale_after_ns(VIDEO) // NS_PER_MS


class Display:
    """A display on virtual time, and (instant, age in the mark) of all that it has drawn."""

    def __init__(self):
        self.showing = showing.Showing(SETUP, [VIDEO, VOICE], Probe())
        self.drawn = []

    def show(self, stream, capture_ms, now_ms):
        self.run(now_ms - 1)
        stamp = CaptureStamp(capture_ms * NS_PER_MS, 0, "x", rtp_timestamp=1)
        self.showing.handle_shown(stream.name, stamp, now_ms * NS_PER_MS)
        self.draw(now_ms)

    def run(self, until_ms):
        while (due_ns := self.showing.poll_timeout()) is not None:
            if due_ns > until_ms * NS_PER_MS:
                return
            self.showing.handle_time(due_ns)
            self.draw(due_ns // NS_PER_MS)

    def draw(self, now_ms):
        while (drawing := self.showing.next_event()) is not None:
            assert drawing.stream == VIDEO.name
            age = drawing.stale_ns
            self.drawn.append((now_ms, None if age is None else age // NS_PER_MS))


@pytest.fixture
def display():
    return Display()


def test_fresh_pictures_are_drawn_once_stale_ones_with_their_age_and_sound_makes_none_fresh(
    display,
):
    for now_ms in range(100, 1000, 50):
        display.show(VIDEO, now_ms - 60, now_ms)
    assert display.drawn == [(now_ms, None) for now_ms in range(100, 1000, 50)]
    late = Display()
    late.show(VIDEO, 0, STALE_MS + 50)
    assert late.drawn == [(STALE_MS + 50, STALE_MS + 50)]
    display = Display()
    display.show(VIDEO, 0, 20)
    display.run(STALE_MS + 350)
    aged = [(STALE_MS + late, STALE_MS + late) for late in (0, 100, 200, 300)]
    assert display.drawn == [(20, None), *aged]
    display.show(VIDEO, STALE_MS + 300, STALE_MS + 360)
    assert display.drawn[-1] == (STALE_MS + 360, None)
    display = Display()
    display.show(VOICE, 0, 20)
    display.run(10_000)
    assert display.drawn == []
    display.show(VIDEO, 10_000, 10_020)
    display.show(VOICE, 10_000 + STALE_MS - 60, 10_000 + STALE_MS - 10)
    display.run(10_000 + STALE_MS + 1)
    assert display.drawn[-1] == (10_000 + STALE_MS, STALE_MS)


SPACEJUSTIN = topology_of(SETUP)
#: When the session began.
START_NS = 7 * NS_PER_S // 2


def schedule_at(session_ns):
    return showing.SnapshotSchedule(SPACEJUSTIN, started_ns=START_NS, now_ns=START_NS + session_ns)


def instants(end_s):
    """When snapshots are due in a session, each since its start."""
    schedule = schedule_at(0)
    while (due_ns := schedule.poll_timeout()) < START_NS + end_s * NS_PER_S:
        schedule.handle_time(due_ns)
        yield due_ns - START_NS


def test_snapshots_are_many_at_first_and_some_dozens_a_day():
    first, day = list(instants(20)), list(instants(86_400))
    assert first[0] == NS_PER_S
    assert len(first) >= 5 and len(day) <= 50
    assert len({due_ns // NS_PER_S for due_ns in day}) == len(day)
    # A restarted process continues the schedule.
    for before, after in pairwise(instants(600)):
        for session_ns in (before, after - 1):
            assert schedule_at(session_ns).poll_timeout() == START_NS + after


def test_displays_and_the_merge_are_kept_missed_ones_not_caught_up_and_a_failed_write_is_none(
    tmp_path,
):
    def taken(schedule, now_ns):
        schedule.handle_time(now_ns)
        return list(iter(schedule.next_event, None))

    schedule = schedule_at(0)
    assert taken(schedule, START_NS + NS_PER_S - 1) == []
    assert taken(schedule, START_NS + NS_PER_S) == [
        ("space-uplink_video-0001s", "displayed/uplink_video", False),
        ("ground-downlink_video-0001s", "displayed/downlink_video", False),
        ("ground-stereo-0001s", "camera/stereo", True),
    ]
    late_ns = START_NS + 60 * NS_PER_S
    assert len(taken(schedule, late_ns)) == 3
    assert schedule.poll_timeout() > late_ns
    assert taken(schedule, late_ns) == []
    picture = np.full((72, 64), 128, np.uint8)
    assert _write(tmp_path, "ground-stereo-0001s", picture, halves=True) == [True] * 3
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert _write(tmp_path / "missing", "space-0001s", picture, halves=False) == [False]


LATE_NS = 60 * NS_PER_MS


@pytest.mark.rule("5")
def test_a_light_has_the_capture_times_of_its_picture_and_of_the_one_before():
    probe = Probe()
    watching = showing.Watching(probe)
    for number in range(8):
        picture = empty_picture(320, 240)
        picture[:240], picture[240:] = 60, 128
        if number >= 4:
            picture[100:110, 150:160] = 220
        stamp = CaptureStamp(40 * number * NS_PER_MS, number, "uplink_video")
        watching.handle_picture("uplink_video", picture, stamp, stamp.capture_ns + LATE_NS)
    *instants_ns, strength = probe.series(LightRow, "uplink_video").values
    assert instants_ns == [160 * NS_PER_MS + LATE_NS, 160 * NS_PER_MS, 40 * NS_PER_MS]
    assert strength > 0


@pytest.mark.parametrize(("played", "at_ms"), [(960, 510), (936, 518)])
def test_a_click_has_the_capture_time_of_its_own_sample_also_in_a_shortened_voice(played, at_ms):
    """played: samples that are heard of each block of 960."""
    probe = Probe()
    watching = showing.Watching(probe)
    line = np.zeros(51 * played)
    k = np.arange(900) / 48_000
    begin = at_ms // 20 * played + round(at_ms % 20 / 1000 * 48_000 * played / 960)
    line[begin : begin + 900] = 9000 * np.exp(-k / 0.004) * np.sin(2 * np.pi * 2500 * k)
    for number in range(50):
        block = line[number * played : (number + 1) * played].astype(np.int16)
        stamp = CaptureStamp(20 * number * NS_PER_MS, number, "uplink_voice")
        now_ns = number * played * NS_PER_S // 48_000 + LATE_NS
        watching.handle_sound("uplink_voice", block, stamp, now_ns)
    instant_ns, capture_ns, slack_ns, _ = probe.series(ClickRow, "uplink_voice").values
    assert abs(capture_ns - at_ms * NS_PER_MS) < 0.25 * NS_PER_MS
    assert slack_ns == 0
    if played == 960:
        assert instant_ns - capture_ns == LATE_NS
