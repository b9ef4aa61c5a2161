"""What pages ask for, as JSON. `.ci/web/texts.py` writes their types to `static/texts.js`.

Requests are checked in full: those with a field too many, or one of another type, are refused.
"""

from typing import Annotated, Literal

import msgspec

from kontur_av.errors import ProtocolError

_Number = Annotated[int, msgspec.Meta(ge=0, le=1 << 53)]
_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
_Value = bool | Annotated[int, msgspec.Meta(ge=-(1 << 31), le=1 << 32)] | float | _Name


class _Request(msgspec.Struct, frozen=True, tag_field="do", forbid_unknown_fields=True):
    request: _Number


class JoystickRequest(_Request, frozen=True, tag="joystick"):
    """A person's command to the joystick."""

    event: Literal["calibrate", "start", "halt", "acknowledge", "stop", "resume"]


class HandleRequest(_Request, frozen=True, tag="hand"):
    """Who holds the handle."""

    action: Literal["take", "give", "ask", "refuse"]


class SessionRequest(_Request, frozen=True, tag="session"):
    """Start or stop the session."""

    action: Literal["start", "stop"]


class RecordingRequest(_Request, frozen=True, tag="record"):
    """Begin or end a recording of the session."""

    action: Literal["start", "stop"]


class InputRequest(_Request, frozen=True, tag="input"):
    """Take an input over with the page's own camera or microphone, or give it back."""

    name: _Name
    on: bool


class CommandRequest(_Request, frozen=True, tag="command"):
    """Send a telecommand to an application of either end; the fields are those of `SendCommand`."""

    application: _Name
    verb: Literal["call", "ping", "report", "housekeeping_on", "housekeeping_off"] = "call"
    name: Annotated[str, msgspec.Meta(max_length=64)] = ""
    arguments: Annotated[tuple[_Value, ...], msgspec.Meta(max_length=4)] = ()

    @property
    def deed(self) -> str:
        """What the role of a page must permit."""
        return f"{self.application}.{self.name}" if self.verb == "call" else "housekeeping"


class ChatRequest(_Request, frozen=True, tag="chat"):
    """Write a line to the others."""

    text: Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


SeatRequest = (
    JoystickRequest
    | HandleRequest
    | SessionRequest
    | RecordingRequest
    | CommandRequest
    | ChatRequest
)

_SEAT = msgspec.json.Decoder(SeatRequest)
_MEDIA = msgspec.json.Decoder(InputRequest)


def parse_seat_request(text: str) -> SeatRequest:
    """Return a request on the socket of a seat; ProtocolError for anything else."""
    try:
        request: SeatRequest = _SEAT.decode(text)
    except (msgspec.MsgspecError, RecursionError, UnicodeEncodeError) as error:
        raise ProtocolError(f"no request: {error}") from None
    return request


def parse_media_request(text: str) -> InputRequest:
    """Return a request on the socket of a camera or microphone; ProtocolError otherwise."""
    try:
        return _MEDIA.decode(text)
    except (msgspec.MsgspecError, RecursionError, UnicodeEncodeError) as error:
        raise ProtocolError(f"no request: {error}") from None
