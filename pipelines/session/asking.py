"""Asks a process of a running session from another terminal: a line there, a line back."""

import os
import socket
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import choose_session, session_root
from pipelines.session.control import running_sessions
from pipelines.session.terminal_lines import MAX_LINE_OCTETS

_PATIENCE_S = 5.0


def desk_path(session: str, desk: str) -> Path:
    """Return the path of the Unix socket of a session's desk."""
    return session_root(session) / desk


def ask_desk(desk: str, line: bytes, session: str | None, *, missing: str) -> bytes:
    """Send a line to the desk of a session, and return the answer; b"" without one.

    session: a name as of `choose_session`. Raises ConfigError, with `missing`, if no session has
    such a desk.
    """
    running = running_sessions(desk)
    if not running:
        raise ConfigError(missing)
    chosen = choose_session(session, running, " with --session")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(_PATIENCE_S)
        try:
            link.connect(os.fspath(desk_path(chosen, desk)))
            link.sendall(line)
            return link.makefile("rb").readline(MAX_LINE_OCTETS)
        except OSError:
            return b""
