"""`send` and `receive` as processes, and the programs of others beside them."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time

from common import TIMEOUT_S, eventually

COMMAND = """
import argparse, importlib, sys
module = importlib.import_module("pipelines.commands." + sys.argv.pop(1))
parser = argparse.ArgumentParser()
module.add_arguments(parser)
sys.exit(module.run(parser.parse_args()))
"""


@contextlib.contextmanager
def started(*command: object):
    process = subprocess.Popen(
        [str(part) for part in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    with _ended(process):
        yield process


@contextlib.contextmanager
def player(*command: object, stdin=subprocess.DEVNULL):
    """A program whose output is data, however much; `output_of` returns it."""
    with tempfile.TemporaryFile() as data:
        process = subprocess.Popen(
            ["timeout", "--kill-after=5", "100", *(str(part) for part in command)],
            stdin=stdin,
            stdout=data,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        process.data = data
        with _ended(process):
            yield process


def output_of(one, octets: int) -> bytes:
    """The output of a player, once it ends, has so many octets, or grows no more."""
    size, until = 0, time.monotonic() + TIMEOUT_S
    while size < octets and time.monotonic() < until and one.poll() is None:
        if (now := os.fstat(one.data.fileno()).st_size) > size:
            size, until = now, time.monotonic() + 15
        time.sleep(0.05)
    _kill(one)
    one.data.seek(0)
    return one.data.read()


@contextlib.contextmanager
def _ended(process):
    try:
        yield
    finally:
        _kill(process)
        process.communicate()


def _kill(process) -> None:
    """End it and what it has started: some players end at no other signal."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def ours(name: str, *options: object):
    return started(sys.executable, "-c", COMMAND, name, *options)


def finish(process, seconds: float = TIMEOUT_S) -> str:
    output, _ = process.communicate(timeout=seconds)
    assert process.returncode == 0, output
    return output


def wait_for_line(process, text: str) -> None:
    for line in process.stdout:
        if text in line:
            return
    raise AssertionError(f"never said {text!r}")


def wait_for_file(path) -> None:
    eventually(lambda: path.exists() and path.stat().st_size, f"{path.name}")
