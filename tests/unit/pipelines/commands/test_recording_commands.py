"""`kontur-av info` and `recover`: what is refused is refused in one line, and nothing is lost."""

import os

import pytest
from mcap.writer import Writer
from recordings import Step, scanned, write

from pipelines.cli import main

WRITTEN = write([Step(100_000_000, count % 2, 0, b"12345") for count in range(20)])
TORN = WRITTEN.octets[:-500]


@pytest.fixture
def torn(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(TORN)
    return path


def refused(capsys, *words):
    """The one line with which a command is refused."""
    assert main([str(word) for word in words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("kontur-av: ")
    assert err.count("\n") == 1
    return err


def test_recover_writes_beside_the_torn_file_which_stays(torn, capsys):
    assert main(["recover", str(torn)]) == 0
    mended = torn.with_name("a.recovered.mcap")
    out = capsys.readouterr().out
    assert out.startswith(f"{mended}: ")
    assert torn.read_bytes() == TORN
    scan, found, _ = scanned(mended.read_bytes())
    assert scan.figures.sound
    assert found == scanned(TORN)[1]
    assert sorted(path.name for path in torn.parent.iterdir()) == ["a.mcap", mended.name]

    assert main(["recover", str(mended)]) == 0
    assert capsys.readouterr().out == f"{mended} is whole: there is nothing to mend\n"
    assert len(list(torn.parent.iterdir())) == 2


def test_recover_replaces_no_file_unless_told_to(torn, capsys):
    other = torn.with_name("other.mcap")
    other.write_bytes(b"precious")
    assert "exists: give another name, or --overwrite" in refused(
        capsys, "recover", torn, "--out", other
    )
    assert "is the torn recording itself" in refused(
        capsys, "recover", torn, "--out", torn, "--overwrite"
    )
    assert other.read_bytes() == b"precious"
    assert main(["recover", str(torn), "--out", str(other), "--overwrite"]) == 0
    assert scanned(other.read_bytes())[0].figures.sound


def test_recover_says_where_it_cannot_write(torn, capsys):
    nowhere = torn.parent / "none" / "b.mcap"
    assert f"{nowhere} cannot be written: No such file" in refused(
        capsys, "recover", torn, "--out", nowhere
    )
    assert "is a directory" in refused(capsys, "recover", torn, "--out", torn.parent)
    assert [path.name for path in torn.parent.iterdir()] == ["a.mcap"]


def test_a_write_that_fails_leaves_nothing_behind(torn, capsys, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert "cannot be written: No space left on device" in refused(capsys, "recover", torn)
    assert [path.name for path in torn.parent.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_recording_is_refused(command, tmp_path, capsys):
    path = tmp_path / "a.mcap"
    assert "cannot be read: No such file" in refused(capsys, command, path)
    assert "is no file" in refused(capsys, command, tmp_path)
    for octets in (b"", b"RIFF and more"):
        path.write_bytes(octets)
        assert "it is not an MCAP file" in refused(capsys, command, path)


def test_a_file_of_another_program_is_shown_but_not_mended(tmp_path, capsys):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="other 1.0")
        writer.add_message(writer.register_channel("/a", "json", 0), 1, b"{}", 1)
        writer.finish()
    assert "written by other 1.0, not by kontur-av" in refused(capsys, "recover", path)
    assert main(["info", str(path)]) == 0
    assert "not a recording of kontur-av" in capsys.readouterr().out


def test_info_shows_a_torn_recording(torn, capsys):
    assert main(["info", str(torn)]) == 0
    assert f"`kontur-av recover {torn}` mends it" in capsys.readouterr().out
