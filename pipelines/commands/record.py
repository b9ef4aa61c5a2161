"""`kontur-av record`: record a running session from another terminal, and leave it again."""

import argparse
import shlex
import sys
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.redaction import shown_spec
from pipelines.commands.common import acting_on, check_options
from pipelines.recording.part_files import (
    LEAST_RECORDED_S,
    check_disk,
    check_recordable,
    recorded_cameras,
)
from pipelines.session.command_process import stopped_by_signals
from pipelines.session.option_rows import add_options
from pipelines.session.options import StreamOptions, add_session_options, stream_options
from pipelines.session.recording_requests import (
    RECORDER_SOCKET,
    AskRecording,
    RecordAnswer,
    RecordingOptions,
    begin_recording,
    hold_recording,
)
from pipelines.session.requests import running_sessions
from pipelines.session.setup.table import Setup

#: Shorter or smaller parts than these make no sense.
_LEAST_S, _LEAST_MB = 1.0, 0.1


def options_of(args: StreamOptions, *, held: bool) -> RecordingOptions | None:
    """Return what the options request; None without a file; ConfigError for what cannot be.

    held: the recording ends when its terminal has gone.
    """
    if not _LEAST_S <= args.part_seconds < 1e7:
        raise ConfigError(f"--part-seconds {args.part_seconds:g}: give at least {_LEAST_S:g}")
    if not _LEAST_MB <= args.part_mb < 1e6:
        raise ConfigError(f"--part-mb {args.part_mb:g}: give at least {_LEAST_MB:g}")
    if args.record is None:
        if args.overwrite or args.link_frames:
            raise ConfigError("--overwrite and --link-frames are about a recording: give --record")
        return None
    return RecordingOptions(
        file=str(args.record.absolute()),
        link_frames=args.link_frames,
        cameras=args.record_cameras or "",
        part_s=args.part_seconds,
        part_mb=args.part_mb,
        command=shlex.join(["kontur-av", *map(shown_spec, sys.argv[1:])]),
        held=held,
    )


def checked_options(args: StreamOptions, setup: Setup) -> RecordingOptions | None:
    """As `options_of`, for a session about to begin; ConfigError if it cannot be recorded."""
    options = options_of(args, held=False)
    if options is not None:
        path = Path(options.file)
        check_recordable(path, overwrite=args.overwrite, sources=setup.sources.values())
        cameras = recorded_cameras(path, setup, options.cameras)
        check_disk(path, cameras, args.seconds or LEAST_RECORDED_S)
    return options


def recording_line(options: RecordingOptions, setup: Setup) -> str:
    """What is recorded where, and what it needs."""
    path = Path(options.file)
    return f"recording to {path}: {recorded_cameras(path, setup, options.cameras).words}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "record FILE.mcap <Path>  what to write", "--session", "--seconds")
    add_session_options(
        parser, "overwrite", "link_frames", "record_cameras", "part_seconds", "part_mb"
    )
    parser.description = (
        "Record a running session until it ends, or until Ctrl-C: the session goes on. "
        "Exit code 1 if messages were lost."
    )


def run(args: argparse.Namespace) -> int:
    """0 once the recording is whole; 1 if messages are missing in it."""
    check_options(args)
    options = options_of(stream_options(args), held=True)
    assert options is not None
    check_recordable(Path(options.file), overwrite=args.overwrite)
    session = acting_on(args.session, running_sessions(RECORDER_SOCKET))
    with stopped_by_signals() as ended:
        link = begin_recording(session, options, overwrite=args.overwrite)
        cameras = link.ask(AskRecording(), RecordAnswer).cameras
        print(f"session {session} is recorded to {options.file}; {cameras}", flush=True)
        answer = hold_recording(link, session, options, ended, args.seconds)
    if answer is None:
        print(f"the session has ended; {options.file} is closed")
        return 0
    lost = f", {answer.lost} lost: `kontur-av info` says of which channels" if answer.lost else ""
    parts = f" in {answer.files} parts" if answer.files > 1 else ""
    print(f"{options.file}{parts}: {answer.messages} messages{lost}")
    return 1 if answer.lost else 0
