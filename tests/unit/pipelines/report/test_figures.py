"""The figures of the pages are those of the report, and what is true now."""

import pytest
from told import message, processes

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.streams.staleness import State
from kontur_av.streams.video_receiver import VideoReceiverCounts
from pipelines.media.media_metrics import DisplayMetrics, SelectorMetrics
from pipelines.report.collector import Collector
from pipelines.report.figures import figures_of
from pipelines.report.model import to_builtins
from pipelines.report.session_report import build_report
from pipelines.report.upkeep_now import UpkeepNow
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.session_metrics import OutRow, SampleReceivedRow, SampleSentRow
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.haptic_metrics import SamplesReceived, SamplesSent

SETUP = BUILT_IN["spacejustin"]
TOPOLOGY = topology_of(SETUP, pages=True)
NAMES = [row.name for row in TOPOLOGY.processes]


@pytest.fixture
def collector():
    """A session of two seconds: a picture's packets, samples of the hand, what is shown."""
    collector = Collector(TOPOLOGY)
    out = [OutRow(k * 10 * NS_PER_MS, 100, 85_000) for k in range(200)]
    sent = [SampleSentRow(k, k * NS_PER_MS) for k in range(1000, 2000)]
    felt = [SampleReceivedRow(k, (k + 11) * NS_PER_MS) for k in range(1000, 2000)]
    now_ns = 2 * NS_PER_S
    for process, rows, counters in (
        ("uplink_video_send", out, ()),
        ("robot", sent, (SamplesSent(sent=1000),)),
        ("joystick", felt, (SamplesReceived(received=1000, lost=3),)),
        (
            "uplink_video_receive",
            (),
            (VideoReceiverCounts(rtp=ReceiverCounts(rtp_packets=197, rtp_lost=3)),),
        ),
        ("selector", (), (SelectorMetrics(selected="stereo"),)),
    ):
        collector.handle_message(process, message(*counters, rows=rows), now_ns)
    shown = DisplayMetrics(frames_displayed=58, age_ns=45 * NS_PER_MS, state=State.FRESH)
    collector.handle_message("space_display", message(shown, stream="uplink_video"), now_ns)
    return collector


def at(report, key):
    """What the report has under a key like `uplink_video.latency_ms.p99.9`; None for nothing."""
    section = report["streams"] if key.partition(".")[0] in report["streams"] else report
    while key:
        if not isinstance(section, dict):
            return None
        # A key of the report may have a dot in it: p99.9.
        name = key if key in section else key.partition(".")[0]
        section, key = section.get(name), key[len(name) + 1 :]
    return section


def figures(collector, at_s=2.0):
    """The report of an instant, and its figures."""
    now_ns = round(at_s * NS_PER_S)
    report = build_report(collector, seconds=at_s, processes=processes(NAMES, 0.5), now_ns=now_ns)
    tables = to_builtins(report)
    upkeep = UpkeepNow(collector)
    return tables, figures_of(tables, collector, upkeep, pass_s=at_s, now_ns=now_ns)


def test_every_figure_is_that_of_the_report_and_what_is_true_now_is_beside_it(collector):
    report, found = figures(collector)
    own = {"age_ms", "least", "most"}
    # The report has what TM/TC counted among the counts of its processes.
    shared = {
        key: value
        for key, value in found.items()
        if key.rpartition(".")[2] not in own and not key.startswith("tmtc.")
    }
    assert len(shared) > 100
    for key, value in shared.items():
        # Percentiles of nothing have no value on a page.
        assert value is None or value == at(report, key), key
    assert all(not isinstance(value, list | dict) for value in found.values())
    assert (found["tmtc.space.k2aci_arrived"], found["uplink_video.rtp_lost"]) == (0, 3)
    assert found["haptic.up.latency_ms.p50"] == pytest.approx(11, rel=0.01)
    assert found["processes.selector.selected"] == "stereo"
    assert found["uplink_voice.latency_ms.p50"] is None
    assert found["uplink_voice.latency_ms.count"] == 0
    _, later = figures(collector, 5.0)
    names = ("age_ms", "state", "rate_bps")
    assert [found[f"uplink_video.{name}"] for name in names] == [45.0, "fresh", 80_000]
    assert [later[f"uplink_video.{name}"] for name in names] == [2045.0, "stale", 0]
    assert (found["uplink_voice.age_ms"], found["uplink_voice.state"]) == (None, "nothing")
    assert found["haptic.up.rate_bps"] == 96_000


def test_ground_control_is_told_which_page_holds_the_handle(collector):
    assert figures(collector)[1]["hand.holder"] is None
    holding = message(PageMetrics(watching=1, holder=3))
    collector.handle_message("page_space", holding, 2 * NS_PER_S)
    assert figures(collector)[1]["hand.holder"] == 3
