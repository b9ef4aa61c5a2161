"""The report that is built from the figures of a collector."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from told import gateway, message, processes

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.video_receiver import VideoReceiverCounts
from pipelines.link.link_metrics import SocketMetrics
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics, SelectorMetrics
from pipelines.report.collector import Collector
from pipelines.report.model import SessionReport, from_json, to_json
from pipelines.report.session_report import build_report, failures
from pipelines.report.silence import never_met, signal_ns, silences
from pipelines.report.summary import first_line
from pipelines.session.session_metrics import OutRow, ProbeMetrics, ShownRow
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.haptic_metrics import SamplesReceived, SamplesSent
from telepresence.link.gateway import Gateway
from telepresence.link.link_metrics import ContactMetrics, ReceiverMetrics

SETUP = BUILT_IN["taskboard"]
PARTS = ("uplink_video_send", "uplink_video_receive", "space_display", "robot", "joystick")


def told(octets_a_packet=300, displayed=30, received=1000, setup=SETUP):
    """A collector after a second of 30 packets."""
    collector = Collector(topology_of(setup))
    cap_bps = setup.uplink_video.cap_bps
    out = [OutRow(k * 33 * NS_PER_MS, octets_a_packet, cap_bps) for k in range(30)]
    totals = {
        "uplink_video_send": SenderCounts(frames_captured=31, frames_encoded=30, frames_sent=30),
        "uplink_video_receive": VideoReceiverCounts(rtp=ReceiverCounts(rtp_packets=30, garbage=2)),
        "robot": SamplesReceived(received=received),
        "joystick": SamplesReceived(received=received, lost=1),
    }
    for process, counters in totals.items():
        rows = out if process == "uplink_video_send" else ()
        sent = [SamplesSent(sent=1000)] if process in ("robot", "joystick") else []
        collector.handle_message(process, message(counters, *sent, rows=rows), NS_PER_S)
    show(collector, NS_PER_S, displayed)
    return collector


def show(collector, now_ns, displayed, *rows):
    counters = DisplayMetrics(frames_displayed=displayed)
    told = message(counters, rows=rows, stream="uplink_video")
    collector.handle_message("space_display", told, now_ns)


def report_of(collector, seconds=5.0, parts=PARTS, restarts=2, **others):
    return build_report(
        collector,
        seconds=seconds,
        processes=processes(parts, 0.5, robot={"cpu_s": 0.5, "restarts": restarts}),
        launcher_cpu_s=1.0,
        **others,
    )


def test_the_report_contains_the_counts():
    report = from_json(to_json(report_of(told())), SessionReport)
    assert report == report_of(told())
    stream = report.streams["uplink_video"]
    assert stream.payload_bps_max_1s == 30 * 300 * 8
    assert (stream.sender.frames_captured, stream.sender.frames_sent) == (31, 30)
    assert (report.haptic["up"].receiver.lost, report.haptic["down"].receiver.lost) == (1, 0)
    assert report.processes["robot"].restarts == 2
    assert report.processes["uplink_video_receive"].counts["garbage"] == 2
    assert "garbage" not in report.processes["space_display"].counts
    assert report.cpu.total_s == 0.5 * len(PARTS) + 1.0
    assert report.failures == []


@pytest.mark.parametrize(
    ("metrics", "seconds", "found"),
    [
        ({"octets_a_packet": 376}, 5.0, ["uplink_video: 90240 bit/s"]),
        ({"octets_a_packet": 375}, 5.0, []),
        ({"displayed": 0}, 5.0, ["uplink_video: nothing was displayed"]),
        # The session is too short for a verdict.
        ({"displayed": 0}, 1.0, []),
        ({"received": 0}, 5.0, [f"haptic_{way}: no sample was received" for way in ("up", "down")]),
    ],
)
def test_a_broken_cap_and_what_never_came_are_failures(metrics, seconds, found):
    lines = failures(told(**metrics), seconds)
    assert [line[: len(start)] for line, start in zip(lines, found, strict=True)] == found


def test_values_that_the_report_lacks_and_latencies_below_0_are_failures():
    collector = told()
    lost = ProbeMetrics(probe_values_dropped=60)
    collector.handle_message("space_display", message(lost), NS_PER_S)
    show(collector, NS_PER_S, 30, ShownRow(1, 2 * NS_PER_S, NS_PER_S))
    assert sorted(failures(collector, 5.0)) == [
        "space_display: 60 values for this report were lost",
        "uplink_video: 1 latencies below 0 (capture_to_displayed)",
    ]


def hearing(collector, since_ns, *, signal=True, lost_ns=None):
    """The same collector; its gateway in space has heard the ground from `since_ns` to 9 s."""
    contacts = [
        ContactMetrics(acquired_ns=0, connected_ns=None, lost_ns=5),
        ContactMetrics(acquired_ns=since_ns - 1000, connected_ns=None, lost_ns=lost_ns),
    ]
    signal = signal and lost_ns is None
    supervision = SimpleNamespace(signal=signal, begun_ns=1000, contacts=contacts)
    gauges = gateway(supervision=supervision, receive=ReceiverMetrics())
    collector.handle_message("space_gateway", message(gauges), 9 * NS_PER_S)
    return collector


def test_a_stream_without_a_radio_signal_is_no_failure():
    unseen = told(displayed=0, received=0)
    never = "uplink_video: nothing was displayed: left and right gave nothing: look at its source"
    in_space = [f"{never}, or take another one", "haptic_up: no sample was received"]
    down = ["haptic_down: no sample was received"]
    assert failures(hearing(unseen, 2 * NS_PER_S), 9.0) == in_space + down
    assert failures(hearing(unseen, 8 * NS_PER_S), 9.0) == down
    assert failures(hearing(unseen, 2 * NS_PER_S, signal=False), 9.0) == down
    # A signal that has ended was long enough to show a picture.
    assert failures(hearing(unseen, 2 * NS_PER_S, lost_ns=7 * NS_PER_S), 9.0) == in_space[:1] + down


def test_a_session_that_ended_at_once_has_a_report_and_an_input_is_silent_since_its_new_start():
    empty = Collector(topology_of(SETUP))
    report = from_json(to_json(report_of(empty, seconds=0.0)), SessionReport)
    assert report.streams["uplink_video"].payload_bps_mean == 0
    assert report.link["uplink"].sender.frames == 0
    collector = told()
    collector.handle_message("camera_left", message(CaptureMetrics(captured_ns=NS_PER_S)), NS_PER_S)
    collector.handle_resumed(60 * NS_PER_S)
    silent = [str(silence) for silence in silences(collector, 61 * NS_PER_S)]
    assert silent == []
    silent = [str(silence) for silence in silences(collector, 63 * NS_PER_S)]
    assert silent == ["camera_left: no picture for 3 s"]


def test_a_stop_on_request_is_named_and_is_in_no_mean():
    # 30 packets of 300 octets came in the first second, and none later.
    rate_bps = 30 * 300 * 8 / 4
    whole = report_of(told(), seconds=4.0)
    assert whole.streams["uplink_video"].payload_bps_mean == rate_bps
    assert '"stopped_s"' not in to_json(whole)
    report = report_of(told(), seconds=6.0, stopped_s=[(1.0, 2.5), (3.0, 3.5)])
    assert (report.seconds, report.running_s) == (6.0, 4.0)
    assert report.stopped_s == [(1.0, 2.5), (3.0, 3.5)]
    assert report.streams["uplink_video"].payload_bps_mean == rate_bps


def test_every_count_of_a_process_is_reported():
    collector = told()
    first = CaptureMetrics(captured=100, source_faults=2), VideoReceiverCounts(jitter_ns=7)
    sockets = SocketMetrics(unknown_senders={"radio": 3, "haptic": 0})
    collector.handle_message("robot", message(*first, sockets, scheduler="fifo"), NS_PER_S)
    collector.process("robot").handle_end()
    collector.handle_message("robot", message(CaptureMetrics(captured=1)), NS_PER_S)
    entry = report_of(collector).processes["robot"]
    found = [entry.counts[name] for name in ("captured", "source_faults", "unknown_senders_radio")]
    assert found == [101, 2, 3]
    assert {"strangers_haptic", "left_out"}.isdisjoint(entry.counts), "none, and no such counter"
    assert (entry.newest["jitter_ns"], entry.scheduler) == (7, "fifo")
    display = report_of(collector, 5.0).processes["space_display"]
    assert display.counts["uplink_video.frames_displayed"] == 30

    # Those of a killed gateway are added, also of packets of which a part was sent.
    flows, now_ns = collector.topology.flows, 5 * NS_PER_S
    ways = {"transmit": SETUP.uplink, "transmit_flows": flows(Direction.UPLINK)}
    ways |= {"receive": SETUP.downlink, "receive_flows": flows(Direction.DOWNLINK)}
    for packets in (3, 4):
        core = Gateway(**ways, master=True, boot_id=packets, now_ns=now_ns)
        for k in range(packets):
            # RTP that gets no context, and after it none at all.
            core.handle_datagram("uplink_video", bytes([0x80, 0x60, 0, k, *bytes(20)]), now_ns)
        for _ in range(2):
            core.handle_slot(now_ns)
        collector.handle_message("ground_gateway", message(core.report(now_ns + NS_PER_S)), now_ns)
        collector.process("ground_gateway").handle_end()
    sender = report_of(collector).link["uplink"].sender
    queue = sender.queue["video"]
    assert queue.accepted == sum(queue.drops.values()) == 7
    assert (queue.max_packets, sender.headers["uplink_video"]["packets"]) == (4, 2)


def run_on(collector, *, shown_s, captured_s, seconds=8, camera="left"):
    """The reports, twice a second, of a camera and of the display, until these instants."""
    for half in range(1, 2 * seconds + 1):
        now_ns = half * NS_PER_S // 2
        captured_ns = min(now_ns, round(captured_s * NS_PER_S))
        gauges = CaptureMetrics(captured_ns=captured_ns)
        collector.handle_message(f"camera_{camera}", message(gauges), now_ns)
        if now_ns <= shown_s * NS_PER_S:
            show(collector, now_ns, half, ShownRow(half, now_ns - NS_PER_MS, now_ns))
    return collector


def test_a_stream_that_stopped_is_a_failure_unless_its_input_did():
    (failure,) = failures(run_on(told(), shown_s=3, captured_s=8), 8.0)
    assert failure.startswith("uplink_video: nothing was displayed in the last 5.0 s")
    # A short gap is no failure yet.
    assert failures(run_on(told(), shown_s=6.5, captured_s=8), 8.0) == []
    # Pictures on a slow radio are not missed yet.
    slow = replace(SETUP, radio_delay_ms=4000)
    assert failures(run_on(told(setup=slow), shown_s=3, captured_s=8), 8.0) == []
    collector = run_on(told(), shown_s=3, captured_s=3)
    assert failures(collector, 8.0) == []
    # It is no failure if the input has just returned, either.
    gauges = CaptureMetrics(captured_ns=8 * NS_PER_S)
    collector.handle_message("camera_left", message(gauges), 8 * NS_PER_S)
    assert failures(collector, 8.0) == []


def test_a_stream_is_judged_by_the_camera_that_is_selected():
    collector = Collector(topology_of(SPLIT))

    def judged(camera, at_s):
        gauges = SelectorMetrics(selected=camera)
        collector.handle_message("selector", message(gauges), round(at_s * NS_PER_S))
        return [failure for failure in failures(collector, 8.0) if "uplink_video" in failure]

    judged("head", 3)
    run_on(collector, shown_s=3, captured_s=8, camera="static")
    assert judged("head", 3) == [], "the selected camera has no pictures"
    assert judged("static", 7.5) == [], "half a second after the switch no picture is due yet"
    judged("head", 3)
    (found,) = judged("static", 5)
    assert "in the last 3.0 s" in found


def test_what_no_page_gives_is_a_failure_only_if_no_picture_at_all_is_shown():
    def without_pictures(setup):
        collector = told(displayed=0, setup=setup)
        for name in setup.camera_inputs:
            for half in range(1, 21):
                process = collector.topology.input(name).process
                collector.handle_message(process, message(CaptureMetrics()), half * NS_PER_S // 2)
        return collector

    cameras = dict.fromkeys(SETUP.camera_inputs, "page")
    collector = without_pictures(replace(SETUP, sources=cameras))
    never = "uplink_video: nothing was displayed: left and right gave nothing"
    (found,) = failures(collector, 10.0)
    assert found.startswith(f"{never} (no page gives it): look at its source")
    assert str(silences(collector)[0]) == "camera_left: no picture for 10 s (no page gives it)"
    assert all(silence.waits for silence in silences(collector))
    (found,) = failures(without_pictures(SETUP), 10.0)
    assert found.startswith(f"{never}: look at its source")
    # From what a page gave, something must be shown.
    given = message(CaptureMetrics(captured_ns=9 * NS_PER_S))
    collector.handle_message("camera_left", given, 10 * NS_PER_S)
    (found,) = failures(collector, 10.0)
    assert found.endswith(
        "what arrived was not shown: look at uplink_video_receive and space_display"
    )
    both = BUILT_IN["spacejustin"]
    shown = without_pictures(replace(both, sources=dict.fromkeys(both.camera_inputs, "page")))
    told_down = message(DisplayMetrics(frames_displayed=9), stream="downlink_video")
    shown.handle_message("ground_display", told_down, 10 * NS_PER_S)
    assert not any(line.startswith("uplink_video") for line in failures(shown, 10.0))


def test_an_input_that_stopped_or_never_began_is_named():
    collector = run_on(told(), shown_s=3, captured_s=3)
    # The camera was restarted, and has captured nothing since.
    fault = CaptureMetrics(source_fault="the writer has gone")
    collector.handle_message("camera_left", message(fault), 8 * NS_PER_S)
    (silence,) = silences(collector)
    assert str(silence) == "camera_left: no picture for 5 s (the writer has gone)"
    assert silences(collector, 10 * NS_PER_S)[0].silent_ns == 7 * NS_PER_S
    report = report_of(collector, 8.0, ["camera_left"])
    assert report.processes["camera_left"].silent_s == 5.0
    assert not any("camera_left" in failure for failure in report.failures)
    # A fault of a file, or of a user's class, begins with what names it.
    own = CaptureMetrics(source_fault=f"{collector.setup.source('left')}: E17: lens cap")
    collector.handle_message("camera_left", message(own), 8 * NS_PER_S)
    assert str(silences(collector)[0]) in report_of(collector, 8.0, ["camera_left"]).failures
    # While pictures come there is no silence.
    assert silences(run_on(told(), shown_s=8, captured_s=8)) == []
    never = told()
    for now_ns in (NS_PER_S, 4 * NS_PER_S):
        never.handle_message("camera_left", message(CaptureMetrics()), now_ns)
    assert [str(one) for one in silences(never)] == ["camera_left: no picture for 3 s"]


def gateway_of(contacts, told_s, radio="cable"):
    """A collector whose gateways report these contacts at this time of the session."""
    collector = Collector(topology_of(replace(SETUP, radio=radio)))
    supervision = SimpleNamespace(
        signal=True, begun_ns=0, contacts=contacts, in_state_ns={}, why="no signal"
    )
    receive = ReceiverMetrics(frames_received=1000)
    for name in ("ground_gateway", "space_gateway"):
        link = gateway(receive=receive, supervision=supervision)
        collector.handle_message(name, message(link), round(told_s * NS_PER_S))
    return collector


def contact(acquired_s=0.0, *, connected=True):
    ns = round(acquired_s * NS_PER_S)
    return ContactMetrics(acquired_ns=ns, connected_ns=ns if connected else None, lost_ns=None)


def test_a_session_that_never_met_its_peer_fails_and_a_silence_after_the_pass_is_no_failure():
    for contacts in ([], [contact(connected=False)]):
        lines = never_met(gateway_of(contacts, 14.0), 14.0)
        assert [line.split(":")[0] for line in lines] == ["ground", "space"]
        assert "never met the other end in 14 s: no signal; look at" in lines[0]
        over = gateway_of(contacts, 14.0)
        over.handle_exit("ground_gateway", "")
        assert never_met(over, 14.0) == lines
    assert never_met(gateway_of([contact()], 14.0), 14.0) == []
    # It may not have had the time, or the radio no contact.
    assert never_met(gateway_of([], 5.0), 5.0) == []
    assert never_met(gateway_of([], 20.0, "iss-pass"), 20.0) == []
    assert len(never_met(gateway_of([], 500.0, "iss-pass"), 500.0)) == 2
    windows = replace(SETUP, radio="iss-pass").radio_profile.contact_windows()
    for at_s, expected_s in ((windows.usable_to_s - 5,) * 2, (windows.usable_to_s + 5, 0)):
        collector = gateway_of([contact()], at_s, "iss-pass")
        for _ in range(2):
            assert signal_ns("space", collector) == round(expected_s * NS_PER_S)
            # The same once the session is over, and the gateway has ended.
            collector.handle_exit("space_gateway", "")


SPLIT, SECONDS = BUILT_IN["spacejustin"], 60


def alone(segment):
    """The collector of one end whose processes have reported for a minute."""
    topology = topology_of(SPLIT, segments=(segment,))
    collector = Collector(topology)
    # Of the gateways nothing is known, so nothing excuses what is missing.
    metrics = {}
    for row in topology.media_streams:
        if topology.runs(row.sender):
            metrics[row.sender] = SenderCounts(frames_captured=1800, frames_sent=1800)
            for name in row.inputs:
                metrics[topology.input(name).process] = CaptureMetrics(captured=1800)
    for row in topology.haptics:
        if topology.runs(row.sender):
            metrics[row.sender] = SamplesSent(sent=60_000)
    for process, counts in metrics.items():
        assert topology.runs(process)
        collector.handle_message(process, message(counts), SECONDS * NS_PER_S)
    return collector


def report_alone(collector):
    names = [row.name for row in collector.topology.processes_here]
    return report_of(collector, SECONDS, names, restarts=0)


@pytest.mark.parametrize("segment", Segment, ids=lambda segment: segment.value)
def test_it_names_its_end_and_no_failure_of_the_other(segment):
    report = report_alone(alone(segment))
    assert [report.end] == list(report.gateways) == [segment.value]
    assert report.failures == report.warnings == []
    sent = {name for name, stream in report.streams.items() if stream.side == "sender"}
    prefix = "uplink" if segment is Segment.GROUND else "downlink"
    assert sent == {name for name in report.streams if name.startswith(prefix)}
    assert {stream.side for stream in report.streams.values()} == {"sender", "receiver"}
    assert report.sync is None
    assert f"the {segment.value} end alone" in first_line(report, 118)


@pytest.mark.rule("5")
def test_latencies_between_two_clocks_are_left_out():
    collector = alone(Segment.SPACE)
    # The other machine's clock is an hour ahead, so what is shown seems to come from the future.
    rows = [ShownRow(n, 3600 * NS_PER_S, n * 33 * NS_PER_MS) for n in range(1, 100)]
    told = message(DisplayMetrics(frames_displayed=99), rows=rows, stream="uplink_video")
    collector.handle_message("space_display", told, SECONDS * NS_PER_S)
    report = report_alone(collector)
    assert report.failures == []
    video = report.streams["uplink_video"]
    assert (video.display.frames_displayed, video.latency_ms.count) == (99, 0)
