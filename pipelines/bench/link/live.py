"""Punctuality of the slots on this machine, beside that of its kernel."""

import re
import shutil
import subprocess
from dataclasses import dataclass

from pipelines.bench.session import live_report
from pipelines.report.result import JsonReader

#: The end of `cyclictest`'s histogram, in µs; it counts later wake-ups apart.
_LONGEST_US = 20_000
#: How much longer than its run `cyclictest` may take to end.
_PATIENCE_S = 60


@dataclass(frozen=True)
class LoopPunctuality:
    """Of one periodic task of 1 ms, in µs after its deadlines: p50, p99, p99.9 and max.

    slips: deadlines that passed unused, of `cycles`; None where nothing counts them.
    """

    name: str
    lateness_us: dict[str, float]
    slips: int | None = None
    cycles: int | None = None


def live_punctuality(
    seconds: float, setup: str, *, media: bool, base_port: int
) -> list[LoopPunctuality]:
    """Run both gateways for `seconds`, with or without the whole session beside them.

    `cyclictest`, if it is installed and permitted, runs at the same time and comes first: with the
    same period, and with the gateways' real-time priority.
    """
    words = ["stream" if media else "link", "--setup", setup, "--base-port", str(base_port)]
    peer = _start_cyclictest(seconds)
    try:
        report = live_report(words, seconds=seconds)
    finally:
        figures = [] if peer is None else _finish_cyclictest(peer)
    return [*figures, *_gateways(report)]


def _gateways(report: JsonReader) -> list[LoopPunctuality]:
    found = []
    for end, direction in (("ground", "uplink"), ("space", "downlink")):
        link = report.at("link", direction)
        names = ("p50", "p99", "p99.9", "max")
        lateness_us = {name: link.number("lateness_us", name) for name in names}
        slips, frames = round(link.number("slips")), round(link.number("frames"))
        found.append(LoopPunctuality(f"{end} gateway", lateness_us, slips, frames))
    return found


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


def _finish_cyclictest(process: "subprocess.Popen[str]") -> list[LoopPunctuality]:
    output, _ = process.communicate(timeout=_PATIENCE_S)
    return [] if process.returncode else [parse_cyclictest(output)]


def parse_cyclictest(output: str) -> LoopPunctuality:
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
    return LoopPunctuality("cyclictest", figures, None, total + beyond)
