"""The options by which a session carries files and TCP services."""

import argparse
import os
import re
from collections.abc import Mapping, Sequence

from kontur_av.errors import ConfigError, refused
from pipelines.files.desk import RATES_BPS
from pipelines.files.process_files import FilesPlan
from pipelines.files.service_sockets import ALLOW, LISTEN
from pipelines.session.option_rows import add_options
from pipelines.session.topology import FILES, PAGES, Segment

_DEFAULT = ",".join(f"{RATES_BPS[one] / 1000:g}" for one in (Segment.GROUND, Segment.SPACE))


def add_files_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--files DIR <Path>  carry files: the ground's end has DIR/ground, space has DIR/space; "
        "see `kontur-av file`",
        "--files-rate UP,DOWN  the most that files take, in kbit/s from the ground and from space "
        f"(default {_DEFAULT}); media always go first",
    )


def files_arguments(
    args: argparse.Namespace, segments: Sequence[Segment]
) -> Mapping[str, Mapping[str, object]]:
    """Return by process what the options say, and make the directories; ConfigError."""
    if args.files is None:
        if args.files_rate is not None:
            raise ConfigError("--files-rate is for --files: give the directory, too")
        return {}
    text = args.files_rate or _DEFAULT
    rates = re.fullmatch(r"(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if rates is None or not all(1 <= float(one) <= 10_000 for one in rates.groups()):
        raise ConfigError(f"--files-rate {text}: give two rates, from 1 to 10000 kbit/s")
    by_segment = dict(zip((Segment.GROUND, Segment.SPACE), rates.groups(), strict=True))
    found: dict[str, Mapping[str, object]] = {}
    directories = {}
    for segment in segments:
        directory = args.files / segment.value
        with refused(f"--files {directory}"):
            directory.mkdir(parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise ConfigError(f"--files {directory}: cannot be written to; choose another one")
        directories[segment] = directory.absolute()
        plan = FilesPlan(
            directory=directories[segment], rate_bps=round(float(by_segment[segment]) * 1000)
        )
        found[FILES[segment]] = {"plan": plan}
    return found | {PAGES[Segment.GROUND]: {"files": directories}}


def add_services_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"{LISTEN} NAME=PORT <*>  lead TCP connections to PORT of this machine to the other end's "
        "service NAME; with both ends here, from the ground to space; needs --files; repeatable",
        f"{ALLOW} NAME=HOST:PORT <*>  let the other end connect to HOST:PORT as service NAME; "
        "repeatable",
    )
