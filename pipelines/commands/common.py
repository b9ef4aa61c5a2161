"""The common part of commands: options, and the session that is meant."""

import sys
from collections.abc import Sequence

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import choose_session
from pipelines.session.sessions import launched_sessions, started_here
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


def acting_on(name: str | None, running: Sequence[str], *, moves: bool = False) -> str:
    """Return the session of `running` that `name` means, and print it on standard error.

    Without a name it is the only one, or the only one that was started in this terminal.
    moves: the robot may move, stop or lose its power. Then another terminal's session must be
    named while others run. Errors: see `choose_session`.
    """
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


def _said(session: str) -> str:
    print(f"session {session}", file=sys.stderr)
    return session
