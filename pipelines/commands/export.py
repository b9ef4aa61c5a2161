"""`kontur-av export`: a recording as tables, as Matroska files, as a data set for learning."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.progress import Progress

from kontur_av.errors import ConfigError
from pipelines.recording.export import lerobot, table_files
from pipelines.recording.export.films import MatroskaExport
from pipelines.recording.export.lerobot import LeRobotExport
from pipelines.recording.export.table_files import CsvExport, MatExport
from pipelines.recording.joined import JoinedMessage, JoinedRecording
from pipelines.recording.recorded_parts import read_recording
from pipelines.recording.recording_file import Outputs
from pipelines.report.report_file import WordsConsole
from pipelines.session.command_process import say
from pipelines.session.option_rows import add_options

#: The bar moves after this many messages.
_STEP = 500


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "file FILE.mcap <Path>  a recording; FILE-2.mcap, FILE-3.mcap, … are joined to it",
        "--mat OUT.mat <Path>  tables for MATLAB and Octave",
        "--mat73  always as MATLAB v7.3",
        "--mkv DIR <Path>  a Matroska file for each camera and stream",
        "--csv DIR <Path>  a CSV file for each channel",
        "--lerobot DIR <Path>  a LeRobot data set, for learning by imitation",
        "--fps N <int>  rows a second of --lerobot (default: as its pictures)",
        "--overwrite",
    )


def run(args: argparse.Namespace) -> int:
    """Write all that was asked for, or nothing."""
    if all(one is None for one in (args.mat, args.mkv, args.csv, args.lerobot)):
        raise ConfigError("give at least one of --mat OUT.mat, --mkv, --csv and --lerobot DIR")
    if args.mat73 and args.mat is None:
        raise ConfigError("--mat73 is a format of --mat: give --mat OUT.mat, too")
    if args.fps is not None and args.lerobot is None:
        raise ConfigError("--fps is the rate of --lerobot: give --lerobot DIR, too")
    if args.mat is not None:
        table_files.check_packages()
    if args.lerobot is not None:
        lerobot.check_packages()
    paths, recording = read_recording(args.file)
    exports: list[MatExport | MatroskaExport | CsvExport | LeRobotExport] = []
    if args.mat is not None:
        exports.append(MatExport(args.mat, recording, v73=args.mat73))
    if args.mkv is not None:
        exports.append(MatroskaExport(args.mkv, recording))
    if args.csv is not None:
        exports.append(CsvExport(args.csv, recording))
    if args.lerobot is not None:
        exports.append(LeRobotExport(args.lerobot, recording, fps=args.fps))
    with Outputs(overwrite=args.overwrite) as outputs:
        for export in exports:
            outputs.check(export.paths, paths)
        for export in exports:
            export.begin(outputs)
        moved = 0
        for message in _with_progress(recording):
            moved += message.moved
            for export in exports:
                export.handle_message(message)
        for export in exports:
            export.end()
    lines = [*_losses(paths, recording), *(line for export in exports for line in export.lines())]
    if moved:
        lines.append(f"{moved} messages had instants far from those around them, and were moved")
    say("\n".join(lines))
    return 0


def _with_progress(recording: JoinedRecording) -> Iterator[JoinedMessage]:
    total = sum(recording.counts.values())
    with Progress(console=WordsConsole(output=sys.stderr), transient=True) as progress:
        progress.disable = not progress.console.is_terminal
        task = progress.add_task("export", total=total)
        for number, message in enumerate(recording.messages()):
            yield message
            if number % _STEP == 0:
                progress.update(task, completed=number)


def _losses(paths: Sequence[Path], recording: JoinedRecording) -> Iterator[str]:
    """A line for each part of which something cannot be read."""
    for path, part in zip(paths, recording.parts, strict=True):
        metrics = part.inventory.scan.metrics
        if metrics.holes:
            yield (
                f"{path} is torn or damaged: {metrics.unread_octets} of {metrics.octets} octets "
                "cannot be read; the rest is exported"
            )
        elif not metrics.sound:
            yield f"{path} is torn, but every message in it is exported"
