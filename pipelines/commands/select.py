"""`kontur-av select`: switch the camera of a running session."""

import argparse
import sys

from pipelines.commands.common import acting_on
from pipelines.mission.joined_session import JoinedSession
from pipelines.mission.tmtc_messages import selection_error
from pipelines.mission.tmtc_socket import tmtc_socket_name
from pipelines.session.option_rows import add_options
from pipelines.session.requests import running_sessions
from pipelines.session.setup.segments import Segment


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("camera", metavar="CAMERA", help="for example stereo, static or head")
    parser.description = (
        "Ask the ground to send another camera's pictures up, and wait for its acknowledgement. "
        "Exit code 1 if it refuses or no answer comes."
    )
    add_options(parser, "--session")


def run(args: argparse.Namespace) -> int:
    """0 once the ground has acknowledged the camera; 1 if it refused, or no answer came."""
    try:
        running = running_sessions(tmtc_socket_name(Segment.SPACE))
        with JoinedSession(acting_on(args.session, running)) as session:
            end = session.select(args.camera)
    except ConnectionError:
        print("kontur-av: the session has not answered", file=sys.stderr)
        return 1
    if not end.ok:
        print(f"kontur-av: {selection_error(args.camera, end)}", file=sys.stderr)
        return 1
    print(f"{args.camera} is selected; acknowledged after {end.round_trip_ms:.1f} ms")
    return 0
