"""A recorded session through a link again: the same pictures come, or it is said what was lost."""

import pytest
from synthetic_recording import write_recording

from pipelines.cli import main
from pipelines.report.model import SessionReport, from_json

SECONDS = 3.0
#: From the capture of a picture to its access unit, as the options of `simulate` say.
CODING_MS = 10.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("recording") / "a.mcap", seconds=SECONDS)


@pytest.fixture(scope="module")
def replayed(recording):
    """Replay with these options, and return the report as octets."""
    return lambda *words: replay(recording.paths[0], *words)


@pytest.fixture(scope="module")
def same(replayed):
    return replayed()


def replay(path, *words):
    out = path.with_name("report.json")
    out.unlink(missing_ok=True)
    words = ["simulate", "--replay", str(path), "--report", str(out), "-q", *map(str, words)]
    assert main(words) == 0
    return out.read_bytes()


def parsed(octets):
    return from_json(octets, SessionReport)


def test_through_the_same_link_the_same_pictures_sounds_and_samples_come(same, recording):
    report = parsed(same)
    assert report.failures == []
    replay = report.replay
    for name in ("uplink_video", "downlink_video"):
        units = len(recording.units[name])
        stream = replay.streams[name]
        assert stream.units_recorded == stream.units_received == units
        assert stream.pictures_same == report.streams[name].display.frames_displayed == units
        # The recording says that one picture was lost on the uplink.
        assert stream.same_received == stream.recorded_received == units - (name[0] == "u")
        stage = report.streams[name].latency_ms.stages.capture_to_encoded
        assert stage.p50 == stage.max == CODING_MS
    for name in ("uplink_voice", "downlink_voice"):
        assert report.streams[name].sender.frames_sent == len(recording.told[f"/{name}/sent"])
        assert report.streams[name].rtp.rtp_lost == 0
    for key in ("up", "down"):
        assert report.haptic[key].receiver.lost == 0
        # Some cycles go to the greetings with which a session begins.
        assert len(recording.haptics[f"/haptic/{key}/sent"]) - report.haptic[key].sender.sent < 200
        assert report.haptic[key].latency_ms.max == 1.0
    assert replay.samples_superseded == 0
    assert report.processes["selector"].counts["pus_executed"] == 1


def test_a_replay_repeats_exactly(replayed, same):
    assert replayed() == same


def test_delay_of_another_link_shows_and_nothing_else(replayed, same, tmp_path):
    radio = tmp_path / "far.toml"
    radio.write_text("delay_ms = 250\n")
    here, there = parsed(same), parsed(replayed("--radio", radio))
    assert there.simulation.radio == "far"
    now, then = (report.streams["uplink_video"].latency_ms.p50 for report in (there, here))
    # As fine as a histogram keeps it.
    assert 247 < now - then < 257
    assert there.haptic["up"].latency_ms.max - here.haptic["up"].latency_ms.max == 250
    assert there.replay.streams["uplink_video"] == here.replay.streams["uplink_video"]


def test_losses_of_another_link_show(replayed, same, tmp_path):
    radio = tmp_path / "bad.toml"
    # Behind the last key picture, for longer than between two pictures. Random losses may hit the
    # key picture, and then nothing is shown: that depends on its size, so on the encoder.
    radio.write_text('[[blackouts]]\nstart_s = 1.8\nseconds = 0.15\ndirection = "uplink"\n')
    here, there = parsed(same), parsed(replayed("--radio", radio))
    now, then = (report.replay.streams["uplink_video"] for report in (there, here))
    assert now.units_recorded == then.units_recorded
    assert then.units_received - 5 <= now.units_received < then.units_received
    assert now.pictures_same < then.pictures_same
    assert now.psnr_db_mean < then.psnr_db_mean
    assert there.replay.streams["downlink_video"] == here.replay.streams["downlink_video"]
    # Echoes go in the place of two.
    assert (there.haptic["up"].receiver.lost, there.haptic["down"].receiver.lost) == (148, 0)


def test_pictures_coded_anew_fit_under_a_lower_cap(replayed, same, recording):
    report = parsed(replayed("--recode", "--cap-kbps", "uplink_video=40"))
    stream = report.replay.streams["uplink_video"]
    assert report.streams["uplink_video"].payload_bps_max_1s <= 40_000
    assert stream.units_received == 0
    # Held against the picture of the same instant: against its neighbour they reach 23 dB.
    assert stream.psnr_db_p5 > 26
    assert stream.psnr_db_mean > 33
    shown = report.streams["uplink_video"].display.frames_displayed
    assert shown > len(recording.units["uplink_video"]) / 2


def test_all_parts_of_a_recording_are_sent(tmp_path, capsys):
    recording = write_recording(tmp_path / "a.mcap", seconds=SECONDS, parts=3)
    first = recording.paths[0]
    stream = parsed(replay(first)).replay.streams["uplink_video"]
    assert stream.units_recorded == stream.pictures_same == len(recording.units["uplink_video"])
    assert main(["simulate", "--replay", str(first), "--recode"]) == 2
    assert "has 3: `kontur-av replay --recode` takes them all" in capsys.readouterr().err
