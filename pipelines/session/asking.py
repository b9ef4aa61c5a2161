"""Asks a process of a running session from another terminal: a line there, a line back."""

import errno
import os
import socket
import time
from pathlib import Path
from typing import TypeVar

import msgspec

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import choose_session, session_root
from pipelines.session.sessions import is_alive
from pipelines.session.terminal_lines import MAX_LINE_OCTETS, pack_line, parse_line

_PATIENCE_S, _AGAIN_S = 5.0, 0.05
_Answer = TypeVar("_Answer", bound=msgspec.Struct)


def desk_path(session: str, desk: str) -> Path:
    return session_root(session) / desk


def running_sessions(desk: str) -> list[str]:
    """Return the sessions of this user in which a process listens on this socket, oldest first.

    Where that process was killed and the launcher restarts it, wait for up to `_PATIENCE_S`.
    """
    until_s = time.monotonic() + _PATIENCE_S
    found = list(session_root("x").parent.glob(f"*/{desk}"))
    while any(is_alive(path.parent.name) and not _listens(path) for path in found):
        if time.monotonic() > until_s:
            break
        time.sleep(_AGAIN_S)
    paths = sorted(filter(_listens, found), key=lambda path: path.stat().st_mtime)
    return [path.parent.name for path in paths]


def _listens(path: Path) -> bool:
    """Whether a process has this socket open; one that was killed leaves its file behind."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        try:
            link.connect(os.fspath(path))
        except OSError as error:
            # A stream socket is of another type, and somebody has it.
            return error.errno == errno.EPROTOTYPE
    return True


def ask_desk(
    desk: str, request: msgspec.Struct, answer: type[_Answer], session: str | None, *, missing: str
) -> _Answer | None:
    """Ask the desk of a session; None without an answer.

    answer: its type. session: a name as of `choose_session`. Raises ConfigError, with `missing`,
    if no session has such a desk.
    """
    running = running_sessions(desk)
    if not running:
        raise ConfigError(missing)
    chosen = choose_session(session, running, " with --session")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(_PATIENCE_S)
        try:
            link.connect(os.fspath(desk_path(chosen, desk)))
            link.sendall(pack_line(request))
            return parse_line(link.makefile("rb").readline(MAX_LINE_OCTETS), answer)
        except OSError:
            return None
