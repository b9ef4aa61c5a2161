"""The warnings of a session, and when there are none."""

from dataclasses import replace

import pytest
from told import gateway, message, processes

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.recording.recorder_metrics import RecordedChannel, RecorderMetrics
from pipelines.report.collector import Collector
from pipelines.report.event_log import EventLog
from pipelines.report.sections import recorder_warnings
from pipelines.report.warnings import (
    find_path_warnings,
    find_warnings,
    hand_warnings,
    loop_warnings,
    picture_warnings,
    restart_warning,
)
from pipelines.session.session_switch import NO_ROOM, SessionSwitch
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.link.clock_exchange import ClockExchange
from telepresence.link.peer_path import OpenPath


def loop(*, cycles=1000, left_out=0, late_ns=0, scheduler="other"):
    return loop_warnings(
        "robot", cycles=cycles, left_out=left_out, late_ns=late_ns, scheduler=scheduler
    )


def test_loops_restarts_open_paths_and_long_round_trips_are_warned_of():
    assert loop(cycles=990, left_out=10) == loop(late_ns=500_000) == loop(cycles=0) == []
    (warning,) = loop(cycles=880, left_out=120)
    assert (warning.what, warning.where) == ("cycles_left_out", "robot")
    assert "12.0 %" in warning.measured
    (warning,) = loop(late_ns=700_000)
    assert (warning.what, "0.7 ms" in warning.measured) == ("cycles_late", True)
    # Without real-time priority the fix is the permission.
    fixes = [loop(left_out=50, scheduler=one)[0].fix for one in ("other", "fifo")]
    assert ["doctor" in fix for fix in fixes] == [True, False]
    warning = restart_warning("stereo", 1, "ended by SIGKILL")
    assert warning.measured == "it was started again once: ended by SIGKILL"
    assert restart_warning("stereo", 2, "").measured == "it was started again 2 times"
    full = restart_warning("stereo", 1, f"ended by {NO_ROOM}")
    assert "/dev/shm" in full.fix and "report an error" not in full.fix
    setup = BUILT_IN["spacejustin"]
    collector = Collector(topology_of(setup, segments=(Segment.GROUND,)))
    path = OpenPath(setup.downlink, address=("192.0.2.1", 27000), now_ns=5)
    collector.handle_message("ground_gateway", message(path.report(NS_PER_S)), NS_PER_S)
    (warning,) = find_path_warnings(collector, Segment)
    assert (warning.what, warning.where) == ("not_protected", "ground_gateway")

    def warned(down_ms, up_ms, **changed):
        collector = Collector(topology_of(replace(BUILT_IN["taskboard"], **changed)))
        for way, late_ms in (("down", down_ms), ("up", up_ms)):
            if late_ms is not None:
                collector.haptics[way].latency.add(late_ms * 1_000_000)
        return [warning.measured for warning in hand_warnings(collector)]

    (measured,) = warned(252, 252)
    assert "504 ms" in measured
    assert warned(15, 15) == warned(252, None) == warned(252, 252, hand="auto") == []
    assert warned(252, 252, partner_arm="shared") == []


def test_a_coder_that_gave_up_its_priority_is_warned_of_and_told_once():
    collector = Collector(topology_of(BUILT_IN["taskboard"]))
    coder = collector.topology.media("uplink_video").sender
    restarts = dict.fromkeys(("robot", coder), 0)
    events = EventLog(collector)
    told = []
    for scheduler in ("fifo", "too_busy", "too_busy"):
        for name in restarts:
            busy = scheduler if name == coder else "fifo"
            collector.handle_message(name, message(scheduler=busy), 1)
        events.handle_look(
            processes(restarts), switch=SessionSwitch(), started_ns=0, now_ns=len(told)
        )
        told.append([event.text for event in events.events])
    words = "takes more than half a core: it goes on without real-time priority"
    assert told == [[]] + 2 * [[f"{coder} {words}"]]
    (warning,) = find_warnings(collector, seconds=1.0, restarts=restarts)
    assert (warning.what, warning.where) == ("priority_given_up", coder)
    assert "smaller pictures" in warning.fix


@pytest.mark.parametrize(
    ("found", "counts"),
    [
        ([], {}),
        ([], {"displayed": 240}),
        (["few_shown"], {"displayed": 239}),
        (["few_captured"], {"captured": 239, "displayed": 20}),
        # Pictures refused by the cap need not be shown.
        ([], {"refused": 150, "displayed": 120}),
        (["few_shown"], {"refused": 150, "displayed": 119}),
        # An input without pictures is a silence, no warning.
        ([], {"captured": 0, "displayed": 0}),
    ],
)
def test_few_pictures_are_a_warning(found, counts):
    counts = {"captured": 300, "refused": 0, "displayed": 300} | counts
    warnings = picture_warnings("uplink_video", fps=30, seconds=10.0, **counts)
    assert [warning.what for warning in warnings] == found


@pytest.mark.parametrize(
    ("channel", "fix"),
    [
        (RecordedChannel(kept=9, missed=3), ["processors"]),
        (RecordedChannel(kept=9, dropped=3), ["disk"]),
        (RecordedChannel(kept=9, dropped=3, missed=1), ["disk", "processors"]),
    ],
)
def test_what_a_recording_lacks_is_blamed_on_what_was_too_slow(channel, fix):
    collector = Collector(topology_of(BUILT_IN["taskboard"], recorder=True))
    metrics = RecorderMetrics(parts=1, channels={"/haptic/up/sent": channel})
    collector.handle_message("recorder", message(metrics), 1)
    (warning,) = recorder_warnings(collector)
    found = [word for word in ("disk", "processors") if word in warning.fix]
    assert found == fix and warning.measured.startswith(f"{channel.lost} messages")


@pytest.mark.parametrize(
    ("segment", "offset_ns", "error_ms", "hand", "path_warned", "hand_warned"),
    [
        (Segment.GROUND, None, 0, "auto", ["clock_unknown"], []),
        (Segment.GROUND, 5, 0, "auto", [], []),
        (Segment.SPACE, 5, 251, "direct", [], ["hand_direct"]),
        (Segment.SPACE, 5, 251, "auto", [], []),
        (Segment.SPACE, 5, 20, "direct", [], []),
        # The hand is at the other end.
        (Segment.GROUND, 5, 251, "direct", [], []),
    ],
)
def test_an_unknown_clock_and_a_direct_hand_over_a_long_way_are_warned_of(
    segment, offset_ns, error_ms, hand, path_warned, hand_warned
):
    setup = replace(BUILT_IN["spacejustin"], hand=hand)
    collector = Collector(topology_of(setup, segments=(segment,)))
    clock = ClockExchange(version=2, master=True, boot_id=1, told_offset_ns=0, now_ns=0).report(0)
    error_ns = None if offset_ns is None else error_ms * NS_PER_MS
    clock = replace(clock, offset_ns=offset_ns, error_ns=error_ns, messages_received=9)
    metrics = message(replace(gateway(), clock=clock))
    collector.handle_message(f"{segment.value}_gateway", metrics, NS_PER_S)
    assert [warning.what for warning in find_path_warnings(collector, Segment)] == path_warned
    assert [warning.what for warning in hand_warnings(collector)] == hand_warned
