"""What tests of several rooms need: waiting, free ports, likeness of pictures."""

import os
import socket
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

T = TypeVar("T")

#: Protects against a hang; no result of a test depends on it.
PATIENCE_S = 90.0


def eventually(
    ask: Callable[[], T], what: str = "", patience_s: float = PATIENCE_S, pause_s: float = 0.02
) -> T:
    """Return the first true value of `ask()`; fail, naming `what`, after `patience_s`."""
    ends = time.monotonic() + patience_s
    while not (got := ask()):
        if time.monotonic() > ends:
            raise AssertionError(f"waited {patience_s:.0f} s for {what or 'an answer'}: {got!r}")
        time.sleep(pause_s)
    return got


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM, host: str = "127.0.0.1") -> int:
    """Return a free port of UDP, or of TCP with `socket.SOCK_STREAM`."""
    with socket.socket(socket.AF_INET, kind) as end:
        end.bind((host, 0))
        return end.getsockname()[1]


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
