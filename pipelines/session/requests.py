"""Requests from another terminal to a running session's console, as lines of JSON.

Request: `{"select": "static"}`.
Answer: `{"ok": true, ...}` or `{"ok": false, "error": "...", "mistake": true}`. `mistake` means
that the request itself was wrong.

A telecommand's answer is preceded by `{"wait_s": 1.5}`: how long the console may wait for it.
"""

import msgspec

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


def pack_line(content: Request | Answer) -> bytes:
    """Return a request or an answer as a line."""
    return msgspec.json.encode(content) + b"\n"


def parse_request(line: bytes) -> Request | None:
    """Return the request in a line, or None if it is none."""
    try:
        return msgspec.json.decode(line, type=Request)
    except (msgspec.DecodeError, RecursionError):  # RecursionError: "[[[[" without end
        return None


def parse_answer(line: bytes) -> Answer | None:
    """Return the answer in a line, or None if it is none."""
    try:
        return msgspec.json.decode(line, type=Answer)
    except msgspec.DecodeError:
        return None
