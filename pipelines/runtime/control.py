"""Requests from another terminal to a running session, as lines of JSON.

The console of a session listens on a Unix socket in the session's directory, which only its user
may enter.

Request: `{"select": "static"}`.
Answer: `{"ok": true, ...}` or `{"ok": false, "error": "...", "mistake": true}`. `mistake` means
that the request itself was wrong.

A telecommand's answer is preceded by `{"wait_s": 1.5}`: how long the console may wait for it.
"""

import os
import socket
from pathlib import Path

import msgspec

from kontur_av.topics.session_files import choose_session, session_root

_SOCKET = "console"
#: How long a console may take on top of its own `wait_s`.
_PATIENCE_S = 5.0
MAX_LINE_OCTETS = 4096


class Request(msgspec.Struct, frozen=True):
    """A terminal's request. select: the camera; of any type, because it is not checked yet."""

    select: object = None


class Answer(msgspec.Struct, frozen=True, omit_defaults=True):
    """A console's answer; the module's docstring describes its fields."""

    ok: bool | None = None
    camera: str = ""
    round_trip_ms: float = 0.0
    error: str = ""
    mistake: bool = False
    wait_s: float | None = None


def console_path(session: str) -> Path:
    """Return the path of the Unix socket of `session`'s console."""
    return session_root(session) / _SOCKET


def running_sessions() -> list[str]:
    """Return the sessions of this user that have a console, oldest first."""
    found = session_root("x").parent.glob(f"*/{_SOCKET}")
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
            link.sendall(msgspec.json.encode(request) + b"\n")
            lines = link.makefile("rb")
            answer = _parse(lines.readline(MAX_LINE_OCTETS))
            if answer is not None and answer.wait_s is not None:
                link.settimeout(answer.wait_s + _PATIENCE_S)
                answer = _parse(lines.readline(MAX_LINE_OCTETS))
        except OSError:
            answer = None
    if answer is None:
        return Answer(ok=False, error="the session's console has ended before it answered")
    return answer


def _parse(line: bytes) -> Answer | None:
    try:
        return msgspec.json.decode(line, type=Answer)
    except msgspec.DecodeError:
        return None


def _connect(path: Path) -> socket.socket | None:
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    link.settimeout(_PATIENCE_S)
    try:
        link.connect(os.fspath(path))
    except OSError:
        link.close()
        return None
    return link
