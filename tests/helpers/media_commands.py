"""`send` and `receive` as processes, and the programs of others beside them."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

import pytest

COMMAND = """
import argparse, importlib, sys
module = importlib.import_module("pipelines.commands." + sys.argv.pop(1))
parser = argparse.ArgumentParser()
module.add_arguments(parser)
sys.exit(module.run(parser.parse_args()))
"""


def needs(*elements: str) -> None:
    if shutil.which("gst-launch-1.0") is None:
        pytest.skip("gst-launch-1.0 is missing: install gstreamer1.0-tools")
    for element in elements:
        if subprocess.run(["gst-inspect-1.0", "--exists", element], check=False).returncode:
            pytest.skip(f"GStreamer has no {element}")


def needs_ffmpeg() -> None:
    if shutil.which("ffmpeg") is None:
        pytest.skip("ffmpeg is missing: install it")


def free_ports() -> int:
    """Return the first of two neighbouring UDP ports that are free."""
    for _ in range(50):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first:
            first.bind(("127.0.0.1", 0))
            port = first.getsockname()[1]
            with (
                contextlib.suppress(OSError, OverflowError),
                socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second,
            ):
                second.bind(("127.0.0.1", port + 1))
                return port
    raise AssertionError("no two free ports")


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
            ["timeout", "--kill-after=5", "60", *(str(part) for part in command)],
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
    size, until = 0, time.monotonic() + 10
    while size < octets and time.monotonic() < until and one.poll() is None:
        if (now := os.fstat(one.data.fileno()).st_size) > size:
            size, until = now, time.monotonic() + 2
        time.sleep(0.05)
    return _data(one)


def output_at_end(one) -> bytes:
    """The output of a player that ends by itself."""
    one.wait(timeout=30)
    return _data(one)


def _data(one) -> bytes:
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


def finish(process, seconds: float = 30) -> str:
    output, _ = process.communicate(timeout=seconds)
    assert process.returncode == 0, output
    return output


def wait_for_line(process, text: str) -> None:
    for line in process.stdout:
        if text in line:
            return
    raise AssertionError(f"never said {text!r}")


def wait_for_file(path) -> None:
    deadline = time.monotonic() + 10
    while not (path.exists() and path.stat().st_size):
        assert time.monotonic() < deadline
        time.sleep(0.05)
