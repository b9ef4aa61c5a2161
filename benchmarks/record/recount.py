"""Counts the files of a recording by the plain `mcap` package. A shell."""

import json
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from benchmarks.json_reader import JsonReader
from benchmarks.record.agreement import Comparison, Recount, compare
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.recording.part_files import present_parts


def recount(first: Path) -> Recount:
    """Count a recording and its further parts. ConfigError for a file that `mcap` cannot read."""
    found = Recount()
    for path in [*present_parts(first).values()] or [first]:
        try:
            with path.open("rb") as file:
                for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                    found.handle_message(
                        channel.topic, message.log_time, message.publish_time, message.data
                    )
        except ProtocolError as error:
            raise ConfigError(f"{path} is no recording of kontur-av: {error}") from None
        except OSError as error:
            raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
        except McapError as error:
            raise ConfigError(f"{path} is no whole MCAP file: {error}") from None
    return found


def compare_files(recording: Path, report: Path) -> list[Comparison]:
    """Compare a recording with a report's file. ConfigError if one of them cannot be read."""
    try:
        told = JsonReader(json.loads(report.read_text(encoding="utf-8")))
    except OSError as error:
        raise ConfigError(f"{report} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{report} is no JSON: {error}") from None
    found = recount(recording)
    if not found.messages:
        raise ConfigError(f"{recording}: there is no message in it")
    try:
        return compare(found, told)
    except ValueError as error:
        raise ConfigError(f"{report} is no report of a recorded session: {error}") from None
