"""What a session is made of: sources, and the shared memory that it needs."""

import re
import shutil

import pytest
from positions import ROOT

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.cli import main, make_parser
from pipelines.commands import stream
from pipelines.session.options import stream_options
from pipelines.session.setup.setup_file import load_setup

TOML = 'cameras = ["stereo", "{}"]\n[uplink_video]\ncap_kbps = 85\n'


def chosen(*words):
    return stream.chosen_setup(stream_options(make_parser("stream").parse_args(["stream", *words])))


def test_the_suggested_mends_for_a_missing_source_work_and_a_camera_called_a_mic_films(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TOML.format("wrist"))
    fix = r'give --source wrist=SPEC, or wrist = "SPEC" in \[sources\] of the setup file'
    with pytest.raises(ConfigError, match=fix):
        chosen("--setup", str(path))
    named = chosen("--setup", str(path), "--source", "wrist=scene:head")
    assert named.source("wrist") == "scene:head"
    path.write_text(TOML.format("wrist") + '[sources]\nwrist = "scene:left"\n')
    assert chosen("--setup", str(path)).source("wrist") == "scene:left"
    path = tmp_path / "mine.toml"
    path.write_text(TOML.format("a_mic") + "[sources]\na_mic = 'scene:static'\n")
    setup = load_setup(str(path))
    stream.check_sources(setup, setup.inputs)
    stream.draw_backgrounds(setup, setup.inputs, MonotonicClock())


def test_a_robot_brings_its_own_cameras_unless_the_user_names_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "seeing_robot.py").write_text(
        "from telepresence import RobotFacts\n"
        "class Arm:\n"
        "    facts = RobotFacts(name='arm', sources={'head': 'own:Eye', 'tail': 'own:Eye'})\n",
    )
    words = ["--setup", "spacejustin", "--robot", "seeing_robot:Arm"]
    assert chosen(*words).sources == {"head": "own:Eye"}
    assert chosen(*words, "--source", "head=scene:head").source("head") == "scene:head"


def test_the_documented_site_is_explained_without_secrets_and_nothing_is_made(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "setup-file.md").read_text(encoding="utf-8")
    for name, text in re.findall(r"```toml\n# (common|lab)\.toml(.*?)```", page, re.DOTALL):
        (tmp_path / f"{name}.toml").write_text(f"#{text}")
    (tmp_path / "token").write_text("nobody-sees-this-one\n")
    (tmp_path / "token").chmod(0o600)
    before = sorted(tmp_path.iterdir())
    words = ["--rtc", "--rtc-token-file", "token", "--files", "files", "--snapshots", "shots"]
    assert main(["stream", "lab.toml", "--explain", *words]) == 0
    printed = capsys.readouterr().out
    for row in (
        "record off lab.toml",
        "foxglove 8765 common.toml",
        "source.head scene:head common",
    ):
        assert re.search(row.replace(" ", " +"), printed)
    assert re.search(r"rtc_token_file +token +command line", printed)
    assert "nobody" not in printed and sorted(tmp_path.iterdir()) == before


def test_the_short_help_has_what_newcomers_need_and_the_long_one_all(capsys):
    for option, has, lacks in (
        ("-h", "--no-page", "--part-mb"),
        ("--help-all", "--part-mb", "--no-seed"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["stream", option])
        printed = capsys.readouterr().out
        assert end.value.code == 0 and has in printed and lacks not in printed


@pytest.mark.parametrize(
    ("size", "pages", "free_mb", "needed_mb"),
    [
        ("640x480", True, 40, 48),
        ("640x480", True, 64, None),
        ("2560x1440", False, 64, 190),
        ("2560x1440", True, 190, 246),
    ],
)
def test_too_little_shared_memory_is_refused(
    monkeypatch, tmp_path, size, pages, free_mb, needed_mb
):
    usage = shutil.disk_usage(tmp_path)._replace(free=free_mb * 1_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    (tmp_path / "mine.toml").write_text(TOML.format("static") + f'size = "{size}"\n')
    setup = load_setup(str(tmp_path / "mine.toml"))
    if needed_mb is None:
        stream.check_room(setup, setup.inputs, pages=pages)
        return
    with pytest.raises(ConfigError, match=f"free {needed_mb} MB.*--shm-size"):
        stream.check_room(setup, setup.inputs, pages=pages)
