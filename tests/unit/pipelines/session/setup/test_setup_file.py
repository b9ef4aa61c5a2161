"""Setups of files: every field, and one line for each value that cannot work."""

import math
import tomllib
from copy import deepcopy
from dataclasses import asdict, fields
from datetime import date
from functools import reduce
from operator import getitem

import pytest

from kontur_av.errors import ConfigError
from pipelines.session.setup.composition import Composition
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import Playback, RtcLeg, Setup
from telepresence.haptics.envelope import SafetyLimits
from telepresence.haptics.robot import Mark

EVERY_FIELD = """
name = "wrist"
cameras = ["wrist", "stereo", "both"]
composed = {both = {compose = ["wrist", "left"], layout = "inset", share = 0.25}}
radio = "cable"
radio_delay_ms = 12.5
deadband = "latency"
repair = "idle"
path = "compact"
path_batch_ms = 2
hand = "mediated"
force = "felt"
command_hz = 125
press_ratio = 1.5
axes = ["x", "pan"]
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
least_fps = 18
least_cap_kbps = 20.5
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

[playback]
ground = "pulse:headset"

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

[axis.pan]
kind = "rotary"
mode = "rate"
scale = -2.0
speed = 0.5

[downlink]
frame_octets = 250

[marks.bin]
x_m = 0.1
y_m = 0.02

[safety]
resume_within_s = 0.2
slow_m_s = 0.05
"""
TABLES = {
    "cameras": ("wrist", "stereo", "both"),
    "composed": {"both": Composition(compose=("wrist", "left"), layout="inset", share=0.25)},
    "region_points": {"wrist": ((40, 30), (280, 33.5), (300, 210), (25, 205))},
    "marks": {"bin": Mark(x_m=0.1, y_m=0.02)},
    "playback": Playback(ground="pulse:headset"),
    "rtc": RtcLeg(video_bps=900_000, voice_bps=24_000, taken_bps=700_000),
    "safety": SafetyLimits(resume_within_s=0.2, slow_m_s=0.05),
    "inputs": ("wrist", "left", "right", "ground_mic", "operator_camera", "operator_mic"),
}
STREAMS = {
    "uplink_video": {"cap_bps": 62_500, "width": 320, "height": 240, "fps": 25}
    | {
        "prefer": "latency",
        "stale_after_ms": 250.5,
        "coded": (160, 120),
        "codec": "h265",
        "least_fps": 18,
        "least_cap_bps": 20_500,
    },
    "uplink_voice": {"cap_bps": 6_400, "stale_after_ms": 90},
    "downlink_video": {"cap_bps": 300_000, "width": 800, "height": 600, "fps": 15}
    | {
        "prefer": "quality",
        "stale_after_ms": None,
        "coded": None,
        "codec": "h264",
        "least_fps": 20,
        "least_cap_bps": None,
    },
    "downlink_voice": {"cap_bps": 24_000, "stale_after_ms": None},
}


def load(tmp_path, text, name="mine.toml"):
    (tmp_path / name).write_text(text)
    return load_setup(str(tmp_path / name))


def test_every_field_of_a_file_reaches_the_setup_and_without_a_name_it_takes_the_files(tmp_path):
    setup = load(tmp_path, EVERY_FIELD)
    for entry in fields(Setup):
        assert f"{entry.name}" in EVERY_FIELD, f"{entry.name} is not in the file of this test"
    for name, value in (tomllib.loads(EVERY_FIELD) | TABLES).items():
        if name in TABLES or not isinstance(value, dict):
            assert getattr(setup, name) == (tuple(value) if isinstance(value, list) else value)
    assert {one.name: asdict(one) for one in setup.streams} == {
        name: {"name": name, **values} for name, values in STREAMS.items()
    }
    # Without a value in the file: the radio's delay, 100 ms and four periods.
    ages_ms = {stream.name: setup.stale_after_ns(stream) / 1e6 for stream in setup.streams}
    assert [*ages_ms.values()] == pytest.approx([250.5, 90, 112.5 + 4000 / 15, 112.5 + 80])
    assert setup.source("wrist") == "pipe:/tmp/wrist.y4m"
    assert setup.source("left") == "left.mp4"
    assert setup.source("right").startswith("scene:")
    assert (setup.uplink.frame_octets, setup.downlink.frame_octets) == (40, 250)
    assert setup.stream_of("operator_camera") is setup.downlink_video
    assert setup.stream_of("wrist") is setup.uplink_video
    kinds = [setup.kind_of(name) for name in setup.inputs]
    assert kinds == ["video", "video", "video", "audio", "video", "audio"]
    text = 'cameras = ["static"]\nuplink_video = {cap_kbps = 50}\n'
    setup = load(tmp_path, text, "arm.toml")
    assert setup.name == "arm"
    assert [stream.name for stream in setup.streams] == ["uplink_video"]
    assert setup.inputs == ("static",)


#: Before, in and after the table of the uplink's video.
TOML = 'cameras = ["stereo", "static"]\n[uplink_video]\ncap_kbps = 85\n'
STATIC = '"static"'
OWN, END = "composed.static = {compose = ", "}\n" + TOML


@pytest.mark.rule("6")
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cameras = [", "not TOML"),
        ("", "uplink_video and cameras"),
        (TOML.replace("cameras", "camera"), "unknown field camera"),
        (TOML.replace("85", '"85"'), "uplink_video.cap_kbps must be a number"),
        (TOML.replace("cap_kbps = 85", "fps = 30"), "needs cap_kbps"),
        (TOML + "colour = 3", "unknown field uplink_video.colour"),
        (TOML + 'size = "640"', "mine.toml: uplink_video.size '640': write WIDTHxHEIGHT"),
        (TOML + 'size = "641x480"', "641"),
        (TOML + "fps = 0", "take 1 to 120"),
        ("press_ratio = 0.9\n" + TOML, "press_ratio is 0.9: take 1 to 10"),
        (TOML + "coded = '800x600'", "coded as 800x600: take no larger size"),
        (TOML + "least_cap_kbps = 5", "uplink_video: least cap of 5 kbit/s; take 10 to the cap"),
        (TOML + "stale_after_ms = 2", "uplink_video: stale after 2 ms; take 10 to"),
        (f'radio = "geo"\n{TOML}stale_after_ms = 200', "stale after 200 ms, but the radio takes"),
        (TOML + 'codec = "av1"', "uplink_video: codec 'av1': take one of h264, h265"),
        (f'{TOML}[rtc]\n[downlink_video]\ncap_kbps = 300\ncodec = "h265"', 'take codec = "h264"'),
        (TOML + "[uplink_voice]\ncap_kbps = 6", "uplink_voice: a cap of 6 kbit/s: .* 6.24"),
        (TOML + "[downlink_voice]\ncap_kbps = 129", "downlink_voice: .* 129 .* most 128"),
        (TOML + "[rtc]\nvideo_kbps = 50", "rtc: video_kbps of 50; take 100 to 20000"),
        (TOML.replace(STATIC, '"a_camera_with_a_long_name"'), "a_camera_with_a_long_name"),
        (TOML.replace(STATIC, '"static", "static"'), "twice"),
        (TOML.replace(STATIC, '"wrist"'), "--source wrist=SPEC"),
        (TOML.replace('["stereo", "static"]', "[]"), "name at least one"),
        (TOML.replace('["stereo", "static"]', STATIC), "list of texts"),
        (OWN + "['static', 'left']" + END, "composed.static: static is composed itself: name cam"),
        (OWN + "['stereo', 'left']" + END, "composed.static: stereo is composed itself: name"),
        (OWN + "['left', 'right'], size = 2" + END, "unknown field composed.static.size"),
        (OWN + "3" + END, "composed.static.compose must be a list of texts in quotes, not 3"),
        ("composed.static = 3\n" + TOML, "composed must be a table of tables, like work = "),
        (OWN + "['left', 'left']" + END, "compose takes two cameras"),
        (OWN + "['left', 'roof']" + END, "input roof .* --source roof=SPEC"),
        (
            OWN + "['left', 'right'], layout = 'grid'" + END,
            "layout 'grid': take one of merged,",
        ),
        (OWN + "['left', 'right'], share = 0.01" + END, "share 0.01: take 0.05 to 0.5"),
        (
            f"{OWN}['left', 'right'], layout = 'inset'{END}size = '48x32'",
            "of 14x10 pixels is too small: take a larger share, or",
        ),
        (f"composed.roof.compose = ['left', 'right']\n{TOML}", "cameras does not name it: add it"),
        (f"composed.stereo.compose = ['left', 'right']\n{TOML}", "give yours another name"),
        ('playback.space = "jack:x"\nuplink_voice.cap_kbps = 7\n' + TOML, "write default, alsa:DE"),
        (
            'playback.ground = "default"\n' + TOML,
            r"no downlink_voice to play: add \[downlink_voice",
        ),
        ("sources = 3\n" + TOML, "sources must be a table"),
        ('sources = {head = "x.mp4"}\n' + TOML, "left, right, static"),
        ("uplink_voice = 8\n" + TOML, r"table \[uplink_voice\]"),
        ("uplink = {frame_octets = 20}\n" + TOML, "frame"),
    ],
)
def test_an_impossible_value_is_named_with_its_field(tmp_path, text, says):
    with pytest.raises(ConfigError, match=says) as error:
        load(tmp_path, text)
    assert "\n" not in str(error.value)


def test_a_cap_that_does_not_fit_is_refused_with_one_that_does(tmp_path):
    def capped(kbps):
        return load(tmp_path, f"uplink_voice = {{cap_kbps = 8}}\n{TOML.replace('85', f'{kbps:g}')}")

    with pytest.raises(ConfigError, match=r"uplink_video.* 95 ") as error:
        capped(95)
    words = [word.strip(",.;") for word in str(error.value).split()]
    fitting = [float(word) for word in words if word.replace(".", "").isdigit()]
    # The number that it names works, and hardly more would.
    most = max(number for number in fitting if 80 <= number < 95)
    assert capped(most).uplink_video.cap_bps == round(most * 1000)
    with pytest.raises(ConfigError):
        capped(most + 1.5)


def places(table, before=()):
    for name, value in table.items():
        yield (*before, name)
        if isinstance(value, dict):
            yield from places(value, (*before, name))


def test_a_value_of_any_kind_in_any_place_is_taken_or_refused_in_one_line():
    odd = (3, 3.0, -1, True, 1e308, math.nan, 10**30, "", "x", "é" * 300, [], [1], ["x", "x"])
    odd += ([[1, 2]], [{}], {}, {"x": 1}, {"x": {"y": []}}, date(2015, 8, 1))
    every = tomllib.loads(EVERY_FIELD)
    for place in places(every):
        for value in odd:
            table = deepcopy(every)
            reduce(getitem, place[:-1], table)[place[-1]] = value
            try:
                load_setup(table)
            except ConfigError as error:
                assert len(str(error).splitlines()) == 1, (place, value)
