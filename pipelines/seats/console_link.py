"""Asks the session's console for a camera, as `kontur-av select` does, without waiting for it."""

import asyncio
import os

from pipelines.session.control import console_path
from pipelines.session.requests import MAX_LINE_OCTETS, Answer, Request, pack_line, parse_answer

#: How long a console may take on top of its own `wait_s`.
_PATIENCE_S = 5.0
_ENDED = "the session's console has ended before it answered"


async def ask_console(session: str, camera: str) -> Answer:
    """Return the console's answer; an error in words if it does not answer."""
    try:
        reader, writer = await asyncio.open_unix_connection(
            os.fspath(console_path(session)), limit=MAX_LINE_OCTETS
        )
    except OSError:
        return Answer(ok=False, error="the session's console is not running")
    try:
        writer.write(pack_line(Request(select=camera)))
        answer = await _next_answer(reader, _PATIENCE_S)
        if answer is not None and answer.wait_s is not None:
            answer = await _next_answer(reader, answer.wait_s + _PATIENCE_S)
    except (OSError, ValueError, TimeoutError):
        answer = None
    finally:
        writer.close()
    return Answer(ok=False, error=_ENDED) if answer is None else answer


async def _next_answer(reader: asyncio.StreamReader, patience_s: float) -> Answer | None:
    async with asyncio.timeout(patience_s):
        return parse_answer(await reader.readline())
