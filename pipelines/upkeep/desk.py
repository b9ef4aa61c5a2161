"""One keeper of a directory, and orders of other commands to it.

A lock says whether a keeper runs. An order is a file that the keeper answers by another.
"""

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kontur_av.errors import ConfigError

_LOCK, _ORDER, _ANSWER = ".lock", ".order", ".answer"
_PATIENCE_S = 20.0
_POLL_S = 0.05
_LARGEST_ORDER = 4096


@contextmanager
def kept(directory: Path) -> Iterator[bool]:
    """Keep a directory while this lasts; yield whether nobody else does."""
    directory.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(descriptor)


def answer_order(directory: Path, act: Callable[[str], None]) -> None:
    """Do an order that waits, if there is one, and answer it."""
    order = directory / _ORDER
    try:
        with order.open() as file:
            text = file.read(_LARGEST_ORDER)
        order.unlink()
    except (OSError, UnicodeDecodeError):
        return
    answer = ""
    try:
        act(text)
    except ConfigError as error:
        answer = str(error)
    with suppress(OSError):
        _replace(directory / _ANSWER, answer)


def give_order(directory: Path, order: str) -> None:
    """Let the keeper do an order. Raises ConfigError with its answer, or if none comes."""
    answer = directory / _ANSWER
    answer.unlink(missing_ok=True)
    _replace(directory / _ORDER, order)
    until_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until_s:
        if answer.exists():
            text = answer.read_text()
            answer.unlink(missing_ok=True)
            if text:
                raise ConfigError(text)
            return
        time.sleep(_POLL_S)
    (directory / _ORDER).unlink(missing_ok=True)
    raise ConfigError(f"what runs in {directory} does not answer: is it stopped?")


def _replace(path: Path, text: str) -> None:
    unfinished = path.with_name(f"{path.name}.{os.getpid()}")
    unfinished.write_text(text)
    unfinished.replace(path)
