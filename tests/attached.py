"""What programs of others at a session cost it: pairs of sessions, with all of them and without.

    python tests/attached.py [--pairs 5] [--seconds 20] [--equal]

prints p99 of the uplink picture's latency and of the uplink's slot lateness. The others are a
reader of the packets, a ROS 2 node that takes pictures, poses and figures, Foxglove's client with
all channels, and Prometheus once a second. They would run on other machines, so here they have the
least share of the cores; with --equal they have as much as the session.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).parent / "helpers"))

import attached_programs
from attached_programs import OURS, free_ports, options
from foxglove_client import address
from running_session import RunningSession

TOPICS = (
    "/kontur_av/camera/static/compressed",
    *(f"/kontur_av/{end}/{kind}" for end in ("tip", "handle") for kind in ("pose", "wrench")),
    *("/kontur_av/handle/joy", "/diagnostics"),
)


def give_way():
    """Run when nothing else of the machine wants a core, with all that is started from here."""
    os.setsid()
    # A session of the kernel is a group with a share of its own, in which `nice` alone counts.
    group = Path("/proc/self/autogroup")
    if group.exists():
        group.write_text("19")
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def run(directory, seconds, *, attached, equal):
    """The report of a session."""
    directory.mkdir()
    words = ("taskboard", "--seconds", str(seconds))
    if not attached:
        with RunningSession(*words, directory=directory) as session:
            return checked(*session.end())
    ports = free_ports()
    command = [sys.executable, attached_programs.__file__, json.dumps(ports), directory / "others"]
    others = subprocess.Popen(
        [*command, *TOPICS],
        preexec_fn=os.setsid if equal else give_way,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert others.stdout.readline() == "ready\n"
        with RunningSession(*words, *options(ports), directory=directory) as session:
            others.stdin.write(address(session) + "\n")
            others.stdin.flush()
            assert others.stdout.readline() == "data\n"
            return checked(*session.end())
    finally:
        others.stdin.close()
        others.wait(20)


def checked(code, report):
    assert code == 0, report["failures"]
    return report


def figures(report):
    """By name."""
    stream, link = report["streams"]["uplink_video"], report["link"]["uplink"]
    return {
        "uplink picture, p50 (ms)": stream["latency_ms"]["p50"],
        "uplink picture, p99 (ms)": stream["latency_ms"]["p99"],
        "slot lateness, p50 (µs)": link["lateness_us"]["p50"],
        "slot lateness, p99 (µs)": link["lateness_us"]["p99"],
        "CPU (s)": sum(one["cpu_s"] for one in report["processes"].values()),
    }


def main():
    parser = argparse.ArgumentParser(description="what programs of others cost a session")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--equal", action="store_true", help="the others have an equal share")
    args = parser.parse_args()
    pairs = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.pairs):
            # Each comes first in every second pair.
            order = (False, True) if number % 2 == 0 else (True, False)
            reports = {
                attached: run(
                    Path(folder) / f"{number}{attached}",
                    args.seconds,
                    attached=attached,
                    equal=args.equal,
                )
                for attached in order
            }
            pairs.append((figures(reports[False]), figures(reports[True])))
            ours = {name: reports[True]["processes"][name]["cpu_s"] for name in OURS}
            print(
                *(
                    f"{name} {value:.4g} and {pairs[-1][1][name]:.4g};"
                    for name, value in pairs[-1][0].items()
                ),
                f"CPU of ours (s): {ours}",
                flush=True,
            )
    print("| | without | with | with / without |\n|---|--:|--:|--:|")
    for name in pairs[0][0]:
        rows = [(one[name], other[name], other[name] / one[name]) for one, other in pairs]
        cells = [
            f"{median(column):.3g} ({min(column):.3g} to {max(column):.3g})"
            for column in zip(*rows, strict=True)
        ]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
