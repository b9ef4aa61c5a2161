"""A LeRobot data set has the recorded pictures and cycles, each in the row of its instant."""

import json

import av
import numpy as np
import pytest
from common import psnr_db
from synthetic_recording import BEGIN_NS, HEIGHT, LINK_CYCLES, MS, WIDTH, S, packet, write_recording

from kontur_av.codecs.h26x import H264Decoder
from kontur_av.media import empty_picture
from pipelines.bench.course import marks
from pipelines.cli import main
from pipelines.recording.export.tables import Run, TaskRuns
from pipelines.recording.joined import JoinedMessage
from pipelines.recording.recorded_messages import SPACE_PACKET
from telepresence.tmtc.k2aci import Numbered, StartTask, TaskFinished, TaskResult, pack_body
from telepresence.tmtc.pus.node import K2ACI_SERVICE, K2ACI_SUBTYPE
from telepresence.tmtc.pus.packets import Telemetry, pack_packet

pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow: pip install -e '.[full]'")

SECONDS, FPS = 4.0, 20
CAMERA = "uplink_video"
RUNS = [
    Run("aiming", BEGIN_NS + 500 * MS, BEGIN_NS + 1500 * MS, "finished"),
    Run("spring", BEGIN_NS + 2000 * MS, None, "unfinished"),
]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    directory = tmp_path_factory.mktemp("lerobot")
    recording = write_recording(directory / "a.mcap", seconds=SECONDS, parts=2)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(TaskRuns, "runs", lambda _: RUNS)
        options = ["--lerobot", str(directory / "set"), "--fps", str(FPS)]
        assert main(["export", str(recording.paths[0]), *options]) == 0
    return recording, directory / "set"


@pytest.fixture(scope="module")
def rows(written):
    return pq.read_table(written[1] / "data/chunk-000/file-000.parquet").to_pydict()


@pytest.fixture(scope="module")
def episodes(written):
    return pq.read_table(written[1] / "meta/episodes/chunk-000/file-000.parquet").to_pylist()


def film(folder, episode, camera=CAMERA):
    """The pictures of an episode, and their times in s."""
    path = folder / f"videos/observation.images.{camera}/chunk-000/file-{episode:03d}.mp4"
    with av.open(str(path)) as container:
        assert container.streams.video[0].average_rate == FPS
        return [
            (frame.to_ndarray(format="yuv420p"), float(frame.time))
            for frame in container.decode(video=0)
        ]


def test_the_row_of_an_instant_shows_what_was_captured_then(written, rows, episodes):
    recording, folder = written
    numbers = {unit.capture_ns: unit.number for unit in recording.units[CAMERA]}
    decoder, decoded = H264Decoder(), {}
    for unit in recording.units[CAMERA]:
        (picture,) = decoder.decode(unit.data, 0)
        decoded[unit.capture_ns] = empty_picture(WIDTH, HEIGHT)
        picture.scale_into(decoded[unit.capture_ns])
    for episode in episodes:
        first = episode["dataset_from_index"]
        shown = film(folder, episode["episode_index"])
        assert len(shown) == episode["length"] == episode["dataset_to_index"] - first
        begin_ns = rows[f"capture_ns.{CAMERA}"][first]
        for at, (picture, time_s) in enumerate(shown):
            assert abs(time_s - rows["timestamp"][first + at]) < 1e-4
            assert rows["timestamp"][first + at] == pytest.approx(at / FPS, abs=1e-6)
            capture_ns = rows[f"capture_ns.{CAMERA}"][first + at]
            read = marks.read_number(marks.levels(picture[:HEIGHT]))
            assert read == numbers[capture_ns]
            assert psnr_db(picture, decoded[capture_ns]) > 38
            # No picture that was captured nearer to this row is missing.
            instant_ns = begin_ns + at * S // FPS
            nearest = min(numbers, key=lambda one: abs(one - instant_ns))
            if abs(nearest - instant_ns) < 0.49 * S / FPS:
                assert abs(capture_ns - instant_ns) <= 0.5 * S / FPS


def test_state_force_and_action_are_those_of_the_picture(written, rows, episodes):
    recording, _ = written
    robot = recording.haptics["/haptic/up/sent"]
    joystick = recording.haptics["/haptic/down/sent"]
    captures = rows[f"capture_ns.{CAMERA}"]
    compared = 0
    for episode in episodes:
        first, behind = episode["dataset_from_index"], episode["dataset_to_index"]
        for row in range(first, behind):
            repeated = row > first and captures[row] == captures[row - 1]
            at_ns = captures[row] if not repeated else captures[first] + (row - first) * S // FPS
            cycle = np.searchsorted(robot["time_ns"], at_ns, side="right") - 1
            assert rows["observation.state"][row] == [robot["x_m"][cycle], robot["y_m"][cycle]]
            assert rows["observation.force"][row] == [robot["fx_n"][cycle], robot["fy_n"][cycle]]
            # In this recording the robot acts on each sample this many cycles later.
            acted = cycle - LINK_CYCLES
            assert rows["action"][row] == [joystick["x_m"][acted], joystick["y_m"][acted]]
            compared += not repeated
    assert compared > 30


def test_episodes_are_the_runs_of_tasks_with_the_statistics_of_their_rows(written, rows, episodes):
    folder = written[1]
    info = json.loads((folder / "meta/info.json").read_text())
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert tasks.column("__index_level_0__").to_pylist() == [run.task for run in RUNS]
    captures = rows[f"capture_ns.{CAMERA}"]
    for run, one in zip(RUNS, episodes, strict=True):
        assert (one["tasks"], one["result"]) == ([run.task], run.result)
        first, last = one["dataset_from_index"], one["dataset_to_index"] - 1
        assert 0 <= captures[first] - run.begin_ns < 100 * MS
        assert captures[last] <= (run.end_ns or BEGIN_NS + SECONDS * S) + S // FPS
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", FPS, 2)
    assert info["total_frames"] == len(captures) == episodes[-1]["dataset_to_index"]
    assert rows["index"] == [*range(len(captures))]
    stored = {*rows} | {f"observation.images.{name}" for name in (CAMERA, "head")}
    assert {*info["features"]} == stored
    folder = written[1]
    stats = json.loads((folder / "meta/stats.json").read_text())
    force = np.array(rows["observation.force"])
    np.testing.assert_allclose(stats["observation.force"]["min"], force.min(axis=0))
    np.testing.assert_allclose(stats["observation.force"]["std"], force.std(axis=0), rtol=1e-6)
    shown = (one for row in episodes for one, _ in film(folder, row["episode_index"]))
    frames = [av.VideoFrame.from_ndarray(one, format="yuv420p") for one in shown]
    mean = np.mean([frame.to_ndarray(format="rgb24") / 255 for frame in frames], axis=(0, 1, 2))
    found = np.array(stats[f"observation.images.{CAMERA}"]["mean"])
    np.testing.assert_allclose(found[:, 0, 0], mean, atol=0.02)


def test_a_run_is_found_in_the_packets_of_the_robot_first():
    runs = TaskRuns()

    def say(topic, at_ms, message, number):
        body = pack_body(Numbered(1, number, 0, message))
        data = pack_packet(
            Telemetry(apid=1, count=0, service=K2ACI_SERVICE, subtype=K2ACI_SUBTYPE, data=body)
        )
        told = packet(topic, at_ms * MS, number, data)
        at_ns = told.log_ns
        runs.handle_message(
            JoinedMessage(topic, SPACE_PACKET.full_name, at_ns, at_ns, number, told.data, 0)
        )

    start = StartTask(task="aiming", run=1)
    say("/telecommand/sent", 100, start, 0)
    for repetition_ms in (150, 190):
        say("/telecommand/received", repetition_ms, start, 0)
    end = TaskFinished(task="aiming", run=1, result=TaskResult.TIMED_OUT)
    say("/telemetry/sent", 900, end, 0)
    say("/telemetry/received", 950, end, 0)
    say("/telecommand/received", 1000, StartTask(task="spring", run=2), 1)
    assert runs.runs() == [
        Run("aiming", 150 * MS, 900 * MS, "timed_out"),
        Run("spring", 1000 * MS, None, "unfinished"),
    ]


def test_what_cannot_become_a_data_set_is_refused(written, tmp_path, capsys):
    recording, folder = written
    file = str(recording.paths[0])
    assert main(["export", file, "--lerobot", str(folder), "--overwrite"]) == 2
    assert "give a directory that is new or empty" in capsys.readouterr().err
    assert main(["export", file, "--csv", str(tmp_path / "c"), "--fps", "5"]) == 2
    assert "give --lerobot DIR, too" in capsys.readouterr().err
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(TaskRuns, "runs", lambda _: [Run("x", BEGIN_NS - S, BEGIN_NS - 1, "")])
        assert main(["export", file, "--lerobot", str(tmp_path / "none")]) == 2
    assert "no run of a task" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
