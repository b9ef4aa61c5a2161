"""The JSON texts that a seat's server and its pages exchange.

`.ci/web/texts.py` writes the types of `static/texts.js` from them. Requests of pages are checked in
full: those with a field too many, or one of another type, are refused.
"""

from enum import Enum
from typing import Annotated, Literal, NamedTuple, TypeVar

import msgspec

from kontur_av.errors import ProtocolError, refused
from pipelines.hand.haptic_trace import HapticChart
from pipelines.session.access import Role
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.stick_map import PadControls
from telepresence.malformed import MALFORMED

Level = Literal["good", "warn", "bad", "none"]

_ENCODER = msgspec.json.Encoder()


class Via(Enum):
    """How a page gets a stream: as it was received, as it was sent, or as sound."""

    CODED = "coded"
    SENT = "sent"
    SOUND = "sound"


class StreamText(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A stream that a page is sent."""

    index: int
    name: str
    kind: Literal["video", "voice"]
    via: Via
    cap_bps: int
    stale_after_ms: float
    width: int | None = None
    height: int | None = None
    fps: float | None = None


class CameraText(msgspec.Struct, frozen=True, kw_only=True):
    """A camera that can be selected. layout: of one that is composed of two; else ""."""

    name: str
    inputs: tuple[str, ...]
    layout: str = ""


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
    kind: Literal["video", "audio"]
    width: int | None = None
    height: int | None = None
    fps: float | None = None


class WorkspaceText(msgspec.Struct, frozen=True, kw_only=True):
    """The workspace of the joystick, from its middle."""

    half_width_m: float
    half_height_m: float


class MarkText(msgspec.Struct, frozen=True, kw_only=True):
    """What stands in the robot's workspace: a place, or an obstacle with its half sizes."""

    name: str
    x_m: float
    y_m: float
    half_width_m: float
    half_height_m: float


class BoardText(msgspec.Struct, frozen=True, kw_only=True):
    """The robot's workspace, with its middle at (0, 0), and the task board in it, if there is one.

    wall_x_m: null without the board. marks: what the robot or the setup names. With tasks,
    lights_m: of the LED panel; paths_m: by goal, the way that is to be followed; spring_m: where
    the spring begins.
    """

    width_m: float
    height_m: float
    wall_x_m: float | None
    marks: tuple[MarkText, ...]
    leds_m: tuple[tuple[float, float], ...]
    lights_m: tuple[tuple[float, float], ...] = ()
    paths_m: dict[str, tuple[tuple[float, float], ...]] = {}
    spring_m: tuple[float, float] = (0.0, 0.0)


class ExerciseText(msgspec.Struct, frozen=True, kw_only=True):
    """An exercise that a trainer can give here. seconds: how long, by default. camera: or ""."""

    name: str
    text: str
    seconds: float
    camera: str


class SeatText(msgspec.Struct, frozen=True, kw_only=True):
    """What does not change at a seat. tasks: whether the session has any.

    views: by camera, where the board is in its pictures, as far as it is known: a homography, row
    by row, from (x, y, 1) in metres to shares of the picture's width and height, x right, y down.
    exercises: of its trainer; none without one. pad: what a game controller at the page does; null:
    the usual.
    """

    seat: Segment
    setup: str
    session: str
    streams: tuple[StreamText, ...]
    cameras: tuple[CameraText, ...]
    previews: tuple[PreviewText, ...]
    inputs: tuple[InputText, ...]
    joystick: str
    workspace: WorkspaceText
    charts: tuple[HapticChart, ...]
    board: BoardText
    caps: dict[str, int]
    applications: tuple["ApplicationText", ...] = ()
    passes: tuple["PassText", ...] = ()
    tasks: bool = False
    task_list: tuple["TaskText", ...] = ()
    views: dict[str, tuple[float, ...]] = {}
    exercises: tuple[ExerciseText, ...] = ()
    pad: PadControls | None = None


class HelloText(SeatText, frozen=True, kw_only=True, tag_field="kind", tag="hello"):
    """The first text of a connection. page: its number. name: who sits there."""

    role: Role
    page: int
    name: str
    now_us: int


class WelcomeText(msgspec.Struct, frozen=True, kw_only=True):
    """What the page where people choose a page must know; it stands in that page itself.

    seat: the end that serves it. ports: by end, of those on this machine. tasks: whether the
    session has any. trainer: whether it has one. people: by role, its token, for the owner to hand
    out; none for others.
    """

    role: Role
    seat: Segment
    ports: dict[str, int]
    tasks: bool
    trainer: bool
    people: dict[str, str]


class AxisText(msgspec.Struct, frozen=True, kw_only=True):
    """An axis of the joystick behind x and y: m and N, or rad and N m. unit: of the position."""

    name: str
    position: float
    half_range: float
    force: float
    force_limit: float
    unit: str = "m"


class JoystickText(msgspec.Struct, frozen=True, kw_only=True):
    """The joystick's state in words. allowed: requests that it would take now. axes: those behind
    x and y. request: which leads on; "": none does. test, test_reason: what became of the newest
    functional test. experiment: of the present or the next application. partner: whether a
    partner's robot is there; null: there can be none. command_age_ms: how old the commands are that
    the robot gets, at most, to 50 ms. presses_n: how hard the robot presses, as the joystick knows.
    """

    state: str
    allowed: tuple[str, ...]
    reason: str
    dead_man: bool
    force_limit_n: float
    device: str
    axes: tuple[AxisText, ...] = ()
    test: str = "none"
    test_reason: str = ""
    experiment: str = "german experiment"
    partner: bool | None = None
    command_age_ms: int | None = None
    presses_n: float = 0.0
    request: str = ""


class SafetyText(msgspec.Struct, frozen=True, kw_only=True):
    """The emergency stop, as this end knows it.

    stopped: it is ordered. by: who ordered it, "" if that is not known here. frozen: a part of the
    operator's picture is.
    """

    stopped: bool
    by: str
    frozen: bool = False


class SituationText(msgspec.Struct, frozen=True, kw_only=True):
    """Whether the hand may move the robot, as `pipelines.session.situation` has it.

    why, next: names of the cause, and of what is to be done; the others are their words.
    """

    may: bool
    level: Level
    why: str
    reason: str
    next: str
    advice: str


class HandText(msgspec.Struct, frozen=True, kw_only=True):
    """Who holds the handle, and who asks for it, by numbers of pages.

    who, asks: their names; "" for nobody, and at the other end. policy: one that may drive.
    """

    holder: int | None
    you: bool
    wanted_by: int | None
    who: str
    asks: str
    policy: str


class StateText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="state"):
    """The heartbeat, 10 times a second, and at each change."""

    now_us: int
    link: Literal["connected", "lost"]
    signal: bool
    camera: str | None
    joystick: JoystickText | None
    safety: SafetyText
    situation: SituationText
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


class Answered(NamedTuple):
    """What became of the request of a page.

    error: "" if it was carried out. camera: the one that it has selected; else "".
    """

    page: int
    request: int
    error: str
    round_trip_ms: float | None = None
    camera: str = ""


class ChatLine(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A line of the chat. state: `waiting`, `delivered`, `refused`; `received` from the others."""

    number: int
    at_us: int
    sender: str
    text: str
    state: str
    reason: str = ""
    round_trip_ms: float = 0.0


class ChatText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="chat"):
    """The whole chat, as far as it is kept."""

    lines: tuple[ChatLine, ...]


class CommandLine(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A telecommand of this seat. stage, done, ok, verified: as in `CommandUpdate`."""

    number: int
    at_us: int
    who: str
    words: str
    stage: str
    done: bool = False
    ok: bool = False
    verified: bool = False
    reason: str = ""
    round_trip_ms: float = 0.0
    tries: int = 0


class CommandsText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="commands"):
    """The telecommands of this seat."""

    commands: tuple[CommandLine, ...]


class ValueText(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter's newest value. value: None for NaN. at_us: when it was heard."""

    application: str
    name: str
    value: bool | int | float | str | None
    level: Level
    at_us: int


class ValuesText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="values"):
    """All parameters that were reported."""

    values: tuple[ValueText, ...]


class EventLine(msgspec.Struct, frozen=True, kw_only=True):
    """An event of an application of either end."""

    number: int
    at_us: int
    application: str
    name: str
    severity: str
    values: dict[str, bool | int | float | str | None]


class EventsText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="events"):
    """The newest events."""

    events: tuple[EventLine, ...]


class RadioText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="radio"):
    """Whether both directions carry, in words."""

    level: Level
    words: str


class ParameterText(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter, from where on it is coloured, and the texts that it may have."""

    name: str
    unit: str
    text: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]


class StructureText(msgspec.Struct, frozen=True, kw_only=True):
    """A housekeeping report. on: from the start."""

    name: str
    parameters: tuple[str, ...]
    interval_s: float
    on: bool


class FunctionText(msgspec.Struct, frozen=True, kw_only=True):
    """A function that a telecommand starts."""

    name: str
    arguments: tuple[str, ...]
    text: str


class ApplicationText(msgspec.Struct, frozen=True, kw_only=True):
    """An application of the dictionary."""

    name: str
    end: str
    text: str
    parameters: tuple[ParameterText, ...]
    structures: tuple[StructureText, ...]
    functions: tuple[FunctionText, ...]


class TaskText(msgspec.Struct, frozen=True, kw_only=True):
    """A task. text: for the cosmonaut. lacks: why it cannot be done here; "" if it can."""

    name: str
    text: str
    lacks: str = ""


class PassText(msgspec.Struct, frozen=True, kw_only=True):
    """A pass ahead. `_s`: from the acquisition of this session's own pass."""

    acquisition: str
    acquisition_s: float
    loss_s: float
    peak_deg: float


class TransferText(msgspec.Struct, frozen=True, kw_only=True):
    """A file on its way. end: which asked for it. size: None if it is not known."""

    end: str
    number: int
    what: str
    state: str
    octets: int
    size: int | None
    rate_bps: int
    name: str


class SoftwareText(msgspec.Struct, frozen=True, kw_only=True):
    """What a keeper of versions or copies has told. end: where it runs. inbox: its folder.

    written: when it was told, UTC. The others are those of `InboxTold`.
    """

    end: str
    inbox: str
    written: str
    runs: str
    why: str
    states: dict[str, str]
    waiting: tuple[str, ...]
    busy: bool
    answers: tuple[str, ...]


class UpkeepText(msgspec.Struct, frozen=True, kw_only=True):
    """What the systems operator is shown. files: whether the session carries any."""

    files: bool
    transfers: tuple[TransferText, ...] = ()
    software: tuple[SoftwareText, ...] = ()


def pack_text(text: msgspec.Struct | dict[str, object]) -> str:
    return _ENCODER.encode(text).decode()


_Number = Annotated[int, msgspec.Meta(ge=0, le=1 << 53)]
_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
_WHOLE = 1 << 53
#: What a person types for an argument; whether it fits, the dictionary says.
_Value = (
    bool
    | Annotated[int, msgspec.Meta(ge=-_WHOLE, le=_WHOLE)]
    | float
    | Annotated[str, msgspec.Meta(max_length=64)]
)


class _Request(msgspec.Struct, frozen=True, tag_field="do", forbid_unknown_fields=True):
    request: _Number


class JoystickRequest(_Request, frozen=True, tag="joystick"):
    """A person's command to the joystick."""

    event: Literal["calibrate", "start", "halt", "acknowledge", "stop", "resume"]


class HandleRequest(_Request, frozen=True, tag="hand"):
    """Who holds the handle. policy: let the policy drive."""

    action: Literal["take", "give", "ask", "refuse", "policy"]


class StopRequest(_Request, frozen=True, tag="stop"):
    """Order the emergency stop of the robot, or release it."""

    action: Literal["stop", "release"]


class SessionRequest(_Request, frozen=True, tag="session"):
    """Start or stop the session."""

    action: Literal["start", "stop"]


class RecordingRequest(_Request, frozen=True, tag="record"):
    """Begin or end a recording of the session."""

    action: Literal["start", "stop"]


class ExerciseRequest(_Request, frozen=True, tag="exercise"):
    """Begin an exercise, or `end` all; the fields are those of `TrainerRequest`."""

    exercise: _Name
    seconds: float = 0.0
    camera: Annotated[str, msgspec.Meta(max_length=64)] = ""


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


class FetchRequest(_Request, frozen=True, tag="fetch"):
    """Fetch the status of the keeper with this inbox from the other end."""

    inbox: _Name


class ChatRequest(_Request, frozen=True, tag="chat"):
    """Write a line to the others."""

    text: Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


SeatRequest = (
    JoystickRequest
    | HandleRequest
    | SessionRequest
    | StopRequest
    | RecordingRequest
    | ExerciseRequest
    | CommandRequest
    | FetchRequest
    | ChatRequest
)

_Asked = TypeVar("_Asked")
_SEAT: msgspec.json.Decoder[SeatRequest] = msgspec.json.Decoder(SeatRequest)
_MEDIA = msgspec.json.Decoder(InputRequest)


def parse_seat_request(text: str) -> SeatRequest:
    """Return a request on the socket of a seat; ProtocolError for anything else."""
    return _parsed(_SEAT, text)


def parse_media_request(text: str) -> InputRequest:
    """Return a request on the socket of a camera or microphone; ProtocolError otherwise."""
    return _parsed(_MEDIA, text)


def _parsed(decoder: msgspec.json.Decoder[_Asked], text: str) -> _Asked:
    with refused("no request", *MALFORMED, raising=ProtocolError):
        return decoder.decode(text)
