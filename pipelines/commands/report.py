"""`kontur-av report`: an account of a session, or one report of a session on two machines."""

import argparse
import json
from pathlib import Path

import msgspec

from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.report.account import account_of
from pipelines.report.join import join_reports
from pipelines.report.model import SessionReport, from_json, to_json
from pipelines.report.report_file import WordsConsole, write_text
from pipelines.report.schema import schema_of
from pipelines.report.summary import print_summary
from pipelines.session.command_process import print_data
from pipelines.session.option_rows import add_options
from pipelines.session.setup.setup_file import setup_from_text
from pipelines.session.setup.table import NO_RADIO, Setup
from pipelines.table import topology_of

#: A day's report has 600 MB.
_MOST_OCTETS = 1 << 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "report FILE.json <?>  of a session, whose summary is shown; or the word join",
        "ends GROUND.json SPACE.json <...>  after join: of `stream --end ground` and `--end "
        "space`; their joined report goes to standard output",
        "--html  write FILE.html beside the report: what fell short, what happened, charts",
        "--schema  print the JSON Schema of the report of a session",
    )


def run(args: argparse.Namespace) -> int:
    """0 with the summary, the account, the joined report or the schema on standard output."""
    if args.schema:
        print_data(json.dumps(schema_of(SessionReport), indent=2) + "\n")
        return 0
    if args.report is None:
        raise ConfigError("name the report of a session, or give --schema")
    if args.report == "join":
        if len(args.ends) != 2 or args.html:
            raise ConfigError("write: kontur-av report join GROUND.json SPACE.json > REPORT.json")
        print_data(to_json(_joined(*map(Path, args.ends))))
        return 0
    if args.ends:
        raise ConfigError(f"{args.ends[0]}: name one report, or join and two")
    path = Path(args.report)
    report = read_report(path)
    if not args.html:
        print_summary(report, WordsConsole())
        return 0
    account = path.with_suffix(".html")
    with refused(f"{account}: cannot be written"):
        write_text(account, account_of(report))
    print(account)
    return 0


def _joined(ground: Path, space: Path) -> SessionReport:
    with refused(f"{ground}, {space}: damaged", ProtocolError):
        return join_reports(
            read_report(ground),
            read_report(space),
            read_setup=_setup_of,
            table_of=topology_of,
        )


def _setup_of(text: str) -> Setup:
    try:
        return setup_from_text(text)
    except ConfigError:
        # A radio profile of one's own is there by name only; what both ends measured needs none.
        return setup_from_text(text, changes={"radio": NO_RADIO})


def read_report(path: Path) -> SessionReport:
    """The report of a session in a file; ConfigError for anything else."""
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
