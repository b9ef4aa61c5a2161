"""`kontur-av select`: switch the camera of a running session, or choose what of it is finest."""

import argparse
import sys

from kontur_av.errors import ConfigError
from pipelines.commands.common import say_situation, sending_end
from pipelines.mission.choosing import CAMERA, FOCUS, SELECT
from pipelines.mission.joined_session import JoinedSession
from pipelines.mission.tmtc_messages import selection_error
from pipelines.session.option_rows import add_options
from pipelines.session.setup.segments import Segment


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "Have another camera's pictures sent up, or a part of them coded finer."
    add_options(
        parser,
        "camera CAMERA <?>  for example stereo, static or head",
        "--focus X,Y,W,H  code a rectangle finer: left, top, width and height as shares of the "
        "picture, like 0.4,0.3,0.2,0.25; off: none",
        "--session",
    )


def run(args: argparse.Namespace) -> int:
    """0 once the ground has acknowledged all; 1 if it refused, or no answer came."""
    steps = []
    if args.camera is not None:
        steps.append((f"{args.camera} is selected", SELECT, args.camera))
    if args.focus is not None:
        steps.append((f"the focus is {args.focus}", FOCUS, args.focus))
    if not steps:
        raise ConfigError("nothing to select: give CAMERA, or --focus X,Y,W,H")
    try:
        name, _ = sending_end(args.session, Segment.GROUND, None)
        with JoinedSession(name) as session:
            for done, function, argument in steps:
                end = session.command(CAMERA, function, argument)
                if not end.ok:
                    why = selection_error(f"{function} {argument}", end)
                    print(f"kontur-av: {why}", file=sys.stderr)
                    say_situation(name, CAMERA, failed=True)
                    return 1
                print(f"{done}; acknowledged after {end.round_trip_ms:.1f} ms")
    except ConnectionError:
        print("kontur-av: the session has not answered", file=sys.stderr)
        return 1
    return 0
