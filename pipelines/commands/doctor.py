"""`kontur-av doctor`: check that this machine has what a session needs, and name the fix."""

import argparse
from collections.abc import Callable, Sequence

from pipelines.session.machine_checks import CHECKS, Check, checked


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Try what a session needs. One line a check: ok; missing, so that no session can run "
        "(exit code 1); or advice."
    )


def run(args: argparse.Namespace) -> int:
    return doctor()


def doctor(print: Callable[[str], None] = print, checks: Sequence[Check] | None = None) -> int:
    """Print one line a check; 0 when nothing that a session needs is missing, else 1."""
    missing = 0
    for name, check in CHECKS if checks is None else checks:
        verdict = checked(check)
        missing += verdict.state == "missing"
        fix = f": {verdict.fix}" if verdict.fix else ""
        print(f"{verdict.state:<8} {name:<15} {verdict.found}{fix}")
    print("a session can run" if not missing else f"a session cannot run: {missing} missing")
    return 1 if missing else 0
