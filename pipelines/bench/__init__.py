"""`kontur-av bench`: figures of the user's own machine and link.

A bench is a module of its name with `add_arguments(parser)` and `run(args)`; that of `video`, in a
folder, is `command.py`.
A bench that ran exits with 0, also if a target of latency or quality is missed: it shows the miss.
It exits with 1 if a claim of correctness does not hold or a session failed. Comparisons with peers
are no part of the package: `benchmarks/` in the repository has them.
"""

import argparse
from importlib import import_module
from types import ModuleType

from pipelines.session.option_rows import add_actions

#: What can be measured, and what it is about.
BENCHES = {
    "cpu": "CPU time of a live session, also beside another checkout of the project",
    "latency": "one page: every stream of a setup, end to end and by stage, and what is in it",
    "link": "the radio link: punctuality and cost on this machine",
    "path": "a network between two ends on this machine, such as lte; it measures nothing itself",
    "sync": "how far sight, hearing and touch lie apart, from what they show; also of recordings",
    "video": "pictures through a thin channel: latency, quality, rate and cost",
}


def _module(bench: str) -> ModuleType:
    return import_module(f"pipelines.bench.{'video.command' if bench == 'video' else bench}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    benches = {name: (text,) for name, text in BENCHES.items()}
    for name, command in add_actions(parser, benches, "bench").items():
        _module(name).add_arguments(command)


def run(args: argparse.Namespace) -> int:
    result: int = _module(args.bench).run(args)
    return result
