"""The sessions that `bench latency` looks at: on virtual time and live, and the clock of each."""

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ConfigError
from pipelines.bench.children import end_all, ended_alike
from pipelines.commands.simulate import simulate
from pipelines.setup.table import Setup

#: How much longer than the session the command may take to start and to end.
_PATIENCE_S = 60
_READINGS = 2000
#: The user's mistake, as every command of the project says it.
_USERS_FAULT = 2


@dataclass(frozen=True, slots=True)
class Clock:
    """How instants were compared. method: in words; error_us: of a difference of two, at most."""

    method: str
    error_us: float


VIRTUAL_CLOCK = Clock("one virtual clock for all", 0.0)


def virtual_run(setup: Setup, *, seconds: float, seed: int) -> dict[str, Any]:
    """The report of a session on virtual time."""
    return simulate(setup, seconds=seconds, seed=seed)


def live_run(
    setup: str,
    *,
    seconds: float,
    seed: int,
    radio: str,
    base_port: int,
    deadband: str | None = None,
) -> dict[str, Any]:
    """The report of a session of the setup called `setup` on this machine.

    ConfigError, in the session's own words, when it could not begin.
    """
    with ended_alike(), TemporaryDirectory() as directory:
        report_file = Path(directory) / "report.json"
        command = [sys.executable, "-m", "pipelines.cli", "stream", "--setup", setup, "-q"]
        command += ["--seconds", f"{seconds:g}", "--seed", str(seed), "--radio", radio]
        command += ["--base-port", str(base_port), "--report", str(report_file)]
        command += [] if deadband is None else ["--deadband", deadband]
        errors = Path(directory) / "errors"
        with errors.open("wb") as stderr:
            # Its own session: Ctrl-C is for this process, which ends the other itself.
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                start_new_session=True,
            )
            try:
                returncode = process.wait(seconds + _PATIENCE_S)
            except subprocess.TimeoutExpired:
                raise RuntimeError(f"the live session has not ended after {seconds:g} s") from None
            finally:
                end_all([process])
        told = errors.read_text(encoding="utf-8", errors="replace").strip()
        if returncode == _USERS_FAULT:
            line = told.rpartition("\n")[2].removeprefix("kontur-av: ")
            raise ConfigError(f"live: {line} (or leave it out with --no-live)")
        if not report_file.exists():
            raise RuntimeError(f"the live session has failed: {told}")
        report: dict[str, Any] = json.loads(report_file.read_text(encoding="utf-8"))
    return report


def live_clock(report: Mapping[str, Any]) -> Clock:
    """The clock of a live session, and how far two of its readings may be off.

    That is what a reading takes, at p99, or the clock's resolution; and for pictures and sounds
    how far the capture time that travelled by RTCP was beside the one that was stamped.
    """
    readings = [time.monotonic_ns() for _ in range(_READINGS)]
    steps = sorted(after - before for before, after in pairwise(readings))
    resolution_ns = time.get_clock_info("monotonic").resolution * NS_PER_S
    reading_us = max(resolution_ns, steps[len(steps) * 99 // 100]) / NS_PER_US
    stamps = [stream["capture_stamp_error_us"] for stream in report["streams"].values()]
    error_us = reading_us + max(stamps, default=0.0)
    return Clock("CLOCK_MONOTONIC, one for all processes of the host", round(error_us, 2))


def radio_delay_ms(report: Mapping[str, Any]) -> tuple[float, float]:
    """The least and the longest delay of the radio, ground to space."""
    radio = report["gateways"]["ground"].get("radio")
    if radio is None:
        return 0.0, 0.0
    return radio["delay_min_ns"] / NS_PER_MS, radio["delay_max_ns"] / NS_PER_MS
