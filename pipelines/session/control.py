"""Asks a running session from another terminal; `pipelines.session.requests` has the lines.

The console of a session listens on a Unix socket in the session's directory, which only its user
may enter.
"""

import os
import socket
from pathlib import Path

from kontur_av.topics.session_files import choose_session, session_root
from pipelines.session.requests import MAX_LINE_OCTETS, Answer, Request, pack_line, parse_answer

_SOCKET = "console"
#: How long a console may take on top of its own `wait_s`.
_PATIENCE_S = 5.0


def console_path(session: str) -> Path:
    """Return the path of the Unix socket of `session`'s console."""
    return session_root(session) / _SOCKET


def running_sessions(socket_name: str = _SOCKET) -> list[str]:
    """Return the sessions of this user that have such a socket, oldest first.

    socket_name: by default that of a console.
    """
    found = session_root("x").parent.glob(f"*/{socket_name}")
    return [path.parent.name for path in sorted(found, key=lambda path: path.stat().st_mtime)]


def ask(request: Request, session: str | None = None) -> Answer:
    """Send a request to a session and return its answer.

    session: a name as of `choose_session`; None: the only running session. Raises ConfigError if
    there is no such session, or several.
    """
    links = {name: link for name in running_sessions() if (link := _connect(console_path(name)))}
    try:
        chosen = links.pop(choose_session(session, list(links), " with --session"))
    finally:
        for other in links.values():
            other.close()
    with chosen as link:
        try:
            link.sendall(pack_line(request))
            lines = link.makefile("rb")
            answer = parse_answer(lines.readline(MAX_LINE_OCTETS))
            if answer is not None and answer.wait_s is not None:
                link.settimeout(answer.wait_s + _PATIENCE_S)
                answer = parse_answer(lines.readline(MAX_LINE_OCTETS))
        except OSError:
            answer = None
    if answer is None:
        return Answer(ok=False, error="the session's console has ended before it answered")
    return answer


def _connect(path: Path) -> socket.socket | None:
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    link.settimeout(_PATIENCE_S)
    try:
        link.connect(os.fspath(path))
    except OSError:
        link.close()
        return None
    return link
