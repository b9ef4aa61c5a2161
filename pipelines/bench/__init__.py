"""`kontur-av bench`: reproducible figures, compared with a peer's where there is one.

A bench is a folder of its name whose `command.py` has `add_arguments(parser)` and `run(args)`.
A bench that ran exits with 0, also if a target of latency or quality is missed: it shows the miss.
It exits with 1 if a claim of correctness does not hold or a session failed.
"""

import argparse
from importlib import import_module

#: What can be measured, and what it is about.
BENCHES = {
    "all": "every bench, often enough to know its spread, and the page of measurements",
    "cpu": "CPU time of a live session, also beside another checkout of the project",
    "fanout": "one picture to many processes: cost of publishing, and how soon it is there",
    "haptics": "the hand on virtual time: energy, force and stability over a grid of radios",
    "latency": "one page: every stream of a setup, end to end and by stage, and what is in it",
    "link": "the radio link: delays on virtual time, punctuality and cost on this machine",
    "machines": "a session on two machines beside the same session on one",
    "page": "the browser pages: topic to pixel beside WebRTC, pointer to hand, cost of a session",
    "passes": "many sessions of a whole pass on virtual time, and whether each was usable",
    "record": "a recording: what a kill and a cut file lose, and what it costs the session",
    "replay": "one recorded session over several links on virtual time, and what they change",
    "rtc": "the leg to a partner: capture to a browser's pixel, reception, what the radio notices",
    "sync": "how far sight, hearing and touch lie apart, from what they show; also of recordings",
    "tasks": "passes in which a simulated cosmonaut does the tasks of a plan, on virtual time",
    "video": "pictures through a thin channel: latency, quality, rate and cost, beside GStreamer's",
    "voice": "speech through a lossy network: mouth to ear, rate and quality, beside GStreamer's",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """A command for each bench."""
    benches = parser.add_subparsers(dest="bench", required=True, metavar="BENCH")
    for name, text in BENCHES.items():
        command = benches.add_parser(name, help=text, description=text)
        import_module(f"pipelines.bench.{name}.command").add_arguments(command)


def run(args: argparse.Namespace) -> int:
    """Run the chosen bench."""
    result: int = import_module(f"pipelines.bench.{args.bench}.command").run(args)
    return result
