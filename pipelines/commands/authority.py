"""`kontur-av authority`: who drives the robot, the joystick in space or a partner's."""

import argparse
import sys
import time

from kontur_av.errors import one_of
from pipelines.commands.common import acting_on
from pipelines.hand.hand_topics import ARM_SOCKET, AUTHORITIES, AuthorityAnswer, AuthorityRequest
from pipelines.session.option_rows import add_options
from pipelines.session.requests import ask, running_sessions
from pipelines.session.setup.former_names import DRIVERS, current
from telepresence.haptics.authority import Authority

#: How long a hand-over may take: the robot comes to rest first.
_TIMEOUT_S = 5.0
_LOOK_S = 0.1
_LACKS = (
    'and no partner may drive its robot: give its setup partner_arm = "shared" (docs/webrtc.md)'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, f"authority {'|'.join(AUTHORITIES)} <?=>  hand the robot over", "--session")
    parser.description = (
        "Hand the robot over to the operator's joystick or to a partner's. "
        "Without a name, say who drives."
    )


def run(args: argparse.Namespace) -> int:
    """0 once the wanted one drives; 1 without an answer, or if the robot does not rest."""
    args.authority = current(args.authority or "", DRIVERS)
    running = running_sessions(ARM_SOCKET)
    session = acting_on(args.session, running, moves=bool(args.authority), lacks=_LACKS)
    wanted = AuthorityRequest()
    if args.authority:
        wanted = AuthorityRequest(Authority(one_of(args.authority, AUTHORITIES, "authority")))
    end_s = time.monotonic() + _TIMEOUT_S
    try:
        answer = ask(session, ARM_SOCKET, wanted, AuthorityAnswer)
        while args.authority not in ("", answer.authority) and time.monotonic() < end_s:
            time.sleep(_LOOK_S)
            answer = ask(session, ARM_SOCKET, AuthorityRequest(), AuthorityAnswer)
    except OSError as error:
        print(f"kontur-av: {error}", file=sys.stderr)
        return 1
    print(state_words(answer))
    return 0 if args.authority in ("", answer.authority) else 1


def state_words(answer: AuthorityAnswer) -> str:
    if not answer.authority:
        return f"nobody drives; {answer.wanted} will, once the robot rests"
    if answer.waiting:
        return f"{answer.authority} drives, once the dead-man button is pressed anew"
    return f"{answer.authority} drives"
