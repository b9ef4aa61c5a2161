"""Standard output that is closed, full, without a reader, of another charset, or meant for data."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from common import eventually
from synthetic_recording import write_recording

COMMANDS = [("topology", "--setup", "taskboard"), ("doctor",)]


def start(*words, program=("-m", "pipelines.cli"), **options):
    command = [sys.executable, *program, *words]
    return subprocess.Popen(command, stderr=subprocess.PIPE, **options)


def ended(process) -> tuple[int, str]:
    said = process.stderr.read().decode()
    process.stderr.close()
    return process.wait(90), said


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_a_closed_output_or_a_reader_that_ends_is_no_failure_and_a_full_one_is(words):
    closed = start(*words, preexec_fn=lambda: os.close(1))
    ours, theirs = os.pipe()
    gone = start(*words, stdout=theirs)
    os.close(theirs)
    os.close(ours)
    with Path("/dev/full").open("wb") as output:
        full = start(*words, stdout=output)
    assert ended(closed) == ended(gone) == (0, "")
    assert ended(full) == (1, "kontur-av: No space left on device: free some room\n")


def test_a_sender_whose_reader_has_gone_ends_quietly():
    ours, theirs = os.pipe()
    words = ("--video", "scene:static", "--to", "127.0.0.1:9", "--cap-kbps", "100")
    process = start("send", *words, stdout=theirs)
    os.close(theirs)
    os.close(ours)
    assert ended(process) == (0, "")


@pytest.mark.parametrize("charset", ["latin-1", "ascii"])
def test_any_charset_takes_the_words(charset):
    environment = os.environ | {"PYTHONIOENCODING": f"{charset}:strict"}
    each = [start(*words, stdout=subprocess.DEVNULL, env=environment) for words in COMMANDS]
    assert [ended(process) for process in each] == [(0, "")] * len(COMMANDS)


@pytest.mark.parametrize(
    "words",
    [
        ("watch", "--whep", "http://127.0.0.1:9/x", "--token", "s3cret"),
        ("watch", "--whep", "http://127.0.0.1:9/x", "--tok=s3cret"),
        ("apploader", "run", "dir", "--boot", "flash", "--ftp", "ftp://kontur:s3cret@127.0.0.1:9/"),
    ],
    ids=range(3),
)
def test_a_secret_of_the_command_line_is_not_in_the_list_of_processes(words, tmp_path):
    listed = "print(open('/proc/self/cmdline').read().replace('\\0', ' '))"
    called = (
        f"import sys, pipelines.cli as cli; cli._loaded = lambda *_, **__: {listed}; cli.main()"
    )
    process = start(*words, program=("-c", called), stdout=subprocess.PIPE, cwd=tmp_path)
    out = process.stdout.read().decode()
    ended(process)
    assert out.rstrip().endswith(" ".join(words).replace("s3cret", "xxxxxx"))


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


@pytest.mark.parametrize("words", [["info"], ["export", "--csv", "out"]])
def test_a_recording_that_becomes_shorter_is_a_failure_with_one_line(words, tmp_path):
    write_recording(tmp_path / "a.mcap")
    command = [sys.executable, "-c", SHRINKS, words[0], "a.mcap", *words[1:]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("kontur-av: a file became shorter")
    assert done.stderr.count("\n") == 1


#: Its tables do not end by themselves.
ENDLESS = """
import sys, time
from pipelines.recording.export import table_files
table_files.CsvFile.close = lambda file: time.sleep(90)
from pipelines.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_export_that_is_ended_leaves_nothing(number, tmp_path):
    write_recording(tmp_path / "a.mcap")
    words = ["export", "a.mcap", "--csv", "out", "--lerobot", "set"]
    process = start(*words, program=("-c", ENDLESS), stdout=subprocess.DEVNULL, cwd=tmp_path)
    eventually(lambda: [*tmp_path.glob("out/*.unfinished")], "a table", pause_s=0.001)
    child = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(number)
    assert ended(process) == (130, "")
    assert not [one for one in child if Path(f"/proc/{one}").exists()]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
