"""Setups: the built-in ones, and a user's file with every field."""

from dataclasses import asdict, fields, replace

import pytest
from rtp_packets import PromptSender

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from pipelines.media.stream_figures import REPORT_INTERVAL_NS
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.setup_file import BUILT_IN, load_setup
from pipelines.session.setup.table import PORTS, RtcLeg, Setup, VideoStream
from telepresence.haptics.envelope import SafetyLimits
from telepresence.link.arithmetic import (
    RESERVE_BPS,
    RESERVE_DOWN_BPS,
    RESUME_OCTETS,
    TAG_OCTETS,
)
from telepresence.link.radio import load_radio
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import MAX_PACKET_OCTETS
from telepresence.tmtc.pus.packets import MAX_COMMAND_OCTETS, MAX_REPORT_OCTETS

EVERY_FIELD = """
name = "wrist"
cameras = ["wrist", "stereo"]
radio = "cable"
radio_delay_ms = 12.5
deadband = "latency"
hand = "mediated"
axes = 2
gripper = false
partner_arm = "second"
tasks = true
recorded_cameras = "all"
region = "stylus"
base_port = 21000

[uplink_video]
cap_kbps = 62.5
size = "320x240"
fps = 25
prefer = "latency"
stale_after_ms = 250.5
coded = "160x120"
codec = "h265"

[uplink_voice]
cap_kbps = 6.4
stale_after_ms = 90

[downlink_video]
cap_kbps = 300
size = "800x600"
fps = 15
codec = "h264"

[downlink_voice]
cap_kbps = 24

[region_points]
wrist = [[40, 30], [280, 33.5], [300, 210], [25, 205]]

[sources]
wrist = "pipe:/tmp/wrist.y4m"
left = "left.mp4"

[rtc]
video_kbps = 900
voice_kbps = 24
taken_kbps = 700

[uplink]
frame_octets = 40

[downlink]
frame_octets = 250

[safety]
resume_within_s = 0.2
slow_m_s = 0.05
"""


def test_every_field_of_a_file_reaches_the_setup(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(EVERY_FIELD)
    setup = load_setup(str(path))
    for entry in fields(Setup):
        assert f"{entry.name}" in EVERY_FIELD, f"{entry.name} is not in the file of this test"
    assert (setup.name, setup.cameras) == ("wrist", ("wrist", "stereo"))
    assert (setup.radio, setup.radio_delay_ms, setup.base_port) == ("cable", 12.5, 21_000)
    assert setup.deadband == "latency"
    assert (setup.axes, setup.gripper) == (2, False)
    assert (setup.hand, setup.partner_arm, setup.tasks) == ("mediated", "second", True)
    corners = ((40, 30), (280, 33.5), (300, 210), (25, 205))
    assert setup.recorded_cameras == "all"
    assert (setup.region, setup.region_points) == ("stylus", {"wrist": corners})
    assert setup.rtc == RtcLeg(video_bps=900_000, voice_bps=24_000, taken_bps=700_000)
    assert setup.safety == SafetyLimits(resume_within_s=0.2, slow_m_s=0.05)
    video = {"name": "uplink_video", "cap_bps": 62_500, "width": 320, "height": 240, "fps": 25}
    assert asdict(setup.uplink_video) == video | {
        "prefer": "latency",
        "stale_after_ms": 250.5,
        "coded": (160, 120),
        "codec": "h265",
    }
    down = {"name": "downlink_video", "cap_bps": 300_000, "width": 800, "height": 600, "fps": 15}
    assert asdict(setup.downlink_video) == down | {
        "prefer": "quality",
        "stale_after_ms": None,
        "coded": None,
        "codec": "h264",
    }
    voice = {"name": "uplink_voice", "cap_bps": 6_400, "stale_after_ms": 90}
    assert asdict(setup.uplink_voice) == voice
    down = {"name": "downlink_voice", "cap_bps": 24_000, "stale_after_ms": None}
    assert asdict(setup.downlink_voice) == down
    # Without a value in the file: the radio's delay, 100 ms and four periods.
    ages_ms = [setup.stale_after_ns(stream) / 1e6 for stream in setup.streams]
    assert ages_ms == pytest.approx([250.5, 90, 12.5 + 100 + 4000 / 15, 12.5 + 100 + 80])
    assert setup.source("wrist") == "pipe:/tmp/wrist.y4m"
    assert setup.source("left") == "left.mp4"
    assert setup.source("right").startswith("scene:")
    assert (setup.uplink.frame_octets, setup.downlink.frame_octets) == (40, 250)
    inputs = ("wrist", "left", "right", "ground_mic", "iss_camera", "iss_mic")
    assert setup.inputs == inputs
    assert setup.stream_of("iss_camera") is setup.downlink_video
    assert setup.stream_of("wrist") is setup.uplink_video
    kinds = [setup.kind_of(name) for name in setup.inputs]
    assert kinds == ["video", "video", "video", "audio", "video", "audio"]


def test_a_setup_without_a_name_takes_that_of_its_file(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text('cameras = ["static"]\nuplink_video = {cap_kbps = 50}\n')
    setup = load_setup(str(path))
    assert setup.name == "arm"
    assert [stream.name for stream in setup.streams] == ["uplink_video"]
    assert setup.inputs == ("static",)


@pytest.mark.parametrize(
    ("fields_of_it", "message"),
    [
        ("cap_kbps = inf", "uplink_video.cap_kbps is inf: .* finite"),
        ("cap_kbps = nan", "uplink_video.cap_kbps is nan: .* finite"),
        ("cap_kbps = 50\n[uplink_voice]\ncap_kbps = 6", "uplink_voice: a cap of 6 kbit/s: .* 6.24"),
        ("cap_kbps = 50\n[rtc]\nvideo_kbps = 50", "rtc: video_kbps of 50; take 100 to 20000"),
        ("cap_kbps = 50\n[rtc]\nvoice_kbps = 600", "rtc: voice_kbps of 600; take 6 to 128"),
        ("cap_kbps = 50\n[downlink_voice]\ncap_kbps = 129", "downlink_voice: .* 129 .* most 128"),
        ("cap_kbps = 50\ncoded = '800x600'", "coded as 800x600: take no larger size"),
        ("cap_kbps = 50\nstale_after_ms = 2", "uplink_video: stale after 2 ms; take 10 to"),
        ("cap_kbps = 50\nstale_after_ms = '1 s'", "uplink_video.stale_after_ms must be a number"),
        ('cap_kbps = 50\ncodec = "av1"', "uplink_video: codec 'av1': take one of h264, h265"),
        (
            'cap_kbps = 50\n[rtc]\n[downlink_video]\ncap_kbps = 300\ncodec = "h265"',
            'downlink_video: .* take codec = "h264"',
        ),
        ('cap_kbps = 50\nsize = "640"', "odd.toml: uplink_video.size '640': write WIDTHxHEIGHT"),
    ],
)
def test_an_impossible_value_is_named_with_its_field(tmp_path, fields_of_it, message):
    path = tmp_path / "odd.toml"
    path.write_text(f'cameras = ["static"]\n[uplink_video]\n{fields_of_it}\n')
    with pytest.raises(ConfigError, match=message):
        load_setup(str(path))


def test_an_age_limit_below_the_radio_delay_is_refused(tmp_path):
    path = tmp_path / "far.toml"
    path.write_text(
        'cameras = ["static"]\nradio = "geo"\n[uplink_video]\ncap_kbps = 50\nstale_after_ms = 200\n'
    )
    with pytest.raises(ConfigError, match="uplink_video: stale after 200 ms, but the radio takes"):
        load_setup(str(path))


@pytest.mark.parametrize("setup", BUILT_IN.values(), ids=BUILT_IN)
def test_the_built_in_setups_fit_their_channels(setup):
    caps = {stream.name: stream.cap_bps for stream in setup.streams}
    assert setup.need(Direction.UPLINK).payload_bps == sum(
        cap for name, cap in caps.items() if name.startswith("uplink")
    )
    assert setup.need(Direction.UPLINK).spare_bps >= 0
    assert setup.need(Direction.DOWNLINK).spare_bps >= 0
    assert setup.uplink.capacity_bps == 256_000
    assert setup.downlink.capacity_bps == 4_000_000


def test_the_caps_equal_the_specification():
    spacejustin = {stream.name: stream.cap_bps for stream in BUILT_IN["spacejustin"].streams}
    assert spacejustin == {
        "uplink_video": 85_000,
        "uplink_voice": 8_000,
        "downlink_video": 512_000,
        "downlink_voice": 64_000,
    }
    taskboard = {stream.name: stream.cap_bps for stream in BUILT_IN["taskboard"].streams}
    assert taskboard == {"uplink_video": 90_000}


def test_a_large_picture_takes_several_packets():
    spacejustin = BUILT_IN["spacejustin"]
    assert spacejustin.uplink_video.packets_per_s == 30
    assert spacejustin.downlink_video.packets_per_s == 90
    seldom = VideoStream(name="uplink_video", cap_bps=85_000, fps=1)
    assert seldom.packets_per_s == 11
    # At this low cap a packet of 1000 octets does not fit into 100 ms.
    assert VideoStream(name="uplink_video", cap_bps=20_000, fps=1).payload_octets == 375


def pus_octets_per_s(end):
    """The housekeeping of an end that is on from the start, with its tags."""
    total = 0.0
    for application in built_in_dictionary().applications:
        for structure in application.structures:
            if application.end == end and structure.on:
                values = sum(one.octets for one in application.named(structure.parameters))
                packet = MAX_PACKET_OCTETS - MAX_REPORT_OCTETS + 1 + values
                total += (TAG_OCTETS + RESUME_OCTETS + packet) / structure.interval_s
    return total


def test_reports_and_telemetry_of_a_session_fit_the_reserve():
    rtp = PromptSender(
        payload_type=96,
        clock_rate_hz=90_000,
        ssrc=1,
        first_sequence=0,
        timestamp_offset=0,
        cname=Segment.GROUND.cname,
    )
    rtp.audio_packets(b"\x08", CaptureStamp(0, 0, "test"))
    report = rtp.poll_report(0)
    octets_per_s = 2 * (TAG_OCTETS + len(report)) * 1e9 / REPORT_INTERVAL_NS
    # About a telecommand every ten seconds: accepted, started, completed.
    verification = MAX_PACKET_OCTETS - MAX_REPORT_OCTETS + 4
    octets_per_s += 3 * (TAG_OCTETS + RESUME_OCTETS + verification) / 10
    octets_per_s += pus_octets_per_s("ground")
    assert 0 <= RESERVE_BPS / 8 - octets_per_s <= 5
    # The telecommand.
    octets_per_s = 2 * (TAG_OCTETS + len(report)) * 1e9 / REPORT_INTERVAL_NS
    (select,) = built_in_dictionary().application("camera").parameters
    command = MAX_PACKET_OCTETS - MAX_COMMAND_OCTETS + 1 + select.octets
    octets_per_s += (TAG_OCTETS + RESUME_OCTETS + command) / 10
    octets_per_s += pus_octets_per_s("space")
    assert 0 <= RESERVE_DOWN_BPS / 8 - octets_per_s <= 5


def test_the_ports_are_below_the_ephemeral_ports_of_linux():
    setup = BUILT_IN["spacejustin"]
    assert setup.base_port + PORTS <= 32_768


def test_a_setup_cannot_be_changed_or_misused():
    setup = BUILT_IN["taskboard"]
    with pytest.raises(AttributeError):
        setup.base_port = 1
    with pytest.raises(ConfigError, match="no such input"):
        Setup(
            name="x",
            cameras=("static",),
            uplink_video=VideoStream(name="uplink_video", cap_bps=50_000),
            sources={"heda": "x.mp4"},
        )
    with pytest.raises(ConfigError, match="base port"):
        replace(setup, base_port=65_530)


def own_setup(**changes):
    video = VideoStream(name="uplink_video", cap_bps=50_000)
    return Setup(**{"name": "x", "cameras": ("static",), "uplink_video": video} | changes)


@pytest.mark.parametrize("name", ["iss_camera", "iss_mic", "ground_mic"])
def test_a_camera_with_the_name_of_another_input_is_refused(name):
    with pytest.raises(ConfigError, match=f"camera {name} .* rename it"):
        own_setup(cameras=("static", name))


def test_the_name_of_a_camera_does_not_make_it_a_microphone():
    setup = own_setup(cameras=("a_mic",), sources={"a_mic": "clip.mp4"})
    assert setup.kind_of("a_mic") == "video"
    with pytest.raises(ConfigError, match="no input iss_mic"):
        setup.kind_of("iss_mic")


def test_a_radio_is_a_profile_or_a_cable_with_a_delay(tmp_path):
    file = tmp_path / "storm.toml"
    file.write_text("delay_ms = 40\nframe_loss = 0.1\n")
    assert own_setup().radio_profile.longest_delay_ns == 0
    assert own_setup(radio=load_radio(str(file))).radio_profile.frame_loss == 0.1
    assert own_setup(radio_delay_ms=12.5).radio_profile.longest_delay_ns == 12_500_000
    with pytest.raises(ConfigError, match=r"radio geo has .* take radio cable"):
        own_setup(radio="geo", radio_delay_ms=12.5)
    with pytest.raises(ConfigError, match="unknown radio storm"):
        own_setup(radio="storm")


def test_a_direction_has_its_own_radio_from_the_same_seed():
    setup = own_setup(radio="geo")
    one, other = (
        setup.radio_path(profile, seed=3, epoch_ns=5).report()
        for profile in (setup.uplink, setup.downlink)
    )
    assert (one.channel.direction, other.channel.direction) == ("uplink", "downlink")


def test_a_mediated_hand_keeps_uplink_capacity_for_its_walls():
    direct = load_setup("spacejustin")
    mediated = load_setup("spacejustin", changes={"hand": "mediated"})
    # Two a second of 16 octets, with tag and resume tag.
    assert direct.need(Direction.UPLINK).spare_bps - mediated.need(
        Direction.UPLINK
    ).spare_bps == 8 * 2 * (16 + 1 + 1)
    assert mediated.need(Direction.DOWNLINK) == direct.need(Direction.DOWNLINK)
    with pytest.raises(ConfigError, match="hand 'soft': take one of direct, mediated"):
        load_setup("spacejustin", changes={"hand": "soft"})
