"""A whole session on virtual time: every latency is exact, whatever the machine does."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.report.model import CodingCosts
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Selection
from pipelines.virtual.simulate import simulate
from telepresence.link.radio import load_radio

SECONDS = 4.0
#: One-way delay of a radio without other effects.
DELAY_MS = 2.0
#: From a haptic cycle to the sender's slot, and from the receiver's slot to its cycle.
TWO_HALVES_MS = 1.0
COSTS = CodingCosts()


def simulated(name, tmp_path_factory, **options):
    radio = tmp_path_factory.mktemp("radio") / "straight.toml"
    radio.write_text(f"delay_ms = {DELAY_MS}\n")
    setup = replace(load_setup(name), radio=load_radio(str(radio)))
    return setup, simulate(setup, seconds=SECONDS, seed=1, **options)


@pytest.fixture(scope="module")
def spacejustin(tmp_path_factory):
    selections = [Selection(2 * NS_PER_S, "static")]
    return simulated("spacejustin", tmp_path_factory, selections=selections)


@pytest.fixture(scope="module")
def taskboard(tmp_path_factory):
    return simulated("taskboard", tmp_path_factory)


@pytest.fixture(params=["spacejustin", "taskboard"])
def session(request):
    return request.getfixturevalue(request.param)


def test_a_session_goes_well(session):
    setup, report = session
    assert report.failures == []
    assert set(report.streams) == {stream.name for stream in setup.streams}
    assert report.simulation.media


def test_caps_are_kept_over_every_sliding_window(session):
    for stream in session[1].streams.values():
        assert 0 < stream.payload_bps_max_1s <= stream.cap_bps
        assert stream.payload_bps_max_100ms <= 1.5 * stream.cap_bps


def test_sequence_numbers_are_complete(session):
    _, report = session
    for name, stream in report.streams.items():
        sent = report.processes[f"{name}_send"].counts["rtp_packets_sent"]
        for count in ("rtp_lost", "rtp_reordered", "rtp_duplicates", "rtp_late", "garbage"):
            assert getattr(stream.rtp, count) == 0
        # At the end less than one picture and its successor is in flight.
        assert sent - 8 <= stream.rtp.rtp_packets <= sent
        looked_at = stream.sender.frames_encoded + stream.sender.frames_refused
        # The last picture may still be in the encoder.
        assert stream.sender.frames_captured - 1 <= looked_at <= stream.sender.frames_captured
        assert stream.capture_stamp_error_us < 12  # a tick of the 90 kHz clock


def test_haptic_latency_is_constant_under_any_media_load(session):
    for direction in session[1].haptic.values():
        # The session begins within five times the delay, with greetings in the place of samples.
        assert 0 < direction.receiver.greetings < 5 * (DELAY_MS + TWO_HALVES_MS)
        in_flight = SECONDS * 1000 - direction.sender.sent - direction.receiver.greetings
        assert 0 <= in_flight <= 4
        assert direction.receiver.lost == direction.receiver.strays == 0
        assert direction.receiver.received >= direction.sender.sent - 4
        assert direction.receiver.sessions == 1
        latency = direction.latency_ms
        assert latency.p50 == latency.max == DELAY_MS + TWO_HALVES_MS


def test_picture_latency_consists_of_coding_and_link(session):
    for name, stream in session[1].streams.items():
        if not name.endswith("video"):
            continue
        stages = stream.latency_ms.stages
        coding_ms = COSTS.capture_ms + COSTS.encode_ms
        # A picture that finds the encoder busy waits at most half a period.
        assert coding_ms == pytest.approx(stages.capture_to_encoded.p50, rel=0.005)
        assert stages.capture_to_encoded.max < coding_ms + 17
        assert COSTS.decode_ms <= stages.received_to_displayed.p50 < COSTS.decode_ms + 0.1
        assert stages.sent_to_received.p95 < 45
        # A key picture, with which each contact begins, takes two or three periods.
        assert stages.sent_to_received.max < 110
        assert stream.latency_ms.p95 < 75
        assert stream.displayed_hz > 25


def test_voice_waits_little_more_than_its_slots(spacejustin):
    _, report = spacejustin
    for name in ("uplink_voice", "downlink_voice"):
        stages = report.streams[name].latency_ms.stages
        # A block, the codec's look-ahead, and the coding itself.
        assert stages.capture_to_encoded.max == 20 + 6.5 + COSTS.voice_encode_ms
        # On the uplink, 19 octets and their header take two slots, and whole headers two more. A
        # packet may just miss a slot, and supervision may take one.
        assert stages.sent_to_received.p95 < DELAY_MS + 2
        assert stages.sent_to_received.p99 < DELAY_MS + 5
        # On the uplink, one packet waits for the reports of the selection of a camera: acceptance,
        # start and completion have 25 octets each, and take three slots each.
        reports = 4 if name == "uplink_voice" else 0
        assert stages.sent_to_received.max < DELAY_MS + 5 + reports
        assert report.streams[name].voice.frames_concealed == 0
    # Until the last octet is sent, so with the slots just named.
    assert report.link["uplink"].sender.queue["voice"].max_age_ns <= 9_000_000


def test_every_octet_is_counted(session):
    setup, report = session
    for profile in (setup.uplink, setup.downlink):
        link = report.link[profile.name]
        assert link.sender.frames == SECONDS * 1000
        assert link.receiver.frames_lost == 0
        assert sum(link.sender.octets.values()) == profile.frame_octets * link.sender.frames


def test_the_operator_selects_a_camera(spacejustin):
    processes = spacejustin[1].processes
    assert processes["selector"].newest["selected"] == "static"
    assert processes["selector"].counts["switches"] == 1
    assert processes["selector"].counts["pus_executed"] == 1
    assert processes["console"].counts["pus_telecommands"] == 1
    assert processes["console"].counts["pus_telecommands_repeated"] == 0
    assert processes["console"].counts["pus_reports"] > 0


def test_reports_depend_on_the_seed_only(tmp_path):
    radio = tmp_path / "noisy.toml"
    radio.write_text("delay_ms = 3.0\nbit_error_rate = 2e-5\nframe_loss = 0.002\n")

    def words(name, seed):
        options = ["--seconds", "1.2", "--seed", str(seed), "--radio", str(radio)]
        return ["simulate", "--setup", "spacejustin", *options, "--report", str(tmp_path / name)]

    elsewhere = subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli", *words("again", 1), "-q"],
        env={**os.environ, "PYTHONHASHSEED": "4711"},
    )
    assert main([*words("first", 1), "-q"]) == main([*words("other", 2), "-q"]) == 0
    assert elsewhere.wait(60) == 0
    first, again, other = ((tmp_path / name).read_bytes() for name in ("first", "again", "other"))
    assert first == again
    parts = [json.loads(content) for content in (first, other)]
    for part in parts:
        del part["simulation"]
    assert parts[0] != parts[1]
    assert parts[0]["link"]["uplink"]["frames_lost"] > 0


def test_all_streams_resume_after_a_blackout_without_late_data(tmp_path):
    radio = tmp_path / "dark.toml"
    radio.write_text('name = "dark"\ndelay_ms = 2.0\n[[blackouts]]\nstart_s = 1.5\nseconds = 1.0\n')
    setup = replace(load_setup("spacejustin"), radio=load_radio(str(radio)))
    report = simulate(setup, seconds=4.5, seed=3)
    assert report.failures == []
    for name, stream in report.streams.items():
        # Two seconds remain after the blackout; a stream that does not resume misses all of them.
        least = 2.9 * (25 if name.endswith("video") else 50)
        assert stream.display.frames_displayed >= least
        assert stream.rtp.rtp_lost > 0
        # A picture kept during the blackout would be a second old.
        assert stream.latency_ms.max < 150
        assert stream.payload_bps_max_1s <= stream.cap_bps
        assert stream.payload_bps_max_100ms <= 1.5 * stream.cap_bps
    for direction in report.haptic.values():
        assert direction.latency_ms.max == DELAY_MS + TWO_HALVES_MS
        assert direction.receiver.received + direction.receiver.greetings == pytest.approx(
            3500, abs=10
        )
    for profile in (setup.uplink, setup.downlink):
        link = report.link[profile.name]
        assert link.receiver.frames_lost == 1000
        assert sum(link.sender.octets.values()) == profile.frame_octets * link.sender.frames


@pytest.fixture
def clip(tmp_path):
    path = tmp_path / "clip.mp4"
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=Fraction(25))
        video.width, video.height, video.pix_fmt = 320, 240, "yuv420p"
        for number in range(20):
            picture = np.full((240, 320, 3), 10 * number, np.uint8)
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            for packet in video.encode(frame):
                container.mux(packet)
        for packet in video.encode(None):
            container.mux(packet)
    return path


def test_files_play_at_their_own_instants_and_loop(clip):
    sources = {"static": str(clip)}
    setup = replace(load_setup("taskboard"), cameras=("static",), sources=sources)
    report = simulate(setup, seconds=2.0, seed=1)
    stream = report.streams["uplink_video"]
    assert report.failures == []
    assert stream.sender.frames_captured == 50
    assert stream.display.frames_displayed >= 45


@pytest.mark.parametrize("source", ["v4l2:/dev/x", "page"])
def test_real_time_sources_are_refused_in_one_line(capsys, source):
    words = ["simulate", "--setup", "taskboard", "--seconds", "1", "--source", f"static={source}"]
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "static" in line
    assert "real time; a simulation takes scene:NAME, a media file or mcap:FILE#CHANNEL" in line


@pytest.mark.parametrize(
    "words",
    [
        ["--select", "0=roof"],
        ["--select", "soon=head"],
        ["--select", "1=head"],
        ["--encode-ms", "-1"],
    ],
)
def test_invalid_options_are_refused(words, capsys):
    assert main(["simulate", "--setup", "spacejustin", "--seconds", "1", *words]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_each_cost_of_coding_is_an_option(tmp_path):
    costs = "--capture-ms 5 --encode-ms 7 --decode-ms 3 --voice-encode-ms 2 --voice-decode-ms 1"
    costs += " --encode-h265-ms 9 --decode-h265-ms 4"
    words = ["simulate", "--setup", "spacejustin", "--seconds", "1", "--deadband", "picture", "-q"]
    words += costs.split()
    assert main([*words, "--report", str(tmp_path / "r.json")]) == 0
    streams = json.loads((tmp_path / "r.json").read_text())["streams"]
    coded = {
        name: one["latency_ms"]["stages"]["capture_to_encoded"] for name, one in streams.items()
    }
    assert coded["uplink_video"]["p50"] == pytest.approx(5 + 7, rel=0.005)
    assert coded["uplink_voice"]["p50"] == 20 + 6.5 + 2
    assert streams["uplink_video"]["gained_bps"] is not None


def test_costs_have_bounds():
    with pytest.raises(ConfigError, match="--decode-ms"):
        CodingCosts(decode_ms=5000)
