"""`kontur-av bench fanout`: every way delivers whole pictures, and leaves nothing behind."""

import json
import multiprocessing
import tempfile
from pathlib import Path

import pytest

from benchmarks.fanout import command as fanout
from benchmarks.fanout.run import fan_out
from benchmarks.fanout.ways import PICTURE_OCTETS, TopicWay, noise, read_stamp, stamp_picture
from pipelines.cli import main

SHARED_MEMORY = Path("/dev/shm")


@pytest.fixture
def nothing_left(monkeypatch, tmp_path):
    # Not tmp_path itself, which may be too deep for sockets.
    with tempfile.TemporaryDirectory(prefix="kav") as directory:
        monkeypatch.setattr(tempfile, "tempdir", directory)
        before = ours(SHARED_MEMORY)
        yield
        assert ours(SHARED_MEMORY) <= before
        assert multiprocessing.active_children() == []
        left = [path for path in Path(directory).iterdir() if any(path.glob("*"))]
        assert left == []


def ours(directory):
    # Other tests may have sessions of their own at the same time.
    names = {path.name for path in directory.iterdir()}
    return {name for name in names if name.startswith("shmpipe")}


def test_a_picture_that_was_overwritten_halfway_is_torn():
    picture = noise()
    stamp_picture(picture, 5, 7)
    assert read_stamp(picture) == (5, 7, True)
    stamped = picture.copy()
    stamp_picture(picture, 6, 8)
    picture[PICTURE_OCTETS // 2 :] = stamped[PICTURE_OCTETS // 2 :]
    assert read_stamp(picture) == (6, 8, False)


def test_the_command_prints_tables_and_writes_figures(nothing_left, tmp_path, capsys):
    report, plot = tmp_path / "figures.json", tmp_path / "times.png"
    command = ["bench", "fanout", "--seconds", "0.2", "--readers", "2"]
    assert main([*command, "--report", str(report), "--plot", str(plot)]) == 0
    assert plot.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    figures = json.loads(report.read_text())
    ways = {"topic, copied", "topic, in place", "mp.Queue"}
    if figures["skipped"] is None:
        ways.add("GStreamer shm")
    else:
        assert f"not measured: {figures['skipped']}" in printed
    assert {one["way"] for one in figures["runs"]} == ways
    for one in figures["runs"]:
        assert one["way"] in printed
        assert one["readers"] == 2
        assert one["torn"] == 0
        # Six pictures for each of two readers; a slow machine may lose some of them.
        assert 0 <= one["missed"] < 12
        for what in ("publish_us", "publish_cpu_us", "delivery_us", "fast_publish_us"):
            assert 0 < one[what]["p50"] <= one[what]["p99"] <= one[what]["max"]


def test_without_gstreamer_the_other_ways_are_measured(nothing_left, monkeypatch, capsys):
    monkeypatch.setattr(fanout, "lacking", lambda: "no shmsink here")
    found = fan_out(TopicWay(in_place=True), 1, seconds=0.1, fast_s=0.05)
    monkeypatch.setattr(fanout, "fan_out", lambda *_, **__: found)
    assert main(["bench", "fanout", "--readers", "1"]) == 0
    assert "not measured: no shmsink here" in capsys.readouterr().out


class FailingWay(TopicWay):
    """Its second reader does not start."""

    def reading_end(self, reader):
        if reader == 1:
            raise SystemExit(3)
        return super().reading_end(reader)


def test_a_reader_that_fails_ends_the_bench(nothing_left, monkeypatch):
    with pytest.raises(RuntimeError, match="has failed"):
        fan_out(FailingWay(in_place=True), 2, seconds=0.1, fast_s=0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seconds", "0"], "--seconds 0"),
        (["--readers", "0"], "--readers 0"),
        (["--readers", "1,17"], "from 1 to 16"),
        (["--readers", "1,"], "--readers 1,"),
        (["--report", "/nowhere/at/all.json"], "--report"),
        (["--plot", "times.jpeg"], "--plot times.jpeg"),
    ],
)
def test_mistakes_are_one_line(options, message, capsys):
    assert main(["bench", "fanout", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
