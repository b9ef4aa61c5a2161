"""A whole session on virtual time: every latency is exact, whatever the machine does."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.cli import main
from pipelines.media.media_metrics import CodingCosts
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Selection
from pipelines.virtual.simulate import simulate
from telepresence.link.radio import load_radio

#: Long enough that the three whole headers of a start do not make the percentiles.
SECONDS = 5.0
#: One-way delay of a radio without other effects.
DELAY_MS = 2.0
#: From a haptic cycle to the sender's slot, and from the receiver's slot to its cycle.
TWO_HALVES_MS = 1.0
COSTS = CodingCosts()


def simulated(
    tmp_path_factory,
    name="spacejustin",
    *,
    radio="",
    down=True,
    repair="auto",
    seconds=SECONDS,
    **options,
):
    """Simulate; down: with picture and voice from space, too."""
    path = tmp_path_factory.mktemp("radio") / "radio.toml"
    path.write_text(f"delay_ms = {DELAY_MS}\n{radio}")
    setup = replace(load_setup(name), radio=load_radio(str(path)), repair=repair)
    if not down:
        setup = replace(setup, downlink_video=None, downlink_voice=None)
    return setup, simulate(setup, seconds=seconds, seed=1, **options)


@pytest.fixture(scope="module")
def spacejustin(tmp_path_factory):
    selections = [Selection(2 * NS_PER_S, "static")]
    return simulated(tmp_path_factory, selections=selections)


@pytest.fixture(scope="module")
def taskboard(tmp_path_factory):
    return simulated(tmp_path_factory, "taskboard")


@pytest.fixture(params=["spacejustin", "taskboard"])
def session(request):
    return request.getfixturevalue(request.param)


def check_caps(stream):
    assert 0 < stream.payload_bps_max_1s <= stream.cap_bps
    assert stream.payload_bps_max_100ms <= 1.5 * stream.cap_bps


def test_a_session_goes_well_and_loses_and_miscounts_nothing(session):
    setup, report = session
    assert report.failures == []
    assert set(report.streams) == {stream.name for stream in setup.streams}
    assert report.simulation.media
    for name, stream in report.streams.items():
        check_caps(stream)
        sent = report.processes[f"{name}_send"].counts["rtp_packets_sent"]
        for count in ("rtp_lost", "rtp_reordered", "rtp_duplicates", "rtp_late", "garbage"):
            assert getattr(stream.rtp, count) == 0
        # At the end less than one picture and its successor is in flight.
        assert sent - 8 <= stream.rtp.rtp_packets <= sent
        looked_at = stream.sender.frames_encoded + stream.sender.frames_refused
        # The last picture may still be in the encoder.
        assert stream.sender.frames_captured - 1 <= looked_at <= stream.sender.frames_captured
        assert stream.capture_stamp_error_us < 12  # a tick of the 90 kHz clock
    for profile in (setup.uplink, setup.downlink):
        link = report.link[profile.name]
        assert link.sender.frames == SECONDS * 1000
        assert link.receiver.frames_lost == 0
        assert sum(link.sender.octets.values()) == profile.frame_octets * link.sender.frames


def test_haptic_latency_is_constant_under_any_media_load(session):
    for direction in session[1].haptic.values():
        # The session begins within five times the delay, with greetings in the place of samples.
        assert 0 < direction.receiver.greetings < 5 * (DELAY_MS + TWO_HALVES_MS)
        others = direction.receiver.greetings + direction.receiver.echoes
        in_flight = SECONDS * 1000 - direction.sender.sent - others
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
        # A block of 20 ms, 6.5 of look-ahead, coding, slots, the radio and the playout buffer.
        latency_ms = report.streams[name].latency_ms
        assert 30 < latency_ms.p50 < 50 and latency_ms.p99 <= 60
        assert report.streams[name].display.stale_ns == 0
    # In sync from the very first picture on, although that one is large.
    assert report.lip_sync.within == 1
    assert report.skew_ms["audio_video"].p50 > -45
    # Until the last octet is sent, so with the slots just named.
    assert report.link["uplink"].sender.queue["voice"].max_age_ns <= 9_000_000


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


def test_each_cost_of_coding_is_an_option(tmp_path):
    costs = "--capture-ms 5 --encode-ms 7 --decode-ms 3 --voice-encode-ms 2 --voice-decode-ms 1"
    costs += " --encode-h265-ms 9 --decode-h265-ms 4"
    words = ["simulate", "--setup", "spacejustin", "--seconds", "1", "--deadband", "picture", "-q"]
    words += ["--repair", "off", *costs.split()]
    assert main([*words, "--report", str(tmp_path / "r.json")]) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    streams = report["streams"]
    assert "repair" not in report["link"]["uplink"]["octets"]
    coded = {
        name: one["latency_ms"]["stages"]["capture_to_encoded"] for name, one in streams.items()
    }
    assert coded["uplink_video"]["p50"] == pytest.approx(5 + 7, rel=0.005)
    assert coded["uplink_voice"]["p50"] == 20 + 6.5 + 2
    assert streams["uplink_video"]["gained_bps"] is not None


def test_all_streams_resume_after_a_second_of_blackout_stale_and_without_late_data(
    tmp_path_factory,
):
    setup, report = simulated(
        tmp_path_factory, seconds=4.5, radio="[[blackouts]]\nstart_s = 1.5\nseconds = 1.0\n"
    )
    assert report.failures == []
    for row in setup.streams:
        video, stream = row.name.endswith("video"), report.streams[row.name]
        # Two seconds remain after the blackout; a stream that does not resume misses all of them.
        assert stream.display.frames_displayed >= 2.9 * (25 if video else 50)
        assert stream.rtp.rtp_lost > 0
        # A picture kept during the blackout would be a second old.
        assert stream.latency_ms.max < 150
        check_caps(stream)
        assert stream.stale_after_ms == pytest.approx(setup.stale_after_ns(row) / 1e6, abs=1e-3)
        assert stream.display.stale_episodes == 1
        assert 1000 - stream.stale_after_ms < stream.display.stale_ns / NS_PER_MS < 1300
        frozen_ms = stream.display.frozen_ns / NS_PER_MS
        assert 900 < frozen_ms < 1500 if video else frozen_ms == 0
        # A loss may damage pictures until the refresh is complete or a key picture arrives.
        assert stream.display.damaged_ns / NS_PER_MS <= 1100 or not video
    for direction in report.haptic.values():
        assert direction.latency_ms.max == DELAY_MS + TWO_HALVES_MS
        receiver = direction.receiver
        came = receiver.received + receiver.greetings + receiver.echoes
        assert came == pytest.approx(3500, abs=10)
    for profile in (setup.uplink, setup.downlink):
        link = report.link[profile.name]
        assert link.receiver.frames_lost == 1000
        assert sum(link.sender.octets.values()) == profile.frame_octets * link.sender.frames


def test_only_sound_waits_for_late_pictures_and_no_longer_than_needed(
    tmp_path_factory, spacejustin
):
    costs = CodingCosts(capture_ms=95)
    _, report = simulated(tmp_path_factory, seconds=7.0, down=False, costs=costs)
    video, voice = (report.streams[name].latency_ms for name in ("uplink_video", "uplink_voice"))
    # Without lip-sync the sound would be about 90 ms early; with it at most 45, and not later.
    assert video.p50 - spacejustin[1].streams["uplink_voice"].latency_ms.p50 > 80
    assert -46 < report.skew_ms["audio_video"].p50 < -15
    assert voice.max < video.max - 15
    # Except for the 1.5 s in which the voice is stretched.
    assert 0.6 < report.lip_sync.within < 1
    assert report.lip_sync.late == 0
    assert report.haptic["up"].latency_ms.max == DELAY_MS + TWO_HALVES_MS
    assert report.streams["uplink_voice"].voice.frames_concealed == 0


def test_occasional_losses_count_as_damaged_and_concealed(tmp_path_factory):
    scene = {"seconds": 3.0, "radio": "frame_loss = 0.01\n", "down": False}
    _, report = simulated(tmp_path_factory, repair="off", **scene)
    video, voice = (report.streams[name] for name in ("uplink_video", "uplink_voice"))
    assert video.rtp.rtp_lost > 0
    assert 0 < video.display.damaged_ns / NS_PER_MS < 3000
    assert voice.voice.frames_concealed > 0
    assert voice.display.stale_ns == 0
    # A loss delays nothing.
    assert voice.latency_ms.p99 <= 60
    _, repaired = simulated(tmp_path_factory, **scene)
    assert repaired.streams["uplink_video"].rtp.rtp_lost < video.rtp.rtp_lost / 4
