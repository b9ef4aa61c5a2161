"""The JSON texts between a seat's server and its pages.

A page's requests are checked in full: a field too many, or one of another type, is no request.
"""

from typing import Annotated, Literal

import msgspec

from kontur_av.errors import ProtocolError

_Number = Annotated[int, msgspec.Meta(ge=0, le=1 << 53)]
_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]


class _Request(msgspec.Struct, frozen=True, tag_field="do", forbid_unknown_fields=True):
    request: _Number


class SelectRequest(_Request, frozen=True, tag="select"):
    """Select a camera for the uplink video."""

    camera: _Name


class JoystickRequest(_Request, frozen=True, tag="joystick"):
    """A person's command to the joystick."""

    event: Literal["calibrate", "start", "halt", "acknowledge", "stop", "resume"]


class HandRequest(_Request, frozen=True, tag="hand"):
    """Who holds the handle."""

    action: Literal["take", "give", "ask", "refuse"]


class SessionRequest(_Request, frozen=True, tag="session"):
    """Start or stop the session."""

    action: Literal["start", "stop"]


class RecordRequest(_Request, frozen=True, tag="record"):
    """Begin or end a recording of the session."""

    action: Literal["start", "stop"]


class InputRequest(_Request, frozen=True, tag="input"):
    """Take an input over with the page's own camera or microphone, or give it back."""

    name: _Name
    on: bool


SeatRequest = SelectRequest | JoystickRequest | HandRequest | SessionRequest | RecordRequest

_SEAT = msgspec.json.Decoder(SeatRequest)
_MEDIA = msgspec.json.Decoder(InputRequest)
_ENCODER = msgspec.json.Encoder()


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


class StreamText(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A stream that a page is sent. via: `coded`, `sent` or `sound`."""

    index: int
    name: str
    kind: str
    via: str
    cap_bps: int
    stale_after_ms: float
    width: int | None = None
    height: int | None = None
    fps: float | None = None


class CameraText(msgspec.Struct, frozen=True, kw_only=True):
    """A camera that can be selected."""

    name: str
    inputs: tuple[str, ...]


class PreviewText(msgspec.Struct, frozen=True, kw_only=True):
    """The small pictures of an input."""

    index: int
    input: str
    width: int
    height: int


class InputText(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An input that a page's own camera or microphone can take over."""

    index: int
    name: str
    kind: str
    width: int | None = None
    height: int | None = None
    fps: float | None = None


class WorkspaceText(msgspec.Struct, frozen=True, kw_only=True):
    """The workspace of the joystick, from its middle."""

    half_width_m: float
    half_height_m: float


class BoardText(msgspec.Struct, frozen=True, kw_only=True):
    """The robot's task board; its middle is (0, 0)."""

    width_m: float
    height_m: float
    wall_x_m: float
    leds_m: tuple[tuple[float, float], ...]


class SeatText(msgspec.Struct, frozen=True, kw_only=True):
    """What does not change at a seat."""

    seat: str
    setup: str
    session: str
    streams: tuple[StreamText, ...]
    cameras: tuple[CameraText, ...]
    previews: tuple[PreviewText, ...]
    inputs: tuple[InputText, ...]
    joystick: str
    workspace: WorkspaceText
    board: BoardText
    caps: dict[str, int]


class JoystickText(msgspec.Struct, frozen=True, kw_only=True):
    """The joystick's state in words."""

    state: str
    reason: str
    dead_man: bool
    force_limit_n: float
    device: str


class HandText(msgspec.Struct, frozen=True, kw_only=True):
    """Who holds the handle, and who asks for it, by numbers of pages."""

    holder: int | None
    you: bool
    wanted_by: int | None


class StateText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="state"):
    """The heartbeat, 10 times a second, and at each change."""

    now_us: int
    link: Literal["connected", "lost"]
    signal: bool
    camera: str | None
    joystick: JoystickText | None
    hand: HandText
    inputs: dict[str, int | None]


class AnswerText(
    msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="answer", omit_defaults=True
):
    """The answer to a request of this number. error: "" if it was carried out."""

    request: int
    ok: bool
    error: str
    round_trip_ms: float | None = None


def hello(seat: SeatText, *, role: str, page: int, now_us: int) -> str:
    """Return the first text of a connection."""
    said: dict[str, object] = {"kind": "hello", "role": role, "page": page, "now_us": now_us}
    return pack_text(said | msgspec.to_builtins(seat))


def pack_text(text: msgspec.Struct | dict[str, object]) -> str:
    """Return a text as JSON."""
    return _ENCODER.encode(text).decode()
