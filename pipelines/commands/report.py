"""`kontur-av report join`: one report of a session on two machines."""

import argparse
from pathlib import Path

import msgspec

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.report.join import join_reports
from pipelines.report.model import SessionReport, from_json, to_json
from pipelines.session.output import print_data
from pipelines.session.setup.setup_file import setup_from_text
from pipelines.table import topology_of

#: A day's report has 600 MB.
_MOST_OCTETS = 1 << 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = (
        "write to standard output the report that the session would have given on one machine, "
        "from the reports of `kontur-av stream --end ground` and `--end space`"
    )
    join = actions.add_parser("join", help=text, description=text)
    join.add_argument("ground", type=Path, metavar="GROUND.json", help="the report of one end")
    join.add_argument("space", type=Path, metavar="SPACE.json", help="the report of the other end")


def run(args: argparse.Namespace) -> int:
    """0 with the joined report on standard output."""
    first, second = _read(args.ground), _read(args.space)
    try:
        joined = join_reports(first, second, read_setup=setup_from_text, table_of=topology_of)
    except ProtocolError as error:
        raise ConfigError(f"{args.ground}, {args.space}: damaged: {error}") from None
    print_data(to_json(joined))
    return 0


def _read(path: Path) -> SessionReport:
    try:
        if path.stat().st_size > _MOST_OCTETS:
            raise ConfigError(f"{path}: larger than any report; name the report of an end")
        return from_json(path.read_bytes(), SessionReport)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (msgspec.DecodeError, RecursionError) as error:
        raise ConfigError(
            f"{path}: no report of a session ({error}); name the file of `stream --end … --report`"
        ) from None
