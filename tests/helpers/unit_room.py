"""Keeps unit tests from starting processes and sessions."""

import multiprocessing.process
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from pipelines.virtual.session import Simulation

_DOORS = (
    (subprocess.Popen, "__init__"),
    (multiprocessing.process.BaseProcess, "start"),
    (os, "fork"),
    (os, "posix_spawn"),
    (Simulation, "__init__"),
)


@contextmanager
def closed_doors() -> Iterator[None]:
    """Within this context, starting a process or a simulation raises AssertionError."""
    opened = [getattr(owner, name) for owner, name in _DOORS]
    # Without unittest.mock, which does more for each of thousands of tests.
    for (owner, name), admission in zip(_DOORS, opened, strict=True):
        setattr(owner, name, _closed(owner, name, admission))
    try:
        yield
    finally:
        for (owner, name), admission in zip(_DOORS, opened, strict=True):
            setattr(owner, name, admission)


def _closed(owner, name, opened):
    def admission(*args, **options):
        # Python starts the system's linker to find a library.
        if sys._getframe(1).f_globals.get("__name__") == "ctypes.util":
            return opened(*args, **options)
        raise AssertionError(
            f"{owner.__name__}.{name} in a unit test: "
            "move it to tests/realtime (processes) or tests/sim (simulated sessions)"
        )

    return admission
