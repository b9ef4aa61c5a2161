"""`kontur-av select`: switch the camera of a running session."""

import argparse
import sys

from kontur_av.errors import ConfigError
from pipelines.session.control import ask
from pipelines.session.requests import Request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The camera, and the session where several run."""
    parser.add_argument("camera", metavar="CAMERA", help="for example stereo, static or head")
    parser.description = (
        "Ask the ground to send another camera's pictures up, and wait for its acknowledgement. "
        "Exit code 1 if it refuses or no answer comes."
    )
    parser.add_argument(
        "--session", metavar="NAME", help="which one, where several run; its setup's name will do"
    )


def run(args: argparse.Namespace) -> int:
    """0 once the ground has acknowledged the camera; 1 if it refused, or no answer came."""
    answer = ask(Request(args.camera), args.session)
    if answer.mistake:
        raise ConfigError(answer.error)
    if not answer.ok:
        print(f"kontur-av: {answer.error or 'refused on the ground'}", file=sys.stderr)
        return 1
    print(f"{answer.camera} is selected; acknowledged after {answer.round_trip_ms:.1f} ms")
    return 0
