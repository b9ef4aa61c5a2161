"""Opens a recording with all its parts, for commands."""

import sys
from collections.abc import Iterator
from pathlib import Path

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.recording.joined import JoinedRecording, Part, follows, read_part
from pipelines.recording.recording_file import octets_of_file


def read_recording(first: Path) -> tuple[list[Path], JoinedRecording]:
    """Return the parts of a recording, and what is in them.

    A file that has the name of a part but is not of this recording is left out, with a line.
    Raises ConfigError for a file that cannot be read, or is no recording.
    """
    parts, paths = [_part(first)], [first]
    facts = parts[0].inventory.facts
    if facts is None or facts.part == 1:
        for path in _later_parts(first):
            part = _part(path)
            if not follows(part, parts[-1]):
                print(f"kontur-av: {path} is of another recording: left out", file=sys.stderr)
                break
            parts.append(part)
            paths.append(path)
    return paths, JoinedRecording(parts=parts)


def _part(path: Path) -> Part:
    try:
        return read_part(octets_of_file(path))
    except ProtocolError as error:
        raise ConfigError(f"{path}: {error}") from None


def _later_parts(first: Path) -> Iterator[Path]:
    number = 2
    while (path := first.with_name(f"{first.stem}-{number}{first.suffix}")).exists():
        yield path
        number += 1
