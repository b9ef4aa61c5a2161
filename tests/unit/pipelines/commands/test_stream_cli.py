"""Mistakes of a user: each gives one line that names the mend and exit 2, and starts nothing."""

import shutil
import socket
import tempfile
from types import SimpleNamespace

import pytest

from kontur_av.clock import MonotonicClock
from pipelines.cli import main, make_parser
from pipelines.commands import live_session, stream
from pipelines.session.options import radio_changes
from pipelines.session.setup.setup_file import load_setup

TOML = """
cameras = ["stereo", "static"]
[uplink_video]
cap_kbps = 85
"""


@pytest.fixture
def nothing_starts(monkeypatch):
    def start(*_, **__):
        pytest.fail("a session was started")

    monkeypatch.setattr(stream, "Launcher", start)


def refusal(capsys, *arguments):
    """The one line that a refused command prints."""
    assert main(list(arguments)) == 2
    out, error = capsys.readouterr()
    assert out == ""
    (line,) = error.splitlines()
    assert line.startswith("kontur-av: ")
    return line


def write(path, text):
    path.write_text(text)
    return str(path)


GROUND = ["--setup", "spacejustin", "--end", "ground", "--listen", "0.0.0.0:27000", "--insecure"]
SPACE = ["--setup", "spacejustin", "--end", "space", "--peer", "127.0.0.1:27000", "--insecure"]


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--setup", "spacejustine"], "spacejustin or taskboard, or a file"),
        (["--setup", "missing.toml"], "missing.toml: No such file"),
        (["--setup", "."], "or a file NAME.toml"),
        (["--setup", "taskboard", "--source", "head=scene:head"], "left, right, static"),
        (
            ["--setup", "taskboard", "--telemetry", "nowhere:Battery"],
            "there is no module 'nowhere'",
        ),
        (["--setup", "taskboard", "--source", "left"], "NAME=SPEC"),
        (["--setup", "taskboard", "--service", "ssh=2222"], "give --files DIR, too"),
        (["--setup", "taskboard", "--service", "ssh"], "NAME=PORT"),
        (["--setup", "taskboard", "--service", "ssh=70000"], "NAME=PORT"),
        (["--setup", "taskboard", "--service-allow", "../a=127.0.0.1:22"], "NAME=HOST:PORT"),
        (
            ["--setup", "taskboard", "--service", "ssh=2222", "--service", "ssh=2223"],
            "ssh is given twice",
        ),
        (
            ["--setup", "taskboard", "--files", ".", "--service", "ssh=2222"],
            "give --service-allow ssh=HOST:PORT, too",
        ),
        (["--setup", "taskboard", "--source", "=x"], "NAME=SPEC"),
        (["--setup", "taskboard", "--source", "left=missing.mp4"], "missing.mp4"),
        (["--setup", "taskboard", "--source", "left=scene:nosuch"], "choose one of"),
        (["--setup", "taskboard", "--source", "left=pipe:missing"], "mkfifo"),
        (["--setup", "taskboard", "--source", "left=v4l2:/dev/missing"], "/dev/missing"),
        (
            ["--setup", "taskboard", "--source", "left=v4l2:/dev/null"],
            "'/dev/null' cannot be opened",
        ),
        (
            [
                *("--setup", "taskboard", "--source", "left=v4l2:/dev/video0"),
                *("--source", "right=v4l2:/dev/../dev/video0"),
            ],
            "is that of input left",
        ),
        (["--setup", "taskboard", "--source", "left=alsa:hw"], "this input wants pictures"),
        (["--setup", "spacejustin", "--source", "iss_mic=v4l2:/dev/video0"], "wants sound"),
        (
            ["--setup", "taskboard", "--source", "static=page", "--no-page"],
            "input static: source page needs the pages: leave --no-page out",
        ),
        (["--setup", "taskboard", "--seconds", "0"], "--seconds 0"),
        (["--setup", "taskboard", "--seconds", "-3"], "--seconds"),
        (["--setup", "taskboard", "--seconds", "nan"], "--seconds nan"),
        (["--setup", "taskboard", "--seconds", "soon"], "--seconds"),
        (["--setup", "taskboard", "--radio-delay-ms", "-1"], "take 0 to 10000"),
        (["--setup", "taskboard", "--radio-delay-ms", "nan"], "take 0 to 10000"),
        (
            ["--setup", "taskboard", "--radio", "nosuch"],
            "take cable, clean, iss-pass, iss-overhead, geo, or a file NAME.toml",
        ),
        (["--setup", "taskboard", "--radio", "missing.toml"], "missing.toml: No such file"),
        (["--setup", "taskboard", "--radio", "geo", "--radio-delay-ms", "3"], "give one of them"),
        (
            ["--setup", "taskboard", "--radio-start", "10"],
            "radio cable has no pass to begin in; take radio iss-pass or iss-overhead, or leave",
        ),
        (
            ["--setup", "taskboard", "--radio", "iss-pass", "--radio-start", "600"],
            "the pass of radio iss-pass lasts 593 s; take less",
        ),
        (["--setup", "taskboard", "--radio", "iss-pass", "--radio-start", "nan"], "take less"),
        (
            ["--setup", "taskboard", "--radio-delay-ms", "9", "--radio-start", "1"],
            "leave the start out",
        ),
        (["--setup", "taskboard", "--seed", "x"], "--seed"),
        (
            ["--setup", "spacejustin", "--source", "wrist=scene:head"],
            "another camera needs a setup file of your own that names it in cameras",
        ),
        (["--setup", "taskboard", "--base-port", "80"], "1024"),
        (["--setup", "taskboard", "--base-port", "65535"], "1024"),
        (["--setup", "taskboard", "--report", "missing/r.json"], "--report missing/r.json"),
        (["--setup", "taskboard", "--report", "."], "--report"),
        (["--setup", "taskboard", "-v", "-q"], "-q"),
        (["--setup", "taskboard", "--listen", "0.0.0.0:27000"], "add --end ground or --end space"),
        ([*GROUND, "--joystick", "page"], "the joystick is in space; give it at --end space"),
        ([*GROUND, "--source", "iss_camera=page"], "iss_camera is captured at --end space; this"),
        ([*SPACE, "--source", "left=page"], "left is captured at --end ground; this end has iss_"),
        ([*SPACE, "--rtc"], "--rtc: a partner joins the ground; give it at --end ground"),
        ([*SPACE, "--ice-server", "turn:192.0.2.1"], "give it at --end ground"),
        ([*GROUND, "--radio", "iss-pass", "--trainer"], "give it at --end space with --trainer"),
        ([*SPACE, "--radio", "iss-pass"], "give it at --end space with --trainer, and none at"),
        (["--setup", "taskboard", "--page", "0"], "port from 1 to 65534"),
        (["--setup", "taskboard", "--page", "65535"], "port from 1 to 65534"),
        (["--setup", "taskboard", "--page", "localhost"], "[HOST:]PORT"),
        (["--setup", "taskboard", "--page", "192.0.2.1:8270"], "no address of this machine"),
        (["--setup", "taskboard", "--page", "no.such.invalid:8270"], "no.such.invalid"),
        (["--setup", "taskboard", "--page", "8270", "--no-page"], "--no-page"),
        (["--setup", "taskboard", "--no-page", "--open"], "--open needs the pages"),
        (["--setup", "taskboard", "--no-page", "--page-cert", "x"], "--page-cert needs the pages"),
        (["--setup", "taskboard", "--page-cert", "missing.pem"], "missing.pem: cannot be read"),
        (["--setup", "taskboard", "--files-rate", "8,8"], "--files-rate is for --files"),
        (["--setup", "taskboard", "--files", ".", "--files-rate", "8"], "give two rates"),
        (["--setup", "taskboard", "--files", "/proc/none"], "--files /proc/none"),
        (["--setup", "taskboard", "--leds", "panel:5000"], "give --tasks or --plan, too"),
        (["--setup", "taskboard", "--runs", "runs"], "--runs is for tasks"),
        (["--setup", "taskboard", "--tasks", "--leds", "panel"], "write HOST:PORT"),
        (["--setup", "taskboard", "--tasks", "missing.xml"], "missing.xml"),
        (["--setup", "taskboard", "--plan", "missing.toml"], "missing.toml"),
        (
            ["--setup", "taskboard", "--tasks", "--runs", "runs", "--record", "all.mcap"],
            "want the same recorder",
        ),
        (["--setup", "taskboard", "--second-robot", "arm:Left"], "has no partner's arm"),
        (["--setup", "taskboard", "--sources", "left=x"], "--help"),
        ([], "--setup"),
    ],
)
def test_impossible_options_are_refused(capsys, monkeypatch, tmp_path, options, says):
    monkeypatch.chdir(tmp_path)
    assert says in refusal(capsys, "stream", *options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cameras = [", "not TOML"),
        ("", "uplink_video and cameras"),
        (TOML.replace("cameras", "camera"), "unknown field camera"),
        (TOML + "colour = 3", "unknown field uplink_video.colour"),
        (TOML.replace("85", '"85"'), "uplink_video.cap_kbps must be a number"),
        (TOML.replace("85", "true"), "uplink_video.cap_kbps must be a number"),
        (TOML.replace("cap_kbps = 85", "fps = 30"), "needs cap_kbps"),
        (TOML + 'size = "640"', "WIDTHxHEIGHT"),
        (TOML + 'size = "641x480"', "641"),
        (TOML + 'size = "0x0"', "0"),
        (TOML + "fps = 0", "take 1 to 120"),
        (TOML.replace('"static"', '"a_camera_with_a_long_name"'), "a_camera_with_a_long_name"),
        (TOML.replace('"static"', '"static", "static"'), "twice"),
        (TOML.replace('"static"', '"wrist"'), "--source wrist=SPEC"),
        (TOML.replace('["stereo", "static"]', "[]"), "name at least one"),
        (TOML.replace('["stereo", "static"]', '"stereo"'), "list of names"),
        ("base_port = true\n" + TOML, "base_port must be a whole number"),
        ("sources = 3\n" + TOML, "sources must be a table"),
        ('sources = {head = "x.mp4"}\n' + TOML, "left, right, static"),
        ("uplink_voice = 8\n" + TOML, "table [uplink_voice]"),
        ("uplink = {frame_octets = 20}\n" + TOML, "frame"),
        ("downlink = {frame_octets = 100000}\n" + TOML, "frame"),
    ],
)
def test_impossible_setups_are_refused(capsys, tmp_path, text, says):
    path = write(tmp_path / "mine.toml", text)
    assert says in refusal(capsys, "stream", "--setup", path)


def test_the_suggested_mends_for_a_missing_source_work(capsys, tmp_path):
    wrist = 'cameras = ["wrist"]\nuplink_video = {cap_kbps = 85}\n'
    path = write(tmp_path / "mine.toml", wrist)
    line = refusal(capsys, "stream", "--setup", path)
    assert 'give --source wrist=SPEC, or wrist = "SPEC" in [sources] of the setup file' in line
    chosen = make_parser().parse_args(["stream", "--setup", path, "--source", "wrist=scene:head"])
    assert stream.chosen_setup(chosen).source("wrist") == "scene:head"
    path = write(tmp_path / "mine.toml", wrist + '[sources]\nwrist = "scene:left"\n')
    chosen = make_parser().parse_args(["stream", "--setup", path])
    assert stream.chosen_setup(chosen).source("wrist") == "scene:left"


def test_a_robot_brings_its_own_cameras_unless_the_user_names_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    write(
        tmp_path / "seeing_robot.py",
        "from telepresence.haptics.robot import RobotFacts\n"
        "class Arm:\n"
        "    facts = RobotFacts(name='arm', sources={'head': 'own:Eye', 'tail': 'own:Eye'})\n",
    )
    words = ["stream", "--setup", "spacejustin", "--robot", "seeing_robot:Arm"]
    assert stream.chosen_setup(make_parser().parse_args(words)).sources == {"head": "own:Eye"}
    words += ["--source", "head=scene:head"]
    chosen = stream.chosen_setup(make_parser().parse_args(words))
    assert chosen.source("head") == "scene:head"


@pytest.mark.parametrize("command", ["stream", "link", "simulate"])
def test_every_session_can_begin_in_the_middle_of_a_pass(command):
    options = ["--setup", "taskboard", "--radio", "iss-pass", "--radio-start", "200"]
    args = make_parser().parse_args([command, "--seconds", "1", *options])
    setup = load_setup(args.setup, changes=radio_changes(args), radio_start_s=args.radio_start)
    assert setup.radio_profile.start_s == 200
    assert setup.radio_profile.name == "iss-pass"


@pytest.mark.usefixtures("nothing_starts")
def test_a_cap_that_does_not_fit_is_refused_with_one_that_does(capsys, tmp_path):
    voice = "uplink_voice = {cap_kbps = 8}\n"
    path = write(tmp_path / "mine.toml", voice + TOML.replace("85", "95"))
    line = refusal(capsys, "stream", "--setup", path)
    assert "uplink_video" in line
    assert "95" in line
    fitting = [
        word.strip(",.;") for word in line.split() if word.strip(",.;").replace(".", "").isdigit()
    ]
    works = []
    for value in fitting:
        text = voice + TOML.replace("85", value)
        try:
            works.append(load_setup(write(tmp_path / "less.toml", text)).uplink_video.cap_bps)
        except Exception:
            continue
    # The number that it names works, and hardly more would.
    assert works, line
    assert 80_000 <= max(works) < 95_000
    text = voice + TOML.replace("85", f"{max(works) / 1000 + 1.5:g}")
    refusal(capsys, "stream", "--setup", write(tmp_path / "more.toml", text))


@pytest.mark.usefixtures("nothing_starts")
def test_files_without_media_are_refused(capsys, tmp_path):
    text = write(tmp_path / "notes.txt", "no film at all")
    assert "notes.txt" in refusal(
        capsys, "stream", "--setup", "taskboard", "--source", f"left={text}"
    )
    assert str(tmp_path) in refusal(
        capsys, "stream", "--setup", "taskboard", "--source", f"left={tmp_path}"
    )


@pytest.mark.usefixtures("nothing_starts")
def test_the_setup_decides_the_kind_of_an_input_not_its_name(capsys, tmp_path):
    path = write(
        tmp_path / "mine.toml",
        TOML.replace('"static"', '"a_mic"') + "[sources]\na_mic = 'scene:static'\n",
    )
    line = refusal(capsys, "stream", "--setup", path, "--source", "a_mic=alsa:hw")
    assert "this input wants pictures" in line
    setup = load_setup(path)
    stream.check_sources(setup, setup.inputs)
    stream.draw_backgrounds(setup, setup.inputs, MonotonicClock())


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("size", "options", "free_mb", "needed_mb"),
    [
        ("640x480", [], 40, 48),
        ("640x480", [], 64, None),
        ("2560x1440", ["--no-page"], 64, 190),
        ("2560x1440", [], 190, 246),
    ],
)
def test_too_little_shared_memory_is_refused(
    capsys, monkeypatch, tmp_path, size, options, free_mb, needed_mb
):
    usage = shutil.disk_usage(tmp_path)._replace(free=free_mb * 1_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    path = write(tmp_path / "mine.toml", TOML + f'size = "{size}"\n')
    if needed_mb is None:
        stream.check_room(load_setup(path), load_setup(path).inputs, pages=True)
    else:
        line = refusal(capsys, "stream", "--setup", path, *options)
        assert f"free {needed_mb} MB" in line
        assert "--shm-size" in line


@pytest.mark.usefixtures("nothing_starts")
def test_unwritable_places_are_refused(capsys, tmp_path):
    notes = write(tmp_path / "notes.txt", "")
    for option in ("--report", "--snapshots"):
        inside = f"{notes}/inside"
        assert option in refusal(capsys, "stream", "--setup", "taskboard", option, inside)


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize("option", ["--packets", "--frames", "--ros2", "--files-rate"])
def test_a_refused_option_leaves_no_directory_behind(capsys, tmp_path, option):
    shots = tmp_path / "shots"
    refusal(capsys, "stream", "--setup", "taskboard", "--snapshots", str(shots), option, "x")
    assert not shots.exists()


@pytest.mark.usefixtures("nothing_starts")
def test_a_busy_port_is_named(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        port = udp.getsockname()[1]
        base = min(port - 5, 65_496)
        line = refusal(capsys, "stream", "--setup", "taskboard", "--base-port", str(base))
    assert "--base-port" in line
    assert "busy" in line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "COMMAND"),
        (["nonsense"], "nonsense"),
        (["--nonsense"], "--help"),
        (["select"], "CAMERA"),
        (["select", "static"], "no session is running here"),
        (["select", "static", "--session", "mine"], "no session mine"),
        (["select", "static", "--session", "../../etc"], "session"),
        (["receive", "--sdp", "-s.sdp"], "--sdp=VALUE"),
        (["info", "-a.mcap"], "./NAME"),
    ],
)
def test_impossible_commands_are_refused(capsys, monkeypatch, arguments, says):
    # Not tmp_path, because a socket's path must be short. Sessions are looked for in there.
    with tempfile.TemporaryDirectory(prefix="kav") as directory:
        monkeypatch.setenv("TMPDIR", directory)
        assert says in refusal(capsys, *arguments)


def test_a_quiet_session_says_what_failed(capsys, monkeypatch):
    monkeypatch.setattr(
        live_session, "session_report", lambda *_: SimpleNamespace(failures=["why"])
    )
    collector = SimpleNamespace(handle_end=lambda: None, trace=None)
    args = SimpleNamespace(quiet=True, report=None)
    assert live_session.end_session(args, collector, None) == 1
    assert capsys.readouterr() == ("", "failed: why\n")


def test_version_is_printed(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("kontur-av 0.")


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--tasks", "own.xml"], "--plan names its files itself"),
        (["--leds", "127.0.0.1:5000"], "sees only the built-in LED panel"),
        (["--end", "ground", "--listen", "0.0.0.0:27000", "--insecure"], "on one machine only"),
    ],
)
def test_what_does_not_suit_a_plan_is_refused(capsys, tmp_path, options, says):
    plan = write(tmp_path / "plan.toml", '[[task]]\nname = "line"\n')
    words = ["stream", "--setup", "spacejustin", "--no-page", "--plan", plan, *options]
    assert says in refusal(capsys, *words)


@pytest.mark.parametrize("command", [["stream", "--no-page"], ["simulate", "--seconds", "1"]])
def test_a_task_of_two_hands_is_refused_where_there_is_one(capsys, tmp_path, command):
    plan = write(tmp_path / "plan.toml", '[[task]]\nname = "handshake"\n')
    words = [*command, "--setup", "spacejustin", "--plan", plan]
    assert "task handshake needs two hands" in refusal(capsys, *words)
