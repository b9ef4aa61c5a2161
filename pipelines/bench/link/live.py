"""How punctual the slots are on this machine, beside what its kernel can do."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

#: Of `cyclictest`, in µs: what is later is counted apart.
_LONGEST_US = 20_000
#: How much longer than the run a command may take to start and to end.
_PATIENCE_S = 60


@dataclass(frozen=True)
class Punctuality:
    """Of one periodic task of 1 ms, in µs after its deadlines: p50, p99, p99.9 and max.

    name: whose. slips: deadlines that passed unused, of `cycles`; None where nobody counts them.
    """

    name: str
    lateness_us: dict[str, float]
    slips: int | None = None
    cycles: int | None = None


def live_punctuality(
    seconds: float, setup: str, *, media: bool, base_port: int
) -> list[Punctuality]:
    """Run both gateways for `seconds`, with or without the whole session beside them.

    `cyclictest`, if it is installed and permitted, runs at the same time and comes first: with the
    same period, and with the gateways' real-time priority.
    """
    with TemporaryDirectory() as directory:
        report_file = Path(directory) / "report.json"
        command = [sys.executable, "-m", "pipelines.cli", "stream" if media else "link"]
        command += ["--setup", setup, "--seconds", f"{seconds:g}", "--report", str(report_file)]
        command += ["--base-port", str(base_port), "-q"]
        peer = _start_cyclictest(seconds)
        try:
            subprocess.run(command, check=False, timeout=seconds + _PATIENCE_S)
        finally:
            figures = [] if peer is None else _finish_cyclictest(peer)
        report = json.loads(report_file.read_text(encoding="utf-8"))
    return [*figures, *_gateways(report)]


def _gateways(report: dict[str, Any]) -> list[Punctuality]:
    return [
        Punctuality(
            f"{end} gateway",
            {name: link["lateness_us"][name] for name in ("p50", "p99", "p99.9", "max")},
            link["slips"],
            link["frames"],
        )
        for end, link in (
            ("ground", report["link"]["uplink"]),
            ("space", report["link"]["downlink"]),
        )
    ]


def _start_cyclictest(seconds: float) -> "subprocess.Popen[str] | None":
    program = shutil.which("cyclictest")
    if program is None:
        return None
    command = [program, "--threads=1", "--priority=10", "--interval=1000", "--quiet"]
    command += ["--mlockall", f"--duration={max(1, round(seconds))}", f"--histogram={_LONGEST_US}"]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
        text=True,
    )


def _finish_cyclictest(process: "subprocess.Popen[str]") -> list[Punctuality]:
    output, _ = process.communicate(timeout=_PATIENCE_S)
    return [] if process.returncode else [parse_cyclictest(output)]


def parse_cyclictest(output: str) -> Punctuality:
    """The figures of a run with a histogram of one thread; ValueError if there are none."""
    bins = [(int(us), int(count)) for us, count in re.findall(r"^(\d+) (\d+)$", output, re.M)]
    total = sum(count for _, count in bins)
    largest = re.search(r"^# Max Latencies: (\d+)", output, re.M)
    overflows = re.search(r"^# Histogram Overflows: (\d+)", output, re.M)
    if not total or largest is None:
        raise ValueError("cyclictest printed no histogram")
    beyond = int(overflows[1]) if overflows else 0
    figures: dict[str, float] = {}
    for name, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999)):
        wanted = share * (total + beyond)
        seen = 0
        for us, count in bins:
            seen += count
            if seen >= wanted:
                figures[name] = float(us)
                break
        else:
            figures[name] = float(largest[1])
    figures["max"] = float(largest[1])
    return Punctuality("cyclictest", figures, None, total + beyond)
