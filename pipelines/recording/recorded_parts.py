"""Opens a recording with all its parts."""

import sys
from pathlib import Path

from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.recording.joined import JoinedRecording, Part, chosen_parts, read_part
from pipelines.recording.part_files import part_path, present_parts
from pipelines.recording.recording_file import octets_of_file


def read_recording(first: Path) -> tuple[list[Path], JoinedRecording]:
    """Return the parts of a recording, and what is in them.

    A file that has the name of a part but cannot be read, or is not of this recording, is left out
    with a line; so is a part that is missing. Raises ConfigError if no file can be read.
    """
    paths = {1: first} | present_parts(first)
    found: dict[int, Part] = {}
    faults: dict[int, str] = {}
    for number, path in paths.items():
        try:
            with refused(path, ProtocolError):
                found[number] = read_part(octets_of_file(path))
        except ConfigError as error:
            faults[number] = f"{error}; it is left out"
    if not found:
        raise ConfigError(faults[1].removesuffix("; it is left out"))
    parts, left_out = chosen_parts(found)
    faults |= {number: f"{paths[number]} is left out: {why}" for number, why in left_out.items()}
    for number in {*range(min(parts), max(parts))} - {*paths}:
        faults[number] = f"{part_path(first, number)} is missing"
    for _, fault in sorted(faults.items()):
        print(f"kontur-av: {fault}", file=sys.stderr)
    return [paths[number] for number in parts], JoinedRecording(parts=[*parts.values()])
