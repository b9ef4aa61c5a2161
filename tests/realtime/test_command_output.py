"""Standard output that is closed, full, without a reader, of another charset, or meant for data."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from synthetic_recording import write_recording

COMMANDS = [("devices",), ("topology", "--setup", "taskboard"), ("doctor",), ("stream", "--help")]


def start(*words, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli", *words], stderr=subprocess.PIPE, **options
    )


def ended(process) -> tuple[int, str]:
    said = process.stderr.read().decode()
    process.stderr.close()
    return process.wait(30), said


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_a_closed_output_or_a_reader_that_ends_is_no_failure(words):
    closed = start(*words, preexec_fn=lambda: os.close(1))
    assert ended(closed) == (0, "")
    ours, theirs = os.pipe()
    gone = start(*words, stdout=theirs)
    os.close(theirs)
    os.close(ours)
    assert ended(gone) == (0, "")


def test_a_sender_whose_reader_has_gone_ends_quietly():
    ours, theirs = os.pipe()
    words = ("--video", "scene:static", "--to", "127.0.0.1:9", "--cap-kbps", "100")
    process = start("send", *words, stdout=theirs)
    os.close(theirs)
    os.close(ours)
    assert ended(process) == (0, "")


@pytest.mark.parametrize("words", COMMANDS[:3], ids=lambda words: words[0])
def test_a_full_output_is_a_failure_with_one_line(words):
    with Path("/dev/full").open("wb") as full:
        assert ended(start(*words, stdout=full)) == (
            1,
            "kontur-av: No space left on device: free some room\n",
        )


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
@pytest.mark.parametrize("charset", ["latin-1", "ascii"])
def test_any_charset_takes_the_words(words, charset):
    environment = os.environ | {"PYTHONIOENCODING": f"{charset}:strict"}
    process = start(*words, stdout=subprocess.DEVNULL, env=environment)
    assert ended(process) == (0, "")


def test_a_report_on_standard_output_has_no_words_in_it(tmp_path):
    words = ["simulate", "--setup", "taskboard", "--no-media", "--radio", "clean"]
    path = tmp_path / "out.json"
    with path.open("wb") as out:
        process = start(*words, "--seconds", "0.1", "--report", "/dev/stdout", stdout=out)
        assert ended(process)[0] == 0
    text = path.read_text()
    assert text.startswith("{") and text.rstrip().endswith("}")


SHRINKS = """
import mmap, os, sys
real = mmap.mmap
def shrinks(fd, *words, **more):
    mapped = real(fd, *words, **more)
    os.truncate(f"/proc/self/fd/{fd}", 0)
    return mapped
mmap.mmap = shrinks
from pipelines.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("words", [["info"], ["recover"], ["export", "--csv", "out"]])
def test_a_recording_that_becomes_shorter_is_a_failure_with_one_line(words, tmp_path):
    write_recording(tmp_path / "a.mcap")
    command = [sys.executable, "-c", SHRINKS, words[0], "a.mcap", *words[1:]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("kontur-av: a file became shorter")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_an_export_that_is_ended_leaves_nothing(number, tmp_path):
    write_recording(tmp_path / "a.mcap")
    words = ["export", "a.mcap", "--csv", "out", "--lerobot", "set"]
    process = start(*words, stdout=subprocess.DEVNULL, cwd=tmp_path)
    until_s = time.monotonic() + 60
    while not [*tmp_path.glob("out/*.unfinished")] and time.monotonic() < until_s:
        time.sleep(0.001)
    child = children_of(process.pid)
    process.send_signal(number)
    assert ended(process) == (130, "")
    assert not [one for one in child if Path(f"/proc/{one}").exists()]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def children_of(pid) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
