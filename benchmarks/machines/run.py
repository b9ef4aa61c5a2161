"""A session on two hosts: both commands, and the joined report."""

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.machines.hosts import Hosts
from pipelines.link.key_files import make_key, trust
from pipelines.report.result import JsonReader
from pipelines.session.children import end_all, ended_alike
from pipelines.session.setup.segments import Segment

_PORT = 27_900
#: How much longer than the session both commands may take to start and to end.
_PATIENCE_S = 60
#: How much longer the ground runs.
_LONGER_S = 3


def split_report(
    words: Sequence[str], hosts: Hosts, *, seconds: float, protected: bool = True
) -> tuple[JsonReader, dict[Segment, JsonReader]]:
    """The joined report of `kontur-av stream` with `words` on two hosts, and each end's own.

    RuntimeError when an end failed. The session has `seconds` s after both ends have begun.
    """
    with ended_alike(), TemporaryDirectory() as name:
        directory = Path(name)
        keys = _keys(directory)
        ends: dict[Segment, subprocess.Popen[bytes]] = {}
        reports = {segment: directory / f"{segment.value}.json" for segment in Segment}
        errors = {segment: directory / f"{segment.value}.txt" for segment in Segment}
        try:
            for segment in Segment:
                ground = segment is Segment.GROUND
                where = ["--listen", f"0.0.0.0:{_PORT}"]
                if not ground:
                    where = ["--peer", f"{hosts.ground}:{_PORT}"]
                command = [*hosts.prefixes[segment], sys.executable, "-m", "pipelines.cli", *words]
                command += ["--end", segment.value, *where, "-q"]
                command += ["--key", str(keys[segment])] if protected else ["--insecure"]
                command += ["--base-port", str(hosts.base_ports[segment])]
                # Space ends first, while the ground still hears it.
                lasts_s = seconds + _LONGER_S if ground else seconds
                command += ["--seconds", f"{lasts_s:g}", "--report", str(reports[segment])]
                with errors[segment].open("wb") as stderr:
                    ends[segment] = subprocess.Popen(
                        command,
                        stdin=subprocess.DEVNULL,
                        stdout=subprocess.DEVNULL,
                        stderr=stderr,
                        # This process takes Ctrl-C and ends the others.
                        start_new_session=True,
                    )
            for process in ends.values():
                process.wait(seconds + _PATIENCE_S)
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"an end has not ended after {seconds:g} s") from None
        finally:
            for process in ends.values():
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
            end_all(list(ends.values()))
        for segment, path in reports.items():
            if not path.exists():
                said = errors[segment].read_text(encoding="utf-8", errors="replace").strip()
                raise RuntimeError(f"the {segment.value} end failed: {said}")
        joined = subprocess.run(
            [sys.executable, "-m", "pipelines.cli", "report", "join", *map(str, reports.values())],
            capture_output=True,
            text=True,
        )
        if joined.returncode:
            raise RuntimeError(f"the reports cannot be joined: {joined.stderr.strip()}")
        own = {
            segment: JsonReader(json.loads(path.read_text(encoding="utf-8")))
            for segment, path in reports.items()
        }
        return JsonReader(json.loads(joined.stdout)), own


def _keys(directory: Path) -> dict[Segment, Path]:
    """A key an end; each trusts the other."""
    paths = {segment: directory / f"{segment.value}.pem" for segment in Segment}
    identities = {segment: make_key(path).identity for segment, path in paths.items()}
    for segment, path in paths.items():
        trust(path, identities[segment.peer])
    return paths
