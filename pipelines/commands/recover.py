"""`kontur-av recover`: makes of a torn recording one that any MCAP reader opens."""

import argparse
from pathlib import Path

from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.recording.recording_file import check_new, octets_of_file, write_whole
from pipelines.recording.scan import Recovery
from pipelines.session.command_process import say
from pipelines.session.option_rows import add_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "file FILE.mcap <Path>  a torn recording; it stays",
        "--out FILE <Path>  the whole one; default: FILE.recovered.mcap",
        "--overwrite",
    )


def run(args: argparse.Namespace) -> int:
    """Fix a recording, or say that there is nothing to fix."""
    torn: Path = args.file
    octets = octets_of_file(torn)
    whole: Path = args.out or mended_name(torn)
    if whole.exists() and whole.samefile(torn):
        raise ConfigError(f"--out {whole} is the torn recording itself: give another name")
    with refused(torn, ProtocolError):
        recovery = Recovery(octets)
    metrics = recovery.metrics
    if metrics.sound:
        line = f"{torn} is whole: there is nothing to fix"
    else:
        check_new(whole, overwrite=args.overwrite)
        write_whole(whole, recovery.pieces(), overwrite=args.overwrite)
        line = (
            f"{whole}: {metrics.messages} messages; of {torn}, {metrics.unread_octets} of "
            f"{metrics.octets} octets could not be read"
        )
    say(line)
    return 0


def mended_name(torn: Path) -> Path:
    """FILE.recovered.mcap for FILE.mcap, and for FILE."""
    return torn.with_name(torn.name.removesuffix(".mcap") + ".recovered.mcap")
