"""Kills the recorder of live sessions at random instants."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from benchmarks.record.record_metrics import Kill, kill_of, scan_part
from kontur_av.errors import ConfigError
from pipelines.recording.part_files import part_path
from pipelines.session.command_process import end_all, ended_alike

#: A session for so many kills at most, so that none becomes too long.
_KILLS_A_SESSION = 20
#: A start of the recorder that is killed, from its first octets on.
_LIFE_S = (0.7, 2.5)
_TIMEOUT_S = 30.0
_NAME = "kav recorder"


def kills(setup: str, count: int, *, seed: int, base_port: int) -> Iterator[Kill]:
    """Kill a recorder `count` times; RuntimeError if a session or its recorder does not go on."""
    random = Random(seed)
    while count > 0:
        some = min(count, _KILLS_A_SESSION)
        yield from _session(setup, some, random, base_port)
        count -= some


def _session(setup: str, count: int, random: Random, base_port: int) -> Iterator[Kill]:
    with ended_alike(), TemporaryDirectory() as name:
        path, errors = Path(name) / "kills.mcap", Path(name) / "errors"
        command = [sys.executable, "-m", "pipelines.cli", "stream", "--setup", setup, "-q"]
        command += ["--no-page", "--base-port", str(base_port), "--record", str(path)]
        with errors.open("wb") as stderr:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                start_new_session=True,
            )
            try:
                killed = [
                    _kill(process, part_path(path, number + 1), random) for number in range(count)
                ]
                _await(process, part_path(path, count + 1))
                time.sleep(_LIFE_S[0])
                process.send_signal(signal.SIGINT)
                process.wait(_TIMEOUT_S)
            except (RuntimeError, subprocess.TimeoutExpired) as error:
                text = errors.read_text(encoding="utf-8", errors="replace").strip()
                if process.poll() == 2:
                    raise ConfigError(
                        text.rpartition("\n")[2].removeprefix("kontur-av: ")
                    ) from None
                raise RuntimeError(f"{error}; {text}") from None
            finally:
                end_all([process])
        parts = [
            scan_part(memoryview(part_path(path, number + 1).read_bytes()))
            for number in range(count + 1)
        ]
        for instant_ns, torn, after in zip(killed, parts, parts[1:], strict=False):
            yield kill_of(instant_ns, torn, after)


def _kill(process: subprocess.Popen[bytes], path: Path, random: Random) -> int:
    """Kill the recorder some time after a part has begun; when, on the session's clock."""
    _await(process, path)
    time.sleep(random.uniform(*_LIFE_S))
    pid = _recorder(process.pid)
    if pid is None:
        raise RuntimeError("the session has no recorder")
    killed_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    return killed_ns


def _await(process: subprocess.Popen[bytes], path: Path) -> None:
    """Wait until there are messages in a part."""
    end_s = time.monotonic() + _TIMEOUT_S
    while not path.exists() or path.stat().st_size < 20_000:
        if process.poll() is not None:
            raise RuntimeError("the session has ended")
        if time.monotonic() > end_s:
            raise RuntimeError(f"nothing was recorded to {path.name}")
        time.sleep(0.02)


def _recorder(launcher: int) -> int | None:
    children = Path(f"/proc/{launcher}/task/{launcher}/children").read_text().split()
    for pid in children:
        try:
            if Path(f"/proc/{pid}/comm").read_text().strip() == _NAME:
                return int(pid)
        except OSError:
            continue
    return None
