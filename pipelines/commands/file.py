"""`kontur-av file`: put, get, list, rename and remove files at the other end of a session."""

import argparse
import sys
import time
from contextlib import suppress

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import fitting
from pipelines.commands.common import acting_on
from pipelines.session.option_rows import add_actions, add_options
from pipelines.session.requests import ask, running_sessions
from pipelines.session.setup.segments import Segment
from pipelines.session.transfer_requests import (
    CANCEL,
    STATE,
    STATUS,
    FileAnswer,
    FileRequest,
    listing,
    progress,
    socket_name,
)
from telepresence.files.entity import DONE, FAILED

_LOOK_S, _PUBLISH_S = 0.2, 2.0
#: A transfer under way is given up this long after the last answer: a full machine may be slow.
_SILENT_S = 30.0
_LACKS = "without files, or without that end: start it with --files DIR"
_AS = "second AS <?>  default: the same name"
_HELP = {
    "put": ("send a file to the other end", "first NAME", _AS),
    "get": ("fetch a file of the other end", "first NAME", _AS),
    "list": ("list the other end's directory, or one in it", "first NAME <?>"),
    "rename": ("rename a file at the other end", "first NAME", "second NEW"),
    "remove": ("remove a file at the other end", "first NAME"),
    STATUS: ("list the transfers that were asked for here",),
    CANCEL: ("give up a transfer, at both ends", "number NUMBER <int>  as of status"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    for action in add_actions(parser, _HELP).values():
        row = "--from <ground|space>  the end that asks (default: the ground, if here)"
        add_options(action, row, "--session")
    parser.description = (
        "Move files between the directories of `kontur-av stream --files`. A loss of signal "
        "suspends a transfer, Ctrl-C cancels it."
    )


def run(args: argparse.Namespace) -> int:
    """0 once it is done; else 1."""
    request = FileRequest(
        file=args.action,
        first=getattr(args, "first", None) or "",
        second=getattr(args, "second", None) or "",
        number=getattr(args, "number", -1),
    )
    sender: str | None = vars(args)["from"]
    segments = tuple(Segment) if sender is None else (Segment(sender),)
    for segment in sorted(segments, key=lambda one: one is not Segment.GROUND):
        running = running_sessions(socket_name(segment))
        if fitting(args.session, running):
            break
    return _follow(request, segment, acting_on(args.session, running, lacks=_LACKS))


def _follow(request: FileRequest, segment: Segment, session: str) -> int:
    """Ask, then print how far it is until it has ended; Ctrl-C cancels it."""
    began_s = told_s = heard_s = time.monotonic()
    service, state, text = socket_name(segment), "", ""
    try:
        while True:
            try:
                answer = ask(session, service, request, FileAnswer)
            except OSError:
                if request.file == STATE and session not in running_sessions(service):
                    raise ConfigError(f"session {session} has ended before the transfer") from None
                if request.file == STATE and time.monotonic() - heard_s < _SILENT_S:
                    time.sleep(_LOOK_S)
                    continue
                print("kontur-av: the session has not answered", file=sys.stderr)
                return 1
            now_s = time.monotonic()
            if answer.state == FAILED:
                print(f"kontur-av: failed: {answer.text}", file=sys.stderr)
                return 1
            heard_s = now_s
            if request.file == STATUS:
                print(listing(answer))
                return 0
            if answer.state == DONE:
                done = f"done, {progress(answer)} in {now_s - began_s:.1f} s"
                print(answer.text.rstrip() or done)
                return 0
            if answer.text != text:
                text = answer.text
                print(f"kontur-av: {text or 'the other end answers'}", file=sys.stderr, flush=True)
            if answer.state != state or now_s - told_s >= _PUBLISH_S:
                state, told_s = answer.state, now_s
                print(f"{state}, {progress(answer)}", file=sys.stderr, flush=True)
            request = FileRequest(file=STATE, number=answer.number)
            time.sleep(_LOOK_S)
    except KeyboardInterrupt:
        if request.file == STATE:
            cancel = FileRequest(file=CANCEL, number=request.number)
            with suppress(OSError, ConfigError):
                ask(session, service, cancel, FileAnswer)
            print("kontur-av: cancelled", file=sys.stderr)
        raise
