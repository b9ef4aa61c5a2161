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
        "--overwrite  replace a file that exists",
    )


def run(args: argparse.Namespace) -> int:
    """Mend a recording, or say that there is nothing to mend."""
    torn: Path = args.file
    octets = octets_of_file(torn)
    whole: Path = args.out or mended_name(torn)
    if whole.exists() and whole.samefile(torn):
        raise ConfigError(f"--out {whole} is the torn recording itself: give another name")
    with refused(torn, ProtocolError):
        recovery = Recovery(octets)
    figures = recovery.figures
    if figures.sound:
        line = f"{torn} is whole: there is nothing to mend"
    else:
        check_new(whole, overwrite=args.overwrite)
        write_whole(whole, recovery.pieces(), overwrite=args.overwrite)
        line = (
            f"{whole}: {figures.messages} messages; of {torn}, {figures.unread_octets} of "
            f"{figures.octets} octets could not be read"
        )
    say(line)
    return 0


def mended_name(torn: Path) -> Path:
    """FILE.recovered.mcap for FILE.mcap, and for FILE."""
    return torn.with_name(torn.name.removesuffix(".mcap") + ".recovered.mcap")
