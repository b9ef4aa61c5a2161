"""`kontur-av stop`: the emergency stop of a running session, and its release."""

import argparse
import os
import pwd
import sys

from kontur_av.clock import MonotonicClock
from kontur_av.topics.session_files import choose_session
from pipelines.commands.common import acting_on, situation_now
from pipelines.session.access import Role
from pipelines.session.kept_files import KeptOrders
from pipelines.session.option_rows import add_options
from pipelines.session.sessions import launched_sessions, terminal_of
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Known, at_end


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "--release  release the stop; the robot stays off until told", "--session")
    parser.description = (
        "Stop the robot, and hold it until the stop is released. Without --session, stop the "
        "robots of all sessions of this user."
    )


def run(args: argparse.Namespace) -> int:
    """0 if the robots have answered the stop, or it is released; without a session a ConfigError.

    1 if a stop could not be kept, or a robot has not answered.
    """
    running = launched_sessions()
    if args.release:
        return _release(acting_on(args.session, running, moves=True))
    # A stop must not wait for a name.
    named = args.session is not None or not running
    #: Who stopped each.
    stopped: dict[str, str] = {}
    failed, ordered_ns = None, MonotonicClock().now_ns()
    for session in [choose_session(args.session, running)] if named else running:
        try:
            KeptOrders(session).stop(f"a terminal of {_user()}")
            stopped[session] = KeptOrders(session).stopped_by or "somebody"
        except OSError as error:
            failed = error
    # Only now, because loading it takes a while.
    from pipelines.hand.safety_ends import await_stopped

    silent = [(one, words) for one in stopped if (words := await_stopped(one, ordered_ns))]
    for session, by in stopped.items():
        held = Known(
            seat=Segment.GROUND,
            role=Role.OPERATOR,
            stopped=True,
            by=by,
            answered=session not in dict(silent),
        )
        print(f"{session}: {at_end(held, terminal_of(session)).words}")
    unkept = [(one, words) for one in stopped if (words := KeptOrders(one).settle(wait=True))]
    for session, words in (*silent, *unkept):
        print(f"{session}: {words}", file=sys.stderr)
    if failed is not None:
        raise failed
    return 1 if silent else 0


def _user() -> str:
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        # A container may run under any number.
        return str(os.getuid())


def _release(session: str) -> int:
    orders, ordered_ns = KeptOrders(session), MonotonicClock().now_ns()
    held, by = orders.stopped, orders.stopped_by
    if held:
        orders.release(f"a terminal of {_user()}")
    from pipelines.commands import tc
    from pipelines.hand.safety_ends import await_stopped
    from pipelines.mission.tmtc_socket import tmtc_socket_name
    from pipelines.session.requests import request_socket

    here = [end for end in Segment if request_socket(session, tmtc_socket_name(end)).exists()]
    if here == [Segment.SPACE]:
        # The robot is across the radio, and answers there.
        print(f"{session}: this end {'releases its stop' if held else 'has ordered no stop'}")
        words = {"application": "robot", "words": ["release_stop"], "from": "space"}
        return tc.run(argparse.Namespace(**words, session=session, xtce=False))
    if not held:
        print(f"{session}: no emergency stop holds")
        return 0
    if silent := await_stopped(session, ordered_ns, stopped=False):
        print(f"{session}: {silent}", file=sys.stderr)
        return 1
    told = situation_now(session)
    now = "" if told is None else f". Now {told.words}"
    print(f"{session}: released the emergency stop by {by or 'somebody'}{now}")
    return 0
