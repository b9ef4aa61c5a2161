"""The common part of commands: options, and the session that is meant."""

import sys
from collections.abc import Sequence
from contextlib import suppress

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import choose_session, fitting
from pipelines.session.requests import ask, running_sessions
from pipelines.session.sessions import launched_sessions, started_here, terminal_of
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Situation, Why, at_terminal
from telepresence.haptics.udp_line import unprotected


def check_options(args: object, *options: str) -> None:
    """Raise ConfigError for numbers that are not above 0: `--seconds`, and those of `options`."""
    for option in (*options, "seconds"):
        value = getattr(args, option)
        if value is not None and not 0 < value < 1e9:
            name = option.replace("_", "-")
            raise ConfigError(f"--{name} {value:g}: give a number above 0")


def say_unprotected(*specs: str) -> None:
    """Say which of these joysticks and robots every user of this machine can reach."""
    for line in filter(None, map(unprotected, specs)):
        print(f"kontur-av: {line}", file=sys.stderr)


def acting_on(
    name: str | None, running: Sequence[str], *, moves: bool = False, lacks: str = ""
) -> str:
    """Return the session of `running` that `name` means, and print it on standard error.

    Without a name it is the only one, or the only one that was started in this terminal.
    moves: the robot may move, stop or lose its power. Then another terminal's session must be
    named while others run. lacks: what others that run do not have, and how they get it.
    Errors: see `choose_session`.
    """
    if lacks and not fitting(name, running) and (others := fitting(name, launched_sessions())):
        raise ConfigError(f"{', '.join(others)} {'run' if len(others) > 1 else 'runs'} {lacks}")
    own = [session for session in running if started_here(session)]
    if name is None and len(own) == 1:
        return _said(own[0])
    chosen = choose_session(name, running, " with --session")
    others = [session for session in launched_sessions() if session != chosen]
    if moves and name is None and others:
        raise ConfigError(
            f"session {chosen} was started in another terminal, and {', '.join(others)} runs, too: "
            f"name it with --session {chosen}"
        )
    return _said(chosen)


def sending_end(
    name: str | None, end: Segment, sender: str | None, *, moves: bool = False
) -> tuple[str, Segment]:
    """Return the session that sends a telecommand, and its end that does.

    end: of the application. sender: the end that is to send; None: the one across the radio if it
    runs here, else the application's own. Otherwise as `acting_on`.
    """
    # `stop` and the commands of upkeep load no pictures' libraries.
    from pipelines.mission.tmtc_socket import tmtc_socket_name

    origins = (end.peer, end) if sender is None else (Segment(sender),)
    running: list[str] = []
    for origin in origins:
        running = running_sessions(tmtc_socket_name(origin))
        if fitting(name, running):
            break
    lacks = "here and takes no telecommands now: it begins, ends, or was stopped from a page"
    if sender is not None:
        lacks = f"here without its end {sender}: leave --from out"
    return acting_on(name, running, moves=moves, lacks=lacks), origin


#: The applications that have to do with hand and robot.
_MOVING = ("joystick", "robot", "panel", "tasks")


def situation_now(session: str) -> Situation | None:
    """What holds at the ends of a session that run here; None if nobody answers."""
    from pipelines.mission.tmtc_messages import AskSituation, SituationAnswer
    from pipelines.mission.tmtc_socket import TMTC_SOCKETS

    ends = []
    for service in TMTC_SOCKETS:
        with suppress(ConfigError, OSError):
            ends.append(ask(session, service, AskSituation(), SituationAnswer, timeout_s=1.0).known)
    return at_terminal(ends, terminal_of(session))


def say_situation(session: str, application: str, *, failed: bool = False) -> None:
    """After a telecommand: say on standard error why the hand may not move the robot, what next.

    Where another application is asked, only what made it fail.
    """
    told = situation_now(session)
    if told is not None and (application in _MOVING or (failed and told.why is Why.LINK)):
        print(f"now: {told.words}", file=sys.stderr)


def _said(session: str) -> str:
    print(f"session {session}", file=sys.stderr)
    return session
