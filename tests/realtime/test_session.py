"""The whole SpaceJustin session: on its built-in world, and on real footage and speech.

No rate and no latency is asserted, because they depend on the machine.
"""

import cv2
import numpy as np
import pytest
from running_session import assert_sound, eventually

pytestmark = pytest.mark.realtime

STREAM_KEYS = [
    *("cap_bps", "payload_bps_mean", "payload_bps_max_1s", "payload_bps_max_100ms"),
    *("frames_captured", "frames_encoded", "frames_sent", "frames_displayed"),
    *("rtp_packets", "rtp_lost", "rtp_reordered", "latency_ms"),
]
PERCENTILES = {"p50", "p95", "p99", "max"}
WAY = ("frames_captured", "frames_encoded", "frames_sent", "frames_displayed")


def assert_has_every_key(report):
    assert {"setup", "seconds", "streams", "haptic", "link", "skew_ms", "processes"} <= set(report)
    for stream in report["streams"].values():
        assert set(STREAM_KEYS) <= set(stream)
        assert set(stream["latency_ms"]) >= PERCENTILES
        stages = stream["latency_ms"]["stages"]
        assert len(stages) == 4
        assert all(set(stage) >= PERCENTILES for stage in stages.values())
    for haptic in report["haptic"].values():
        keys = {"sent", "received", "lost", "latency_ms", "lateness_us", "slips"}
        assert keys <= set(haptic)
        assert set(haptic["latency_ms"]) >= PERCENTILES
        assert set(haptic["lateness_us"]) >= PERCENTILES
    for link in report["link"].values():
        assert {"capacity_bps", "octets", "queue"} <= set(link)
        assert {"tmtc", "voice", "video"} <= set(link["queue"])
        for queue in link["queue"].values():
            assert {"octets", "packets", "oldest_age_ns", "drops", "policy"} <= set(queue)
    for skew in report["skew_ms"].values():
        assert set(skew) >= {"p50", "p95", "max"}
    assert {"video_haptic", "audio_haptic", "audio_video"} <= set(report["skew_ms"])
    assert all({"cpu_s", "restarts"} <= set(entry) for entry in report["processes"].values())


def assert_nothing_lost_in_contact(report):
    """Nothing is lost but in a loss of signal, which a host causes that stops for 50 ms.

    Waiting packets are then dropped on purpose, and packets on the link lose some or all parts.
    """
    gateways = report["gateways"].values()
    contacts_lost = sum(end["supervision"]["counts"]["signals_lost"] for end in gateways)
    for direction, link in report["link"].items():
        waiting = sum(queue["drops"]["signal_lost"] for queue in link["queue"].values())
        in_part = link["packets_dropped"].get("incomplete", 0)
        assert set(link["packets_dropped"]) <= {"incomplete"}, direction
        assert contacts_lost or waiting == in_part == 0, direction
        streams = [s for name, s in report["streams"].items() if name.startswith(direction)]
        assert len(streams) == 2
        assert sum(stream["rtp_lost"] for stream in streams) <= waiting + in_part + contacts_lost


def assert_all_six_flowed(report):
    assert set(report["streams"]) == {
        "uplink_video", "uplink_voice", "downlink_video", "downlink_voice"
    }  # fmt: skip
    assert_nothing_lost_in_contact(report)
    for name, stream in report["streams"].items():
        assert stream["garbage"] == 0, name
        assert stream["rtp_packets"] > 0, name
        counts = [stream[key] for key in WAY]
        assert all(count > 0 for count in counts), (name, counts)
        assert counts[0] >= counts[1] >= counts[2], (name, counts)
        latency = stream["latency_ms"]
        assert 0 < latency["p50"] <= latency["p95"] <= latency["p99"] * 1.01, name
        stages = sum(stage["p50"] for stage in latency["stages"].values())
        assert stages > 0, name
        # Each end stamps by itself; RTP and RTCP carry the sender's stamp to the receiver.
        assert stream["capture_stamp_error_us"] < 1000, name
    for name, haptic in report["haptic"].items():
        assert 0 < haptic["received"] <= haptic["sent"], name
        assert haptic["garbage"] == 0, name
        assert haptic["latency_ms"]["p50"] > 0, name
    for direction, link in report["link"].items():
        assert link["octets"]["haptic"] > 0, direction
        assert link["octets"]["voice"] > 0, direction
        assert link["octets"]["video"] > 0, direction
        assert set(link["refused"].values()) == {0}, direction
    assert report["link"]["uplink"]["packets"]["telemetry"] > 0
    assert sum(entry["restarts"] for entry in report["processes"].values()) == 0
    assert all(entry["cpu_s"] > 0 for entry in report["processes"].values())


def test_every_stream_flows_through_one_link(start, tmp_path):
    shots = tmp_path / "shots"
    session = start("spacejustin", "--snapshots", str(shots))
    session.pids()
    session.wait_for_flow()
    for camera in ("static", "head"):
        done = session.select(camera)
        assert done.returncode == 0, done.stderr
        assert f"{camera} is selected" in done.stdout
    unknown = session.select("nosuch")
    assert unknown.returncode == 2
    _, told = unknown.stderr.splitlines()
    assert "stereo, static, head" in told
    halted = session.ask("tc", "joystick", "halt")
    assert halted.returncode == 0, halted.stderr
    stages = [line.split()[1] for line in halted.stdout.splitlines()]
    # A busy machine may need longer than until the first repetition.
    stages = [stage for stage in stages if stage != "unacknowledged"]
    assert stages == ["taken", "accepted", "started", "completed"]
    refused = session.ask("tc", "joystick", "acknowledge")
    assert refused.returncode == 1
    assert "acknowledge: not in the state" in refused.stderr
    robot = session.ask("tc", "robot", "report", "state")
    assert "robot state: x " in robot.stdout
    session.wait_for_flow()
    session.wait_for_snapshot("shots/ground-stereo", more_than=0)
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert session.errors() == ""
    session.assert_nothing_left()

    assert_sound(report)
    assert_has_every_key(report)
    assert_all_six_flowed(report)
    assert report["setup"] == "spacejustin"
    assert report["seconds"] > 1  # there was a snapshot
    assert report["processes"]["selector"]["selected"] == "head"
    assert report["link"]["downlink"]["packets"]["telecommand"] >= 2
    counts = report["processes"]["console"]["counts"]
    assert (counts["pus_executed"], counts["pus_failed"], counts["pus_garbage"]) == (1, 1, 0)
    assert_snapshots(shots)


def test_a_session_ends_by_itself_when_its_time_is_over(start):
    session = start("taskboard", "--seconds", "3")
    session.pids()
    code, report = session.end()
    assert code == 0, (session.errors(), report["failures"])
    assert report["seconds"] >= 3
    assert {"up", "down"} == set(report["haptic"])
    session.assert_nothing_left()


def assert_snapshots(shots):
    pictures = {path.name: cv2.imread(str(path)) for path in sorted(shots.glob("*.png"))}
    for kind in ("space-uplink_video", "ground-downlink_video", "ground-stereo"):
        of_kind = [picture for name, picture in pictures.items() if name.startswith(kind)]
        assert of_kind, kind
        for picture in of_kind:
            # Neither one colour, nor the grey of a decoder without a reference picture.
            assert picture.std() > 15, kind
            assert len(np.unique(picture)) > 100, kind
    halves = [name for name in pictures if name.endswith("-left-half.png")]
    assert halves
    for name in halves:
        merged = pictures[name.replace("-left-half", "")]
        left, right = pictures[name], pictures[name.replace("left", "right")]
        assert merged.shape == (480, 640, 3)
        assert left.shape == right.shape == (480, 320, 3)
        assert np.array_equal(merged, np.hstack([left, right]))


def test_real_footage_and_real_speech(start, footage, speech, tmp_path):
    session = start(
        "spacejustin",
        "--source", f"head={footage('bikes.mp4')}",
        "--source", f"iss_camera={footage('bigbuckbunny.mp4')}",
        "--source", f"ground_mic={speech('Front_Center.wav')}",
        "--snapshots", str(tmp_path),
    )  # fmt: skip
    session.pids()
    session.wait_for_flow()
    assert session.select("head").returncode == 0
    # The film has cuts, and pictures continue through all of them. A single picture may still be
    # marked as stale, or be of the other film.
    session.wait_for_flow()
    film, looked_at = thumbnails(footage("bikes.mp4")), set()

    def shown():
        # The last file may be incomplete.
        new = sorted(set(tmp_path.glob("space-uplink_video-*.png")) - looked_at)[:-1]
        looked_at.update(new)
        return any(looks_like(path, film) for path in new)

    eventually(shown, "a picture that resembles the film")
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    session.assert_nothing_left()
    assert_sound(report)
    assert_all_six_flowed(report)


def looks_like(path, film):
    """Whether the picture in a file resembles one of `film`."""
    seen = cv2.resize(cv2.imread(str(path)), (64, 48), interpolation=cv2.INTER_AREA).astype(float)
    return max(np.corrcoef(seen.ravel(), picture.ravel())[0, 1] for picture in film) > 0.9


def thumbnails(clip):
    """The pictures of a clip in 64x48, scaled as the source scales them."""
    film, pictures = cv2.VideoCapture(str(clip)), []
    while True:
        more, frame = film.read()
        if not more:
            return pictures
        height = round(64 * frame.shape[0] / frame.shape[1])
        fitted = np.zeros((48, 64, 3))
        top = (48 - height) // 2
        fitted[top : top + height] = cv2.resize(frame, (64, height), interpolation=cv2.INTER_AREA)
        pictures.append(fitted)
