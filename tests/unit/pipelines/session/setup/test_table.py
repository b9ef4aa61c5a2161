"""The built-in setups fit their channels, and what cannot work is refused when it is built."""

from dataclasses import replace

import pytest
from rtp_packets import make_sender

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from pipelines.media.stream_metrics import REPORT_INTERVAL_NS
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.setup_file import BUILT_IN, load_setup
from pipelines.session.setup.table import PORTS, Setup, VideoStream
from telepresence.link import arithmetic
from telepresence.link.radio import load_radio
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import MAX_PACKET_OCTETS
from telepresence.tmtc.pus.packets import MAX_COMMAND_OCTETS, MAX_REPORT_OCTETS

UP, DOWN = Direction.UPLINK, Direction.DOWNLINK


@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=BUILT_IN)
def test_the_built_in_setups_fit_their_channels(setup):
    caps = [stream.cap_bps for stream in setup.streams if stream.name.startswith("uplink")]
    assert setup.need(UP).payload_bps == sum(caps)
    assert setup.need(UP).spare_bps >= 0
    assert setup.need(DOWN).spare_bps >= 0
    assert (setup.uplink.capacity_bps, setup.downlink.capacity_bps) == (256_000, 4_000_000)
    # Below the ephemeral ports of Linux.
    assert setup.base_port + PORTS <= 32_768


def test_caps_packets_and_the_capacity_for_walls_are_those_of_the_specification():
    caps = {name: {s.name: s.cap_bps for s in setup.streams} for name, setup in BUILT_IN.items()}
    assert caps["taskboard"] == {"uplink_video": 90_000}
    assert caps["spacejustin"] == {
        "uplink_video": 85_000,
        "uplink_voice": 8_000,
        "downlink_video": 512_000,
        "downlink_voice": 64_000,
    }
    spacejustin = BUILT_IN["spacejustin"]
    assert spacejustin.uplink_video.packets_per_s == 30
    assert spacejustin.downlink_video.packets_per_s == 90
    seldom = VideoStream(name="uplink_video", cap_bps=85_000, fps=1)
    assert seldom.packets_per_s == 11
    # At this low cap a packet of 1000 octets does not fit into 100 ms.
    assert replace(seldom, cap_bps=20_000).payload_octets == 375
    direct = load_setup("spacejustin")
    mediated = load_setup("spacejustin", changes={"hand": "mediated"})
    # Two a second of 16 octets, with tag and resume tag.
    assert direct.need(UP).spare_bps - mediated.need(UP).spare_bps == 8 * 2 * (16 + 1 + 1)
    assert mediated.need(DOWN) == direct.need(DOWN)
    setup = own_setup(cameras=("a_mic",), sources={"a_mic": "clip.mp4"})
    assert setup.kind_of("a_mic") == "video"
    with pytest.raises(ConfigError, match="no input operator_mic"):
        setup.kind_of("operator_mic")


def pus_octets_per_s(end):
    """The housekeeping of an end that is on from the start, with its tags."""
    total = 0.0
    for application in built_in_dictionary().applications:
        for structure in application.structures:
            if application.end == end and structure.on:
                values = sum(one.octets for one in application.named(structure.parameters))
                packet = MAX_PACKET_OCTETS - MAX_REPORT_OCTETS + 1 + values
                total += (
                    arithmetic.TAG_OCTETS + arithmetic.RESUME_OCTETS + packet
                ) / structure.interval_s
    return total


def test_reports_fit_the_reserve_and_a_radio_is_a_profile_or_a_cable_with_a_delay(tmp_path):
    rtp = make_sender(cname=Segment.GROUND.cname)
    rtp.audio_packets(b"\x08", CaptureStamp(0, 0, "test"))
    reports = 2 * (arithmetic.TAG_OCTETS + len(rtp.poll_report(0))) * 1e9 / REPORT_INTERVAL_NS
    # About a telecommand every ten seconds: accepted, started, completed.
    verification = MAX_PACKET_OCTETS - MAX_REPORT_OCTETS + 4
    up = reports + 3 * (arithmetic.TAG_OCTETS + arithmetic.RESUME_OCTETS + verification) / 10
    assert 0 <= arithmetic.RESERVE_BPS / 8 - up - pus_octets_per_s("ground") <= 5
    # The telecommand.
    select, _ = built_in_dictionary().application("camera").parameters
    command = MAX_PACKET_OCTETS - MAX_COMMAND_OCTETS + 1 + select.octets
    down = reports + (arithmetic.TAG_OCTETS + arithmetic.RESUME_OCTETS + command) / 10
    assert 0 <= arithmetic.RESERVE_DOWN_BPS / 8 - down - pus_octets_per_s("space") <= 5
    file = tmp_path / "storm.toml"
    file.write_text("delay_ms = 40\nframe_loss = 0.1\n")
    assert own_setup().radio_profile.longest_delay_ns == 0
    assert own_setup(radio=load_radio(str(file))).radio_profile.frame_loss == 0.1
    assert own_setup(radio_delay_ms=12.5).radio_profile.longest_delay_ns == 12_500_000
    # A direction has its own radio from the same seed.
    setup = own_setup(radio="geo")
    for profile, direction in ((setup.uplink, "uplink"), (setup.downlink, "downlink")):
        report = setup.radio_path(profile, seed=3, epoch_ns=5).report()
        assert report.channel.direction == direction


def own_setup(**changes):
    video = VideoStream(name="uplink_video", cap_bps=50_000)
    return Setup(**{"name": "x", "cameras": ("static",), "uplink_video": video} | changes)


@pytest.mark.rule("6")
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"sources": {"heda": "x.mp4"}}, "no such input"),
        ({"base_port": 65_530}, "base port"),
        ({"cameras": ("static", "iss_camera")}, "camera iss_camera .* rename it"),
        ({"cameras": ("static", "iss_mic")}, "camera iss_mic .* rename it"),
        ({"cameras": ("static", "ground_mic")}, "camera ground_mic .* rename it"),
        ({"radio": "geo", "radio_delay_ms": 12.5}, "radio geo has .* take radio cable"),
        ({"radio": "storm"}, "unknown radio storm"),
        ({"hand": "soft"}, "hand 'soft': take one of adaptive, direct, mediated"),
    ],
)
def test_a_setup_cannot_be_changed_or_misused(changes, says):
    with pytest.raises(ConfigError, match=says):
        own_setup(**changes)
    with pytest.raises(AttributeError):
        own_setup().base_port = 1
