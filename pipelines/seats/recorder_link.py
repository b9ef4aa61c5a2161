"""Asks the session's recorder to begin or to end, as `kontur-av record` does, without blocking."""

import asyncio
import os
import time
from pathlib import Path

from pipelines.session.recorder_control import recorder_path
from pipelines.session.recorder_requests import (
    MAX_LINE_OCTETS,
    START,
    STOP,
    RecordAnswer,
    RecordingWish,
    RecordRequest,
    pack_line,
    parse_record_answer,
)

#: A recorder that ends writes a slow disk's file to its end first.
_PATIENCE_S = 15.0


async def ask_recorder(session: str, *, begin: bool) -> str:
    """Begin or end the recording of `session`; return "", or in words why it does not.

    The file is in the directory in which the session was started. It is called after the session
    and the time, in UTC.
    """
    request = RecordRequest(record=STOP)
    if begin:
        instant = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        path = Path.cwd() / f"{session}-{instant}.mcap"
        wish = RecordingWish(file=os.fspath(path), command="the page of ground control")
        request = RecordRequest(record=START, wish=wish)
    try:
        reader, writer = await asyncio.open_unix_connection(
            os.fspath(recorder_path(session)), limit=MAX_LINE_OCTETS
        )
    except OSError:
        return "the session's recorder is not running"
    try:
        writer.write(pack_line(request))
        answer = await _answer(reader)
    finally:
        writer.close()
    if answer is None:
        return "the session's recorder has ended before it answered"
    return "" if answer.ok else answer.error


async def _answer(reader: asyncio.StreamReader) -> RecordAnswer | None:
    try:
        async with asyncio.timeout(_PATIENCE_S):
            return parse_record_answer(await reader.readline())
    except (OSError, ValueError, TimeoutError):
        return None
