"""`kontur-av owner`: who drives the robot, the joystick in space or a partner's."""

import argparse
import sys
import time

from kontur_av.errors import ConfigError
from pipelines.commands.common import acting_on
from pipelines.hand.hand_topics import ARM_DESK, OWNERS, OwnerAnswer, OwnerRequest
from pipelines.session.option_rows import add_options
from pipelines.session.terminals import ask_desk, running_sessions

#: How long a hand-over may take: the robot comes to rest first.
_PATIENCE_S = 5.0
_LOOK_S = 0.1
_MISSING = (
    "no session here lets a partner drive the robot: "
    'give its setup partner_arm = "shared" (docs/rtc.md)'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, f"owner {'|'.join(OWNERS)} <?=>  hand the robot over", "--session")
    parser.description = (
        "Hand the robot over to the joystick in space (iss) or to a partner's. "
        "Without an owner, say who drives."
    )


def run(args: argparse.Namespace) -> int:
    """0 once the wanted owner drives; 1 without an answer, or if the robot does not rest."""
    running = running_sessions(ARM_DESK)
    session = acting_on(args.session, running, moves=bool(args.owner)) if running else None
    answer = _ask(args.owner, session)
    end_s = time.monotonic() + _PATIENCE_S
    while answer.ok and args.owner and answer.owner != args.owner and time.monotonic() < end_s:
        time.sleep(_LOOK_S)
        answer = _ask("", session)
    if answer.mistake:
        raise ConfigError(answer.error)
    if not answer.ok:
        print(f"kontur-av: {answer.error}", file=sys.stderr)
        return 1
    print(state_words(answer))
    return 0 if args.owner in ("", answer.owner) else 1


def state_words(answer: OwnerAnswer) -> str:
    if not answer.owner:
        return f"nobody drives; {answer.wanted} will, once the robot rests"
    if answer.waiting:
        return f"{answer.owner} drives, once the dead-man button was released and pressed"
    return f"{answer.owner} drives"


def _ask(owner: str, session: str | None) -> OwnerAnswer:
    answer = ask_desk(ARM_DESK, OwnerRequest(owner=owner), OwnerAnswer, session, missing=_MISSING)
    return answer or OwnerAnswer(ok=False, error="the session has ended before it answered")
