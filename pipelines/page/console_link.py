"""Asks the session's console for a camera, without blocking the event loop."""

import asyncio
import os

from pipelines.cores.requests import MAX_LINE_OCTETS, Answer, Request, pack_line, parse_answer
from pipelines.runtime.control import console_path

_PATIENCE_S = 5.0


async def select_camera(session: str, camera: str) -> Answer:
    """Return the console's answer; one with an error if there is no console."""
    try:
        reader, writer = await asyncio.open_unix_connection(
            os.fspath(console_path(session)), limit=MAX_LINE_OCTETS
        )
    except OSError:
        return Answer(ok=False, error="the session's console is not running")
    try:
        writer.write(pack_line(Request(select=camera)))
        answer = parse_answer(await asyncio.wait_for(reader.readline(), _PATIENCE_S))
        if answer is not None and answer.wait_s is not None:
            within_s = answer.wait_s + _PATIENCE_S
            answer = parse_answer(await asyncio.wait_for(reader.readline(), within_s))
    except (OSError, ValueError, TimeoutError):
        answer = None
    finally:
        writer.close()
    return answer or Answer(ok=False, error="the session's console has ended before it answered")
