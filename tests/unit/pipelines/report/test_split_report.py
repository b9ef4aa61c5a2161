"""One end of a session alone: its report has what it knows, and blames nobody for the rest."""

from dataclasses import replace

import pytest
from rich.console import Console
from told import gateway, message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.streams.paced_sender import SenderCounts
from pipelines.media.figures import CaptureFigures, DisplayFigures
from pipelines.report.collector import Collector
from pipelines.report.event_log import EventLog
from pipelines.report.model import SessionReport, from_json, to_json
from pipelines.report.session_report import build_report
from pipelines.report.summary import first_line, streams_table
from pipelines.report.warnings import find_path_warnings, hand_warnings
from pipelines.session.figures import ShownRow
from pipelines.session.session_switch import SessionSwitch
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Segment
from pipelines.table import topology_of
from telepresence.haptics.figures import SamplesSent
from telepresence.link.clock_exchange import ClockExchange
from telepresence.link.peer_path import OpenPath

SETUP = BUILT_IN["spacejustin"]
SECONDS = 60


def alone(segment):
    """The collector of one end whose processes have reported for a minute, and its report."""
    topology = topology_of(SETUP, segments=(segment,))
    collector = Collector(topology)
    # Of the gateways nothing is known, so nothing excuses what is missing.
    now_ns, figures = SECONDS * NS_PER_S, {}
    for row in topology.media_streams:
        if topology.runs(row.sender):
            figures[row.sender] = [SenderCounts(frames_captured=1800, frames_sent=1800)]
            for name in row.inputs:
                figures[topology.input(name).process] = [CaptureFigures(captured=1800)]
    for row in topology.haptics:
        if topology.runs(row.sender):
            figures[row.sender] = [SamplesSent(sent=60_000)]
    for process, told in figures.items():
        assert topology.runs(process)
        collector.handle_message(process, message(*told), now_ns)
    return collector


def report_of(collector):
    names = [row.name for row in collector.topology.processes_here]
    report = build_report(
        collector,
        seconds=SECONDS,
        cpu_s=dict.fromkeys(names, 1.0),
        restarts=dict.fromkeys(names, 0),
        launcher_cpu_s=0.0,
    )
    return from_json(to_json(report), SessionReport)


@pytest.mark.parametrize("segment", Segment, ids=lambda segment: segment.value)
def test_it_names_its_end_and_no_failure_of_the_other(segment):
    report = report_of(alone(segment))
    assert report.end == segment.value
    assert list(report.gateways) == [segment.value]
    assert report.failures == []
    assert report.warnings == []
    sent = {name for name, stream in report.streams.items() if stream.side == "sender"}
    prefix = "uplink" if segment is Segment.GROUND else "downlink"
    assert sent == {name for name in report.streams if name.startswith(prefix)}
    assert len(sent) == 2
    assert {stream.side for stream in report.streams.values()} == {"sender", "receiver"}
    assert report.sync is None
    assert f"the {segment.value} end alone" in first_line(report, 118)


def test_latencies_between_two_clocks_are_left_out_of_report_and_table():
    collector = alone(Segment.SPACE)
    # The other machine's clock is an hour ahead, so what is shown seems to come from the future.
    rows = [ShownRow(n, 3600 * NS_PER_S, n * 33 * NS_PER_MS) for n in range(1, 100)]
    told = message(DisplayFigures(frames_displayed=99), rows=rows, stream="uplink_video")
    collector.handle_message("space_display", told, SECONDS * NS_PER_S)
    report = report_of(collector)
    assert report.failures == []
    video = report.streams["uplink_video"]
    assert (video.display.frames_displayed, video.latency_ms.count) == (99, 0)
    console = Console(width=118)
    with console.capture() as capture:
        console.print(streams_table(report, 118))
    (line,) = [line for line in capture.get().splitlines() if " uplink_video " in line]
    cells = [cell.strip() for cell in line.strip("│").split("│")]
    # Its rates are known to the other end, what is shown to this one.
    assert cells[2:5] == ["–", "–", "–"]
    assert cells[5] == f"{99 / SECONDS:.1f}"
    assert cells[7:] == ["–", "–", "–", "–"]


def test_a_clock_that_never_was_known_is_warned_of():
    for offset_ns, warned in ((None, ["clock_unknown"]), (5, [])):
        collector = alone(Segment.GROUND)
        clock = ClockExchange(version=2, master=True, life=1, told_offset_ns=0, now_ns=0).report(0)
        clock = replace(clock, offset_ns=offset_ns, error_ns=offset_ns, messages_received=9)
        figures = replace(gateway(), clock=clock)
        collector.handle_message("ground_gateway", message(figures), NS_PER_S)
        assert [one.what for one in find_path_warnings(collector, Segment)] == warned


def test_a_direct_hand_over_a_long_way_is_warned_of_at_the_hands_end():
    for segment, error_ms, hand, warned in (
        (Segment.SPACE, 251, "direct", ["hand_direct"]),
        (Segment.SPACE, 251, "auto", []),
        (Segment.SPACE, 20, "direct", []),
        (Segment.GROUND, 251, "direct", []),
    ):
        collector = alone(segment)
        collector.setup = replace(collector.setup, hand=hand)
        clock = ClockExchange(version=2, master=True, life=1, told_offset_ns=0, now_ns=0).report(0)
        clock = replace(clock, offset_ns=5, error_ns=error_ms * NS_PER_MS)
        told = message(replace(gateway(), clock=clock))
        collector.handle_message(f"{segment.value}_gateway", told, NS_PER_S)
        assert [one.what for one in hand_warnings(collector)] == warned


def test_a_path_without_protection_is_warned_of_and_stands_in_the_event_log():
    collector = alone(Segment.GROUND)
    path = OpenPath(SETUP.downlink, address=("192.0.2.1", 27000), now_ns=5)
    told = message(path.report(NS_PER_S))
    collector.handle_message("ground_gateway", told, NS_PER_S)
    (warning,) = find_path_warnings(collector, Segment)
    assert (warning.what, warning.where) == ("not_protected", "ground_gateway")
    assert report_of(collector).gateways["ground"].peer.protected is False
    log = EventLog(collector)
    for now_ns in (NS_PER_S, 2 * NS_PER_S):
        log.handle_look((), switch=SessionSwitch(), started_ns=0, now_ns=now_ns)
        # Each event is told once.
        told = [event.text for event in log.events if event.what == "link"]
        assert told == ["ground: the path is NOT PROTECTED"]
