"""`kontur-av select`: switch the camera of a running session."""

import argparse
import sys
from random import SystemRandom

from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import choose_session
from pipelines.commands.telecommand import Sending
from pipelines.mission.choosing import CAMERA, SELECT
from pipelines.mission.tmtc_messages import CommandUpdate, SendCommand, selection_error
from pipelines.mission.tmtc_socket import tmtc_socket_name
from pipelines.session.asking import running_sessions
from pipelines.session.setup.segments import Segment
from pipelines.session.topology import TMTC_TOPICS
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

_CLIENT = "kontur-av select"


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
    running = running_sessions(tmtc_socket_name(Segment.SPACE))
    session = choose_session(args.session, running, " with --session")
    number = SystemRandom().getrandbits(48)
    request = SendCommand(_CLIENT, number, CAMERA, "call", SELECT, (args.camera,))
    application = built_in_dictionary().application(CAMERA)
    end = None
    with TopicBus.join(session) as bus:
        reader = bus.reader(TMTC_TOPICS[Segment.SPACE], depth=32)
        for news in Sending(session, Segment.SPACE, application, request, reader).news():
            if isinstance(news, CommandUpdate) and news.done:
                end = news
    if end is not None and end.mistake:
        raise ConfigError(end.reason)
    if end is None or not end.ok:
        error = "the session has not answered" if end is None else selection_error(args.camera, end)
        print(f"kontur-av: {error}", file=sys.stderr)
        return 1
    print(f"{args.camera} is selected; acknowledged after {end.round_trip_ms:.1f} ms")
    return 0
