"""What tests of several rooms need: waiting, free ports, likeness of pictures."""

import contextlib
import os
import socket
import time
import wave
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import TypeVar

import numpy as np

T = TypeVar("T")

#: Protects against a hang; no result of a test depends on it.
TIMEOUT_S = 90.0


def eventually(
    ask: Callable[[], T], what: str = "", timeout_s: float = TIMEOUT_S, pause_s: float = 0.02
) -> T:
    """Return the first true value of `ask()`; fail, naming `what`, after `timeout_s`."""
    ends = time.monotonic() + timeout_s
    while not (got := ask()):
        if time.monotonic() > ends:
            raise AssertionError(f"waited {timeout_s:.0f} s for {what or 'an answer'}: {got!r}")
        time.sleep(pause_s)
    return got


#: Of this process among those that run the tests.
WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
#: Ports that each worker gives away in turn. None is the kernel's to give to others meanwhile.
_PORTS, _FIRST = 2_000, 10_000
_turn = count(os.getpid() % _PORTS)


def free_port(
    kind: socket.SocketKind = socket.SOCK_DGRAM, host: str = "127.0.0.1", *, more: int = 0
) -> int:
    """Return a free port of UDP, or of TCP with `socket.SOCK_STREAM`, before `more` free ones."""
    for _ in range(_PORTS):
        port = _FIRST + WORKER % 4 * _PORTS + next(_turn) % (_PORTS - more)
        with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
            for each in range(port, port + 1 + more):
                stack.enter_context(socket.socket(socket.AF_INET, kind)).bind((host, each))
            for _ in range(more):
                next(_turn)
            return port
    raise AssertionError("no port is free")


def psnr_db(one: np.ndarray, other: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio of two pictures of uint8, of equal shape."""
    error = np.mean((one.astype(np.float32) - other.astype(np.float32)) ** 2)
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def repeats(count: int) -> int:
    """Return how often a random test repeats: `count` times KONTUR_TIMES of the nightly tier."""
    return count * int(os.environ.get("KONTUR_TIMES", "1"))


def first_seed(seed: int = 1) -> int:
    """Return the first seed of a random test: `seed`, in the nightly tier KONTUR_SEED."""
    return int(os.environ.get("KONTUR_SEED", seed))


def write_sound(path: Path, samples: np.ndarray) -> None:
    """Write a file of mono sound at 48 kHz."""
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 48_000, 0, "NONE", ""))
        file.writeframes(samples.astype("<i2").tobytes())


def write_tone(path: Path, hz: float, *, pauses: bool = False) -> None:
    """Write four seconds of a tone; with `pauses`, half a second of it in every second."""
    at = np.arange(4 * 48_000) / 48_000
    write_sound(path, np.sin(2 * np.pi * hz * at) * 12_000 * (at % 1 < 0.5 if pauses else 1))
