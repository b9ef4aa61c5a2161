"""`kontur-av replay` with real processes: all that was recorded is sent, also after a kill."""

import pytest
from running_session import RunningReplay, assert_sound
from synthetic_recording import write_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    # So long that it has not ended when a slow machine has restarted a sender.
    return write_recording(tmp_path_factory.mktemp("recording") / "a.mcap", seconds=15.0)


@pytest.fixture
def replay(recording, tmp_path):
    started = []

    def start(*options):
        started.append(RunningReplay(recording.paths[0], *options, directory=tmp_path))
        return started[-1]

    yield start
    for session in started:
        session.__exit__()


def test_all_that_was_recorded_is_sent_and_nothing_is_coded(replay, recording):
    session = replay("--seconds", "9")
    assert set(session.pids()) == set(session.names)
    code, report = session.end()
    assert code == 0, (session.errors(), report["failures"])
    session.assert_nothing_left()
    assert_sound(report)
    end_ns = recording.capabilities.session_ns + 9_000_000_000
    for name in ("uplink_video", "downlink_video"):
        units = [unit for unit in recording.units[name] if unit.capture_ns < end_ns]
        stream = report["streams"][name]
        assert report["replay"]["streams"][name]["units_recorded"] == len(units)
        # What is due at the very end may stay unsent; on virtual time nothing does.
        assert stream["frames_captured"] == stream["frames_sent"] <= len(units)
        assert stream["frames_sent"] > 0.9 * len(units) > 50
    for name in ("uplink_voice", "downlink_voice"):
        packets = [told for told in recording.told[f"/{name}/sent"] if told.log_ns < end_ns]
        stream = report["streams"][name]
        # A voice leaves out what would come too late, as on a machine that stalls.
        assert 0.8 * len(packets) < stream["frames_sent"] <= stream["frames_captured"]
        assert stream["frames_captured"] <= len(packets)
    for key in ("up", "down"):
        rows = recording.haptics[f"/haptic/{key}/sent"]["time_ns"]
        assert 0 < report["haptic"][key]["sent"] <= (rows < end_ns).sum()
        assert report["haptic"][key]["received"] > 0
    counts = {name: row["counts"] for name, row in report["processes"].items()}
    sent = [told for told in recording.told["/telecommand/space/sent"] if told.log_ns < end_ns]
    assert counts["selector"]["pus_executed"] + counts["selector"]["pus_duplicates"] == len(sent)
    assert counts["selector"]["switches"] == 1
    assert counts["console"]["pus_reports"] > 0
    assert counts["console"]["pus_garbage"] == counts["selector"]["pus_garbage"] == 0


def test_a_killed_sender_goes_on_with_the_present(replay, recording):
    session = replay()
    pids = session.pids()
    session.wait_for_flow()
    session.kill(pids, "uplink_video_send")
    session.wait_for_flow(["uplink_video"])
    report = session.finish(clean=True)
    assert report["processes"]["uplink_video_send"]["restarts"] == 1
    # Nothing twice, although the new process has the whole recording.
    sent = report["streams"]["uplink_video"]["frames_sent"]
    assert 0 < sent < len(recording.units["uplink_video"])
