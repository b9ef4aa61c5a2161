"""`kontur-av recover` makes a whole recording of a torn one, and loses nothing."""

import os

import pytest
from recordings import Step, scanned, write

from pipelines.cli import main

TORN = write([Step(100_000_000, count % 2, 0, b"12345") for count in range(20)]).octets[:-500]


@pytest.fixture
def torn(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(TORN)
    return path


def test_recover_writes_beside_the_torn_file_which_stays(torn, capsys):
    assert main(["info", str(torn)]) == 0
    assert f"`kontur-av recover {torn}` fixes it" in capsys.readouterr().out
    assert main(["recover", str(torn)]) == 0
    repaired = torn.with_name("a.recovered.mcap")
    assert capsys.readouterr().out.startswith(f"{repaired}: ")
    assert torn.read_bytes() == TORN
    scan, found, _ = scanned(repaired.read_bytes())
    assert scan.metrics.sound
    assert found == scanned(TORN)[1]
    assert main(["recover", str(repaired)]) == 0
    assert capsys.readouterr().out == f"{repaired} is whole: there is nothing to fix\n"
    assert sorted(path.name for path in torn.parent.iterdir()) == ["a.mcap", repaired.name]


def test_recover_replaces_a_file_if_told_to_and_a_write_that_fails_leaves_nothing(
    torn, capsys, monkeypatch
):
    other = torn.with_name("other.mcap")
    other.write_bytes(b"precious")
    assert main(["recover", str(torn), "--out", str(other), "--overwrite"]) == 0
    assert scanned(other.read_bytes())[0].metrics.sound

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert main(["recover", str(torn)]) == 2
    assert "cannot be written: No space left on device" in capsys.readouterr().err
    assert {path.name for path in torn.parent.iterdir()} == {"a.mcap", "other.mcap"}
