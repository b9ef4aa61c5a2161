"""What a seat's pages are sent and may send, derived from the table of the session."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from math import ceil

import numpy as np

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, ROBOT_TRACE_TOPIC, charts_of
from pipelines.hand.knowledge import EndTraits
from pipelines.media.following import board_view
from pipelines.media.taking_over import preview_size
from pipelines.seats import texts
from pipelines.seats.mission_client import application_texts
from pipelines.session.access import Role
from pipelines.session.mission_messages import (
    MISSION_GROUND_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_STATUS_TOPIC,
    ExperimentShown,
    PanelShown,
    RobotStatus,
    TaskListed,
)
from pipelines.session.session_metrics import gathered
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import Setup, VideoStream, VoiceStream
from pipelines.session.topic import AnyTopic, Topic
from pipelines.session.topology.rows import Kind
from pipelines.session.topology.streams import partner_camera, partner_voice
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    RTC_CODED_CAMERA_TOPIC,
    RTC_VOICE_TOPIC,
)
from pipelines.session.training import CAMERA, EXERCISES, TRAINER_TOPIC, Exercises, TrainerReach
from telepresence.haptics.board import LEDS_M, LIGHTS_M, WALL_X_M, SpringModel
from telepresence.haptics.device.policy import PolicyAxis, policy_axes
from telepresence.haptics.device.stick_map import PadControls, pad_controls
from telepresence.haptics.joystick import JoystickModel
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import PAGE
from telepresence.link.gateway import Backlog
from telepresence.link.radio.orbit import next_overflight, parse_elements
from telepresence.link.radio.profile import RadioProfile
from telepresence.tasks.positions import goal_paths
from telepresence.tmtc.pus.dictionary import Dictionary


@dataclass(frozen=True, kw_only=True)
class SeatStream:
    """A stream for a seat's pages. topic: its units or blocks. text: what pages are told of it."""

    text: texts.StreamText
    topic: str

    @property
    def index(self) -> int:
        return self.text.index

    @property
    def via(self) -> texts.Via:
        return self.text.via


@dataclass(frozen=True, kw_only=True)
class SeatInput:
    """An input that a page may take over. size: of its pictures; None: it is sound."""

    index: int
    name: str
    topic: str
    size: tuple[int, int] | None
    fps: int


Shown = PanelShown | ExperimentShown | RobotStatus | Exercises | texts.UpkeepText
#: By end: kind of text, the topic of what the processes of a mission show.
_SHOWN: Mapping[Segment, Mapping[str, AnyTopic]] = {
    Segment.SPACE: {"panel": MISSION_PANEL_TOPIC, "exercises": TRAINER_TOPIC},
    Segment.GROUND: {
        "experiment": MISSION_GROUND_TOPIC,
        "robot": ROBOT_STATUS_TOPIC,
        "exercises": TRAINER_TOPIC,
    },
}


@dataclass(frozen=True, kw_only=True)
class SeatPlan:
    """A seat. traces: topics with samples of haptics, by the number of their end.

    previews: topics with the small pictures of inputs, by their numbers in messages.
    shown: what processes of the mission show here: by kind of text, the topic.
    traits: its end's; orders: whether its pages may start and stop the session.
    moved: a page moves the joystick. axes: of the robot, as a policy has them.
    """

    segment: Segment
    streams: tuple[SeatStream, ...]
    previews: Mapping[int, str]
    inputs: tuple[SeatInput, ...]
    traces: Mapping[int, str]
    backlog_topic: Topic[Backlog]
    text: texts.SeatText
    dictionary: Dictionary
    traits: EndTraits
    moved: bool
    axes: tuple[PolicyAxis, ...]
    shown: Mapping[str, AnyTopic] = field(default_factory=dict)

    @property
    def sizes(self) -> dict[int, tuple[int, int] | None]:
        """Sizes of the inputs' pictures, by index; None for sound."""
        return {each.index: each.size for each in self.inputs}


def seat_plan(
    topology: Topology,
    segment: Segment,
    session: str,
    dictionary: Dictionary,
    *,
    tasks: Sequence[TaskListed] = (),
) -> SeatPlan:
    """Return the plan of a segment's seat.

    session: the name of the session. dictionary: of its telecommands and telemetry.
    tasks: what people in space know of them, in a session with some.
    """
    setup = topology.setup
    written = {topic for row in topology.processes for topic in row.writes}
    ground, tasked = segment is Segment.GROUND, topology.options.tasks
    moved = topology.options.joystick == PAGE
    has_board = tasked or (topology.options.robot == SIMULATED_ROBOT and not setup.marks)
    streams = tuple(_streams(topology, segment))
    previews = dict(_previews(topology)) if ground else {}
    inputs = tuple(_inputs(topology, segment))
    text = texts.SeatText(
        seat=segment,
        setup=setup.name,
        session=session,
        streams=tuple(each.text for each in streams),
        cameras=tuple(
            texts.CameraText(
                name=row.name,
                inputs=row.inputs,
                layout=row.composition.layout if row.composition else "",
            )
            for row in topology.cameras
        ),
        previews=tuple(previews),
        inputs=tuple(_input_text(each) for each in inputs),
        joystick=topology.options.joystick,
        workspace=gathered(texts.WorkspaceText, JoystickModel()),
        charts=charts_of([axis.place for axis in setup.more_axes]),
        board=texts.BoardText(
            width_m=2 * setup.safety.half_width_m,
            height_m=2 * setup.safety.half_height_m,
            wall_x_m=WALL_X_M if has_board else None,
            marks=tuple(
                texts.MarkText(name=name, **asdict(mark)) for name, mark in setup.marks.items()
            ),
            leds_m=LEDS_M if has_board else (),
            lights_m=LIGHTS_M if tasked else (),
            paths_m=goal_paths() if tasked else {},
            spring_m=(SpringModel().x_m, 0.0),
        ),
        caps={each.value: topology.link(each).profile.capacity_bps for each in Direction},
        applications=application_texts(dictionary),
        tasks=tasked,
        task_list=tuple(gathered(texts.TaskText, task) for task in tasks),
        views={} if ground else dict(_views(setup)),
        passes=tuple(passes_ahead(setup.radio_profile)) if ground else (),
        exercises=tuple(_exercises(topology)) if topology.options.trainer else (),
        pad=_pad(topology) if moved else None,
    )
    return SeatPlan(
        segment=segment,
        streams=streams,
        previews={each.index: topic for each, topic in previews.items()},
        inputs=inputs,
        traces={1: ROBOT_TRACE_TOPIC} if ground else {0: JOYSTICK_TRACE_TOPIC},
        backlog_topic=topology.link(segment.transmits).backlog_topic,
        dictionary=dictionary,
        shown={kind: topic for kind, topic in _SHOWN[segment].items() if topic in written},
        traits=EndTraits.of(topology, segment),
        moved=moved,
        axes=policy_axes(setup.axes, setup.more_axes),
        text=text,
    )


def _pad(topology: Topology) -> PadControls | None:
    """What a game controller at a page does; None: the usual."""
    mapping = topology.options.joystick_map
    return None if mapping is None else pad_controls(mapping, topology.setup.more_axes)


def _views(setup: Setup) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Where the board is in the pictures of the cameras of which that is known."""
    stream = setup.uplink_video
    for camera in setup.cameras:
        view = board_view(setup, camera)
        if view is not None:
            yield camera, view.shares(stream.width, stream.height)


def welcome_text(
    role: Role,
    segment: Segment,
    *,
    ports: dict[str, int],
    people: dict[str, str],
    tasks: bool,
    trainer: bool = False,
) -> texts.WelcomeText:
    """Return what a person of `role` is told where people choose a page.

    people: by role, its token; tokens of others are for the owner alone.
    """
    told = people if role is Role.OPERATOR else {}
    return texts.WelcomeText(
        role=role, seat=segment, ports=ports, tasks=tasks, trainer=trainer, people=told
    )


def _exercises(topology: Topology) -> Iterator[texts.ExerciseText]:
    """What the trainer of this machine can do, each camera apart."""
    reach = TrainerReach.of(topology)
    for name, (text, seconds) in EXERCISES.items():
        for camera in reach.cameras if name == CAMERA else ("",):
            if not reach.lacks(name, camera):
                yield texts.ExerciseText(name=name, text=text, seconds=seconds, camera=camera)


def _streams(topology: Topology, segment: Segment) -> Iterator[SeatStream]:
    told = partial(_stream_text, topology)
    index = 0
    for row in topology.media_streams:
        comes = row.direction.receiver is segment
        if row.kind is Kind.VOICE and comes:
            via, topic = texts.Via.SOUND, row.received_topic
        elif row.kind is Kind.VIDEO and comes:
            via, topic = texts.Via.CODED, row.coded_topic
        elif row.kind is Kind.VIDEO and segment is Segment.GROUND:
            via, topic = texts.Via.SENT, row.sent_topic
        else:
            continue
        yield SeatStream(text=told(index, via, row.stream), topic=topic)
        index += 1
    leg = topology.setup.rtc
    if segment is Segment.GROUND and leg is not None:
        # The picture and the voice of a partner across the Internet.
        yield SeatStream(
            text=told(index, texts.Via.CODED, partner_camera(leg)),
            topic=RTC_CODED_CAMERA_TOPIC,
        )
        voice = told(index + 1, texts.Via.SOUND, partner_voice(leg))
        yield SeatStream(text=voice, topic=RTC_VOICE_TOPIC)


def _stream_text(
    topology: Topology, index: int, via: texts.Via, stream: VideoStream | VoiceStream
) -> texts.StreamText:
    video = stream if isinstance(stream, VideoStream) else None
    return texts.StreamText(
        index=index,
        name=stream.name,
        kind="voice" if video is None else "video",
        via=via,
        cap_bps=stream.cap_bps,
        stale_after_ms=topology.setup.stale_after_ns(stream) / NS_PER_MS,
        width=None if video is None else video.width,
        height=None if video is None else video.height,
        fps=None if video is None else video.fps,
    )


def _previews(topology: Topology) -> Iterator[tuple[texts.PreviewText, str]]:
    """The small pictures of each camera input, and their topics."""
    for index, name in enumerate(topology.setup.camera_inputs):
        stream = topology.setup.stream_of(name)
        width, height = preview_size(stream.width, stream.height)
        text = texts.PreviewText(index=index, input=name, width=width, height=height)
        yield text, topology.input(name).preview_topic


def _inputs(topology: Topology, segment: Segment) -> Iterator[SeatInput]:
    setup = topology.setup
    rows = [
        row for row in topology.inputs if topology.media(row.stream).direction.sender is segment
    ]
    for index, row in enumerate(rows):
        stream = topology.media(row.stream).stream
        video = isinstance(stream, VideoStream)
        # The robot's cameras are no seat's, unless the user wants a page for one.
        if video and segment is Segment.GROUND and setup.source(row.name) != "page":
            continue
        yield SeatInput(
            index=index,
            name=row.name,
            topic=row.page_topic,
            size=(stream.width, stream.height) if isinstance(stream, VideoStream) else None,
            fps=ceil(stream.fps) if isinstance(stream, VideoStream) else 50,
        )


def _input_text(one: SeatInput) -> texts.InputText:
    if one.size is None:
        return texts.InputText(index=one.index, name=one.name, kind="audio")
    return gathered(texts.InputText, one, kind="video", width=one.size[0], height=one.size[1])


_MOST = 5


def passes_ahead(profile: RadioProfile) -> Iterator[texts.PassText]:
    """This session's pass and the next four; none of a radio without an orbit."""
    contact = profile.contact
    if contact is None:
        return
    elements = parse_elements(contact.elements)
    station = contact.latitude_deg, contact.longitude_deg, contact.altitude_m
    after, first = contact.after, None
    for _ in range(_MOST):
        try:
            flight = next_overflight(
                elements, station, after, contact.horizon_deg, contact.least_peak_deg
            )
        except ConfigError:
            return
        rise = np.datetime64(flight.rise.removesuffix("Z"), "s")
        first = rise if first is None else first
        acquisition_s = float((rise - first).astype(int))
        yield texts.PassText(
            acquisition=flight.rise,
            acquisition_s=acquisition_s,
            loss_s=round(acquisition_s + flight.visible_s, 1),
            peak_deg=round(max(flight.elevations_deg), 1),
        )
        after = f"{rise + np.timedelta64(round(flight.visible_s) + 60, 's')}Z"
