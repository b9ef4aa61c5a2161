"""The report that is built from what a collector knows."""

import json
from array import array

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.collector import Collector
from pipelines.probe import Message
from pipelines.report import build_report, failures
from pipelines.setups import BUILT_IN

SETUP = BUILT_IN["taskboard"]
PARTS = ("uplink_video_send", "uplink_video_receive", "space_display", "robot", "joystick")


def told(octets_a_packet=300, displayed=30, received=1000):
    """A collector after a second of 30 packets."""
    collector = Collector([stream.name for stream in SETUP.streams])
    out = [value for k in range(30) for value in (k * 33 * NS_PER_MS, octets_a_packet)]
    totals = {
        "uplink_video_send": {"frames_captured": 31, "frames_encoded": 30, "frames_sent": 30},
        "uplink_video_receive": {"rtp_packets": 30, "rtp_lost": 0, "garbage": 2},
        "space_display": {"uplink_video.frames_displayed": displayed},
        "robot": {"sent": 1000, "received": received, "lost": 0},
        "joystick": {"sent": 1000, "received": received, "lost": 1},
    }
    for process, values in totals.items():
        series = {"out": array("q", out)} if process == "uplink_video_send" else {}
        collector.handle_message(process, Message(values, {}, series), NS_PER_S)
    return collector


def report_of(collector, seconds=5.0):
    return build_report(
        SETUP,
        collector,
        seconds=seconds,
        cpu_s=dict.fromkeys(PARTS, 0.5),
        restarts={**dict.fromkeys(PARTS, 0), "robot": 2},
        launcher_cpu_s=1.0,
    )


def test_the_report_says_what_was_counted():
    report = json.loads(json.dumps(report_of(told())))
    stream = report["streams"]["uplink_video"]
    assert stream["payload_bps_max_1s"] == 30 * 300 * 8
    assert stream["cap_bps"] == 90_000
    assert (stream["frames_captured"], stream["frames_sent"], stream["rtp_packets"]) == (31, 30, 30)
    assert stream["frames_displayed"] == 30
    assert report["haptic"]["up"]["lost"] == 1
    assert report["haptic"]["down"]["lost"] == 0
    assert report["processes"]["robot"]["restarts"] == 2
    assert report["processes"]["uplink_video_receive"]["garbage"] == 2
    assert "garbage" not in report["processes"]["space_display"]
    assert report["cpu"]["total_s"] == 0.5 * len(PARTS) + 1.0
    assert report["failures"] == []


def test_a_broken_cap_is_a_failure():
    (failure,) = failures(SETUP, told(octets_a_packet=376), 5.0)
    assert failure.startswith("uplink_video: 90240 bit/s")
    assert failures(SETUP, told(octets_a_packet=375), 5.0) == []


def test_a_stream_that_nobody_saw_is_a_failure():
    (failure,) = failures(SETUP, told(displayed=0), 5.0)
    assert failure == "uplink_video: nothing was displayed"
    # Too short to say anything.
    assert failures(SETUP, told(displayed=0), 1.0) == []


def test_a_hand_that_felt_nothing_is_a_failure():
    assert len(failures(SETUP, told(received=0), 5.0)) == 2


def test_a_session_that_ended_at_once_still_has_a_report():
    empty = Collector([stream.name for stream in SETUP.streams])
    report = json.loads(json.dumps(report_of(empty, seconds=0.0)))
    assert report["streams"]["uplink_video"]["payload_bps_mean"] == 0
    assert report["link"]["uplink"]["frames"] == 0
