"""`kontur-av tc`: send a telecommand to an application of a running session, and print its way."""

import argparse
import sys
from random import SystemRandom

from kontur_av.topics.bus import TopicBus
from pipelines.commands.common import acting_on, say_situation, sending_end
from pipelines.mission.tmtc_messages import (
    SHORT_VERBS,
    Reported,
    command_from_words,
    report_words,
    update_words,
)
from pipelines.mission.tmtc_socket import TMTC_SOCKETS, Sending, read_dictionary
from pipelines.session.command_process import print_data
from pipelines.session.option_rows import add_options
from pipelines.session.requests import running_sessions
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary import Application
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.xtce import dictionary_xtce

_CLIENT = "kontur-av tc"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "application APPLICATION <?>  for example joystick or robot",
        "words WHAT <...>  a function with its arguments, such as halt; or ping, report NAME, on "
        "NAME, off NAME, get NAME..., set NAME=VALUE...",
        "--from <ground|space>  the end that sends it (default: the far one, if here)",
        "--session",
        "--xtce  print the dictionary as XTCE, for other ground systems",
    )
    parser.description = (
        "Send a telecommand and print its verification. Without WHAT, list what an application "
        "can do."
    )


def run(args: argparse.Namespace) -> int:
    """0 once the telecommand is verified as completed; else 1."""
    if args.xtce or not args.words:
        _print_known(args)
        return 0
    built_in = built_in_dictionary()
    # Users' components are on the ground.
    ends = {one.name: one.end for one in built_in.applications}
    end = Segment(ends.get(args.application, Segment.GROUND.value))
    if not running_sessions(*TMTC_SOCKETS):
        # The mistake in the words, before that no session runs.
        command_from_words(built_in.application(args.application), args.words, client="", number=0)
    session, origin = sending_end(args.session, end, vars(args)["from"], moves=True)
    application = read_dictionary(session).application(args.application)
    request = command_from_words(
        application, args.words, client=_CLIENT, number=SystemRandom().getrandbits(48)
    )
    with TopicBus.join(session) as bus:
        return follow(Sending(session, origin, request, bus), application)


def _print_known(args: argparse.Namespace) -> None:
    """The dictionary of the running session; without any, the built-in one."""
    dictionary = built_in_dictionary()
    if running := running_sessions(*TMTC_SOCKETS):
        dictionary = read_dictionary(acting_on(args.session, running))
    if args.xtce:
        print_data(dictionary_xtce(dictionary, vars(args)["from"] or Segment.GROUND.value))
    elif args.application is not None:
        _list(dictionary.application(args.application))
    else:
        for application in dictionary.applications:
            print(f"{application.name} ({application.end}): {application.text}")


def _list(application: Application) -> None:
    for function in application.functions:
        words = " ".join((function.name, *function.arguments))
        print(f"{words}: {function.text}" if function.text else words)
    for structure in application.structures:
        print(f"report {structure.name}: {', '.join(structure.parameters)}")
    settable = [parameter.name for parameter in application.parameters if parameter.writable]
    if settable:
        print(f"set {', '.join(settable)}")
    print(", ".join(SHORT_VERBS))


def follow(sending: Sending, application: Application) -> int:
    """Send it, and print what becomes of it; return the exit code."""
    for news in sending.news():
        if isinstance(news, Reported):
            print(report_words(news, application), flush=True)
        else:
            failed = news.done and not news.ok
            print(update_words(news), file=sys.stderr if failed else sys.stdout, flush=True)
    if sending.done is None:
        print("kontur-av: the session has not answered", file=sys.stderr)
    done = sending.done is not None and sending.done.ok
    if sending.request.verb == "call":
        say_situation(sending.session, application.name, failed=not done)
    return 0 if done else 1
