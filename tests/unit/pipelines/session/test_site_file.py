"""Site files: they hold what a command line can, include others, and are refused as a whole."""

import re
from pathlib import Path
from typing import Literal, get_origin

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import make_parser
from pipelines.session.options import OPTIONS, StreamOptions, asked_setup, flag, kinds_of
from pipelines.session.site_file import blamed, site_options

SETUP = 'setup = "taskboard"\n'


@pytest.fixture
def site(tmp_path, monkeypatch):
    """Write files, and return what the last one and the words ask for."""
    monkeypatch.chdir(tmp_path)

    def read(files, *words):
        for name, text in files.items():
            Path(name).parent.mkdir(exist_ok=True)
            Path(name).write_text(text)
        return site_options(make_parser("stream").parse_args(["stream", *[*files][-1:], *words]))

    return read


def example(name):
    """An option on the command line, and in a file."""
    kind, what = kinds_of(name)[0], OPTIONS[name].metadata["metavar"]
    if kind is bool:
        return [flag(name)], "true"
    if get_origin(kind) is Literal:
        return [
            flag(name),
            "direct" if name == "hand" else "ground",
        ], '"ground"'
    if what.startswith("NAME="):
        return [flag(name), "a=b:1"], '{a = "b:1"}'
    if get_origin(kind) is tuple:
        return [flag(name), "/a:B"], '["/a:B"]'
    return ([flag(name), "7"], "7") if kind in (int, float) else ([flag(name), "/a:7"], '"/a:7"')


@pytest.mark.parametrize("name", sorted(OPTIONS))
def test_every_option_can_be_in_a_file_and_be_taken_back(site, name):
    words, value = example(name)
    if name in ("hand", "force", "deadband", "repair", "path", "record_cameras"):
        choices = {"hand": "auto", "force": "none", "path": "compact", "record_cameras": "all"}
        words[1] = choices.get(name, "off")
        value = f'"{words[1]}"'
    by_command = site({}, *words).options
    assert by_command != StreamOptions()
    read = site({"a.toml": f"{name} = {value}\n"})
    assert read.options == by_command
    assert {setting.origin for setting in read.settings.values()} == {"a.toml"}
    back = {"b.toml": f'include = "a.toml"\n{name} = false\n'}
    off = StreamOptions(page=False) if name == "page" else StreamOptions()
    assert (
        site(back).options
        == site({"a.toml": f"{name} = {value}\n"}, f"--no-{name}".replace("_", "-")).options
        == off
    )


def test_the_nearer_file_wins_and_the_command_line_over_all_with_paths_from_each_file(site):
    files = {
        "all/base.toml": 'record = "x.mcap"\nquiet = true\nradio = "geo"\nrobot = "udp:h:1:key"\n'
        'telemetry = ["a:B"]\n[source]\nleft = "pipe:p"\nright = "page"\n'
        '[setup]\ncameras = ["stereo"]\nuplink_video = {cap_kbps = 50}\n'
        "uplink_voice = {cap_kbps = 8}\n",
        "all/metrics.toml": 'include = "base.toml"\nmetrics = true\n',
        "lab.toml": 'include = ["all/base.toml", "all/metrics.toml"]\nverbose = true\n'
        'telemetry = ["c:D"]\nradio_delay_ms = 3\nsource.right = "scene:right"\n'
        "[setup]\nuplink_voice = false\nuplink_video.fps = 25\n",
    }
    read = site(files, "--source", "right=scene:left", "--no-metrics")
    given = read.options
    assert given.record == Path("all/x.mcap") and given.robot == "udp:h:1:all/key"
    assert (given.verbose, given.quiet, given.radio, given.metrics) == (True, False, None, None)
    assert (given.telemetry, given.radio_delay_ms) == (("c:D",), 3)
    assert set(given.source) == {"left=pipe:all/p", "right=scene:left"}
    setup = asked_setup(given)
    assert setup.uplink_voice is None
    assert (setup.name, setup.uplink_video.cap_bps, setup.uplink_video.fps) == ("lab", 50_000, 25)
    rows = dict(re.findall(r"^(\S+) +\S+ +(.*)$", read.explained(setup), re.MULTILINE))
    assert rows["record"] == rows["setup.uplink_video.cap_kbps"] == "all/base.toml"
    assert rows["setup.uplink_video.fps"] == rows["setup.radio_delay_ms"] == "lab.toml"
    assert rows["metrics"] == rows["setup.sources.right"] == "command line"
    assert rows["joystick"] == rows["setup.hand"] == "default"
    assert site(files, "--setup", "spacejustin").options.setup == "spacejustin"


@pytest.mark.rule("7")
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("robto = 1", "a.toml: unknown field robto: the nearest one is robot"),
        ("no_page = true", "a.toml: unknown field no_page: write page = false"),
        ("cameras = []", r"a.toml: cameras is of a setup: write it in \[setup\]"),
        ('seconds = "20"', "a.toml: seconds must be a number, not '20'"),
        ('hand = "soft"', "a.toml: hand must be one of adaptive, direct, mediated, auto, not"),
        ("record = 5", "a.toml: record must be a path in quotes, not 5"),
        ("telemetry = 5", "a.toml: telemetry must be a list of texts in quotes, not 5"),
        ("files_rate = 8", r"a.toml: files_rate must be two numbers, like \[8, 200\], not 8"),
        ("source = {left = 5.5}", "a.toml: source.left must be a text in quotes, not 5.5"),
        ('radio = "geo"\nradio_delay_ms = 3', "a.toml: --radio and --radio-delay-ms: give one"),
        ("include = 5", "a.toml: include must be a file or a list of files"),
        ('include = "none.toml"', "a.toml: include none.toml: there is no such file"),
        ('include = "none\\u0000.toml"', "there is no such file"),
        ('include = "a.toml"', "a.toml: include a.toml: it includes this file"),
        ("seconds = \nx = 1", r"a.toml is not TOML: .*\(at line 1"),
        ("", '--setup is missing: give it, or setup = "NAME" in a site file'),
        ('setup = "none"', "a.toml: setup: unknown setup none: take spacejustin or taskboard"),
        ("[setup]\ncameras = ['static']", "a.toml: setup: a setup needs uplink_video"),
        (SETUP + 'radio = "none"', "a.toml: radio: unknown radio none: take cable"),
        (SETUP + "source = {a = 'page'}", "a.toml: source.a: source a: setup taskboard has no"),
    ],
)
def test_a_mistake_is_named_with_file_field_and_what_would_fit(site, text, says):
    with pytest.raises(ConfigError, match=says):
        read = site({"a.toml": text})
        with blamed(read.settings):
            asked_setup(read.options)


def test_a_mistake_of_the_command_line_is_not_blamed_on_a_file(site):
    read = site({"a.toml": SETUP + 'robot = "sim"'}, "--radio", "sim")
    with pytest.raises(ConfigError, match=r"^unknown radio sim"), blamed(read.settings):
        asked_setup(read.options)
