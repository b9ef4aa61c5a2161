"""How a session's recorder is found and asked, and what it is to record. A shell.

The recorder listens on a Unix socket in the session's directory, which only its user may enter.
"""

import os
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import make_session_root, session_root
from pipelines.session.reception import replace_file
from pipelines.session.recorder_requests import (
    START,
    STATE,
    STOP,
    RecordAnswer,
    RecordingWish,
    RecordRequest,
)
from pipelines.session.terminal_lines import MAX_LINE_OCTETS, pack_line, parse_line
from pipelines.session.terminals import desk_path, running_sessions

#: The name of the recorder's Unix socket.
RECORDER_DESK = "recorder"
_WISH = "recording"
#: How long a recorder may take to answer: it writes a slow disk's file to its end first.
_PATIENCE_S = 10.0
#: How often it asks whether the recorder is still there.
_LOOK_S = 0.2
#: A recorder that was killed is there again within this time.
_RETURN_S = 4.0


def write_wish(session: str, wish: RecordingWish) -> None:
    """Keep what is to be recorded, for this and the next lives of the recorder."""
    make_session_root(session)
    replace_file(session_root(session) / _WISH, pack_line(wish))


def read_wish(session: str) -> RecordingWish | None:
    try:
        return parse_line((session_root(session) / _WISH).read_bytes(), RecordingWish)
    except OSError:
        return None


def remove_wish(session: str) -> None:
    (session_root(session) / _WISH).unlink(missing_ok=True)


def recorded_sessions() -> list[str]:
    """Return the running sessions of this user that can be recorded."""
    running = []
    for session in running_sessions(RECORDER_DESK):
        with suppress(OSError):
            RecorderLink(session).close()
            running.append(session)
    return running


class RecorderLink:
    """A connection to the recorder of a session; OSError if it does not listen.

    A recording that it has begun with `held` ends some seconds after the connection is closed.
    """

    def __init__(self, session: str) -> None:
        self._link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._link.settimeout(_PATIENCE_S)
        try:
            self._link.connect(os.fspath(desk_path(session, RECORDER_DESK)))
        except OSError:
            self._link.close()
            raise
        self._lines = self._link.makefile("rb")

    def ask(self, request: RecordRequest) -> RecordAnswer:
        """Send a request and return its answer; OSError if none comes."""
        self._link.sendall(pack_line(request))
        answer = parse_line(self._lines.readline(MAX_LINE_OCTETS), RecordAnswer)
        if answer is None:
            raise ConnectionError("the recorder has ended")
        return answer

    def close(self) -> None:
        self._lines.close()
        self._link.close()


def begin_recording(session: str, wish: RecordingWish, *, overwrite: bool) -> RecorderLink:
    try:
        link = RecorderLink(session)
        answer = link.ask(RecordRequest(record=START, wish=wish, overwrite=overwrite))
    except OSError as error:
        raise ConfigError(f"the recorder of {session} does not answer: {error}") from None
    if not answer.ok:
        link.close()
        raise ConfigError(answer.error)
    return link


def hold_recording(
    link: RecorderLink,
    session: str,
    wish: RecordingWish,
    ended: Callable[[], bool],
    seconds: float | None,
) -> RecordAnswer | None:
    """Wait for the end; the answer to the order to stop, or None if the session has ended."""
    end_s = None if seconds is None else time.monotonic() + seconds
    fault = ""
    while True:
        left_s = _LOOK_S if end_s is None else min(_LOOK_S, end_s - time.monotonic())
        time.sleep(max(0.0, left_s))
        over = ended() or (end_s is not None and time.monotonic() >= end_s)
        try:
            answer = link.ask(RecordRequest(record=STOP if over else STATE))
        except OSError:
            link.close()
            found = _returned(session, wish)
            if found is None:
                return None
            link = found
            continue
        if over:
            link.close()
            return answer if answer.ok else None
        if answer.fault and answer.fault != fault:
            print(f"kontur-av: {answer.fault}; the recorder tries again", file=sys.stderr)
        fault = answer.fault


def _returned(session: str, wish: RecordingWish) -> RecorderLink | None:
    """The recorder that the launcher has started again; None if it does not come."""
    end_s = time.monotonic() + _RETURN_S
    while time.monotonic() < end_s:
        with suppress(OSError, ConfigError):
            return begin_recording(session, wish, overwrite=False)
        time.sleep(0.1)
    return None
