"""`kontur-av record`: record a running session from another terminal, and leave it again."""

import argparse
import shlex
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.commands.common import (
    acting_on,
    add_seconds_argument,
    add_session_argument,
    check_options,
)
from pipelines.recording.part_files import check_recordable
from pipelines.session.children import stopped_by_signals
from pipelines.session.recorder_control import RecorderLink, recorded_sessions
from pipelines.session.recorder_requests import (
    START,
    STATE,
    STOP,
    RecordAnswer,
    RecordingWish,
    RecordRequest,
)

#: Shorter or smaller parts than these make no sense.
_LEAST_S, _LEAST_MB = 1.0, 0.1


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--record", type=Path, metavar="FILE.mcap", help="record the session")
    add_recording_arguments(parser)


def add_recording_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--overwrite", action="store_true", help="replace a recording of that name")
    parser.add_argument(
        "--link-frames", action="store_true", help="record every frame of the radio link, too"
    )
    parser.add_argument(
        "--part-seconds",
        type=float,
        default=600.0,
        metavar="S",
        help="begin a new part of the recording after S seconds (default 600)",
    )
    parser.add_argument(
        "--part-mb", type=float, default=256.0, metavar="M", help="or after M MB (default 256)"
    )


def wish_of(args: argparse.Namespace, *, held: bool) -> RecordingWish | None:
    """Return what the options wish; None without a file; ConfigError for what cannot be.

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
    return RecordingWish(
        file=str(args.record.absolute()),
        link_frames=args.link_frames,
        part_s=args.part_seconds,
        part_mb=args.part_mb,
        command=shlex.join(["kontur-av", *sys.argv[1:]]),
        held=held,
    )


#: How often it asks whether the recorder is still there.
_LOOK_S = 0.2
#: A recorder that was killed is there again within this time.
_RETURN_S = 4.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("record", type=Path, metavar="FILE.mcap", help="what to write")
    add_session_argument(parser)
    add_seconds_argument(parser)
    add_recording_arguments(parser)
    parser.description = (
        "Record a running session until Ctrl-C, or until it ends. The session goes on. "
        "Exit code 1 if messages were lost."
    )


def run(args: argparse.Namespace) -> int:
    """0 once the recording is whole; 1 if messages are missing in it."""
    check_options(args)
    wish = wish_of(args, held=True)
    assert wish is not None
    check_recordable(Path(wish.file), overwrite=args.overwrite)
    session = acting_on(args.session, recorded_sessions())
    with stopped_by_signals() as ended:
        link = _begin(session, wish, overwrite=args.overwrite)
        print(f"session {session} is recorded to {wish.file}", flush=True)
        answer = _hold(link, session, wish, ended, args.seconds)
    if answer is None:
        print(f"the session has ended; {wish.file} is closed")
        return 0
    lost = f", {answer.lost} lost: `kontur-av info` says of which channels" if answer.lost else ""
    parts = f" in {answer.files} parts" if answer.files > 1 else ""
    print(f"{wish.file}{parts}: {answer.messages} messages{lost}")
    return 1 if answer.lost else 0


def _begin(session: str, wish: RecordingWish, *, overwrite: bool) -> RecorderLink:
    try:
        link = RecorderLink(session)
        answer = link.ask(RecordRequest(record=START, wish=wish, overwrite=overwrite))
    except OSError as error:
        raise ConfigError(f"the recorder of {session} does not answer: {error}") from None
    if not answer.ok:
        link.close()
        raise ConfigError(answer.error)
    return link


def _hold(
    link: RecorderLink,
    session: str,
    wish: RecordingWish,
    ended: Callable[[], bool],
    seconds: float | None,
) -> RecordAnswer | None:
    """Wait for the end; the answer to the order to stop, or None if the session has ended."""
    end_s = None if seconds is None else time.monotonic() + seconds
    fault = ""
    while True:
        left_s = _LOOK_S if end_s is None else min(_LOOK_S, end_s - time.monotonic())
        time.sleep(max(0.0, left_s))
        over = ended() or (end_s is not None and time.monotonic() >= end_s)
        try:
            answer = link.ask(RecordRequest(record=STOP if over else STATE))
        except OSError:
            link.close()
            found = _returned(session, wish)
            if found is None:
                return None
            link = found
            continue
        if over:
            link.close()
            return answer if answer.ok else None
        if answer.fault and answer.fault != fault:
            print(f"kontur-av: {answer.fault}; the recorder tries again", file=sys.stderr)
        fault = answer.fault


def _returned(session: str, wish: RecordingWish) -> RecorderLink | None:
    """The recorder that the launcher has started again; None if it does not come."""
    end_s = time.monotonic() + _RETURN_S
    while time.monotonic() < end_s:
        with suppress(OSError, ConfigError):
            return _begin(session, wish, overwrite=False)
        time.sleep(0.1)
    return None
