"""`python -m benchmarks`."""

import sys
from collections.abc import Sequence
from importlib import import_module

from benchmarks import BENCHMARKS
from pipelines.cli import CommandParser, exit_code


def make_parser() -> CommandParser:
    """The parser of all benchmarks."""
    parser = CommandParser(prog="python -m benchmarks", description="Measure beside others.")
    names = parser.add_subparsers(dest="name", required=True, metavar="NAME")
    for name, text in BENCHMARKS.items():
        command = names.add_parser(name, help=text, description=text)
        module = import_module(f"benchmarks.{name}.command")
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a benchmark; exit codes as of `kontur-av`."""

    def work() -> int:
        args = make_parser().parse_args(arguments)
        result: int = args.run(args)
        return result

    return exit_code(work, "benchmarks")


if __name__ == "__main__":
    sys.exit(main())
