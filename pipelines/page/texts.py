"""The JSON texts that a page is sent. A core. `_us`: the session's monotonic clock."""

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_US
from pipelines.page.access import Role
from pipelines.page.ownership import HandleState
from pipelines.page.seat_streams import SeatStream
from pipelines.setup.table import VideoStream
from pipelines.topology import InputRow, Segment, Topology
from telepresence.haptics.device.simulated import FACTS
from telepresence.world.state import BOARD_HEIGHT_M, BOARD_WIDTH_M, LEDS_M, WALL_X_M

#: The size of previews at most; `pipelines.cores.previewing` keeps the shape of the picture.
_PREVIEW_WIDTH = 160


class _Text(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    pass


class StreamText(_Text, frozen=True, kw_only=True):
    """A stream of the seat."""

    index: int
    name: str
    kind: str
    via: str
    cap_bps: int
    stale_after_ms: float
    width: int | None = None
    height: int | None = None
    fps: int | None = None


class CameraText(_Text, frozen=True, kw_only=True):
    """A camera that can be selected, and the inputs in its picture."""

    name: str
    inputs: tuple[str, ...]


class PreviewText(_Text, frozen=True, kw_only=True):
    """A small picture of an input."""

    index: int
    input: str


class InputText(_Text, frozen=True, kw_only=True):
    """An input that the page's own camera or microphone can take over."""

    index: int
    name: str
    kind: str
    width: int | None = None
    height: int | None = None
    fps: int | None = None


class BoardText(_Text, frozen=True, kw_only=True):
    """The task board of the built-in world."""

    width_m: float = BOARD_WIDTH_M
    height_m: float = BOARD_HEIGHT_M
    wall_x_m: float = WALL_X_M
    leds_m: tuple[tuple[float, float], ...] = tuple((x, y) for x, y in LEDS_M)


class WorkspaceText(_Text, frozen=True, kw_only=True):
    """Half of the handle's workspace."""

    half_width_m: float
    half_height_m: float


class HelloText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="hello"):
    """The first text of a connection: what there is at this seat."""

    seat: str
    role: str
    page: int
    now_us: int
    setup: str
    session: str
    streams: tuple[StreamText, ...]
    cameras: tuple[CameraText, ...]
    previews: tuple[PreviewText, ...]
    inputs: tuple[InputText, ...]
    joystick: str
    workspace: WorkspaceText
    board: dict[str, object]


class JoystickText(msgspec.Struct, frozen=True, kw_only=True):
    """The joystick."""

    state: str
    reason: str
    dead_man: bool
    force_limit_n: float
    device: str


class HandText(msgspec.Struct, frozen=True, kw_only=True):
    """Who holds the handle."""

    holder: int | None
    you: bool
    wanted_by: int | None


class StateText(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="state"):
    """The state ten times a second, which is also the heartbeat."""

    now_us: int
    link: str
    signal: bool
    camera: str | None
    joystick: JoystickText | None
    hand: HandText
    inputs: dict[str, int | None]


def hello(
    topology: Topology,
    segment: Segment,
    streams: tuple[SeatStream, ...],
    *,
    role: Role,
    page: int,
    now_ns: int,
    session: str,
    joystick: str,
) -> HelloText:
    """Return the first text of a page."""
    setup = topology.setup
    told = []
    for one in streams:
        stream = one.row.stream
        video = isinstance(stream, VideoStream)
        told.append(
            StreamText(
                index=one.index,
                name=one.row.name,
                kind="video" if video else "voice",
                via=one.via,
                cap_bps=stream.cap_bps,
                stale_after_ms=setup.stale_after_ns(stream) / NS_PER_MS,
                width=stream.width if isinstance(stream, VideoStream) else None,
                height=stream.height if isinstance(stream, VideoStream) else None,
                fps=stream.fps if isinstance(stream, VideoStream) else None,
            )
        )
    return HelloText(
        seat=segment.value,
        role=role.value,
        page=page,
        now_us=now_ns // NS_PER_US,
        setup=setup.name,
        session=session,
        streams=tuple(told),
        cameras=tuple(CameraText(name=row.name, inputs=row.inputs) for row in topology.cameras),
        previews=tuple(
            PreviewText(index=index, input=row.name)
            for index, row in enumerate(previewed_inputs(topology, segment))
        ),
        inputs=tuple(
            _input(topology, index, row) for index, row in enumerate(own_inputs(topology, segment))
        ),
        joystick=joystick,
        workspace=WorkspaceText(half_width_m=FACTS.half_width_m, half_height_m=FACTS.half_height_m),
        board=msgspec.to_builtins(
            {name: getattr(BoardText(), name) for name in BoardText.__struct_fields__}
        ),
    )


def own_inputs(topology: Topology, segment: Segment) -> tuple[InputRow, ...]:
    """Return the inputs that a page of this seat can take over: those of its segment."""
    return tuple(
        row for row in topology.inputs if topology.media(row.stream).direction.sender is segment
    )


def previewed_inputs(topology: Topology, segment: Segment) -> tuple[InputRow, ...]:
    """Return the inputs of which the seat shows small pictures."""
    if segment is Segment.SPACE:
        return ()
    return tuple(
        row
        for row in own_inputs(topology, segment)
        if isinstance(topology.media(row.stream).stream, VideoStream)
    )


def hand_text(state: HandleState, page: int) -> HandText:
    """Return who holds the handle, as page `page` is told."""
    return HandText(holder=state.holder, you=state.holder == page, wanted_by=state.wanted_by)


def _input(topology: Topology, index: int, row: InputRow) -> InputText:
    stream = topology.media(row.stream).stream
    if not isinstance(stream, VideoStream):
        return InputText(index=index, name=row.name, kind="audio")
    return InputText(
        index=index,
        name=row.name,
        kind="video",
        width=stream.width,
        height=stream.height,
        fps=stream.fps,
    )
