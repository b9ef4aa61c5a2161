"""The whole table, with lookups of rows."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import PORTS, Setup
from pipelines.session.topic import AnyTopic, Topic
from pipelines.session.topology.rows import (
    CameraRow,
    Frames,
    HapticRow,
    InputRow,
    LinkRow,
    MediaRow,
    ProcessRow,
    StreamRow,
    TopicRow,
    VideoRow,
)
from pipelines.session.topology.streams import (
    LAUNCHER_OFFSET,
    camera_row,
    input_rows,
    link_row,
    partner_ports,
    stream_rows,
)
from telepresence.haptics.device.stick_map import StickMap
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import SIMULATED
from telepresence.link.flows import Flow
from telepresence.tmtc.routes import TelemetryRoute
from telepresence.tmtc.telemetry_source import Component


@dataclass(frozen=True, kw_only=True)
class SessionOptions:
    """What a session has beside what its setup says.

    joystick, robot, second_robot: their SPECs; the last is the arm that a partner drives.
    joystick_map: which control of a game controller moves what; None: the usual.
    components: of users, in the telemetry. routes: of its data. Each flag: with the processes that
    `rows.py` of a room have under it. recorder: it can record. bypass: programs are joined past
    gateways and radio.
    """

    joystick: str = SIMULATED
    joystick_map: StickMap | None = None
    robot: str = SIMULATED_ROBOT
    second_robot: str = SIMULATED_ROBOT
    snapshots: bool = False
    pages: bool = False
    recorder: bool = False
    trainer: bool = False
    tasks: bool = False
    metrics: bool = False
    foxglove: bool = False
    packets: bool = False
    frames: bool = False
    ros2: bool = False
    files: bool = False
    bypass: bool = False
    components: tuple[Component, ...] = ()
    routes: tuple[TelemetryRoute, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Topology:
    """All processes, streams and topics of a session of `setup`.

    processes: in the order in which they are started; without any, it is the table of the streams.
    Lookups by name raise KeyError for a name that the session does not have.
    supervised: the processes of both ends in telemetry. They follow from setup and components
        alone, so that the ends of two machines agree; the session need not have all of them.
    segments: those that run on this machine. All rows are there in any case.
    """

    setup: Setup
    options: SessionOptions = SessionOptions()
    processes: tuple[ProcessRow, ...] = ()
    supervised: tuple[ProcessRow, ...] = ()
    segments: tuple[Segment, ...] = tuple(Segment)

    @cached_property
    def streams(self) -> tuple[StreamRow, ...]:
        """The streams of the radio link, by direction, and within one by priority."""
        files = self.options.files
        return tuple(row for way in Direction for row in stream_rows(self.setup, way, files=files))

    @cached_property
    def links(self) -> tuple[LinkRow, ...]:
        return tuple(link_row(self.setup, direction) for direction in Direction)

    @cached_property
    def inputs(self) -> tuple[InputRow, ...]:
        return tuple(input_rows(self.setup))

    @cached_property
    def cameras(self) -> tuple[CameraRow, ...]:
        return tuple(camera_row(self.setup, name, self.inputs) for name in self.setup.cameras)

    @property
    def composed(self) -> tuple[CameraRow, ...]:
        """The cameras that are composed of two inputs."""
        return tuple(row for row in self.cameras if row.composition is not None)

    @property
    def launcher_port(self) -> int:
        """The port that the launcher holds against a second session."""
        return self.setup.base_port + LAUNCHER_OFFSET

    @cached_property
    def topics(self) -> tuple[TopicRow, ...]:
        return tuple(
            TopicRow(
                name=name,
                writer=row.name,
                readers=tuple(one.name for one in self.processes if name in one.reads),
            )
            for row in self.processes
            for name in row.writes
        )

    def reads(self, process: str) -> tuple[AnyTopic, ...]:
        """The topics that a process reads, as far as anything writes them."""
        return tuple(name for name in self.process(process).reads if name in self._topics)

    def ports_of(self, process: str) -> tuple[int, ...]:
        radio = (link.port for link in self.links if link.receiver == process)
        out = {link.direction for link in self.links if link.sender == process}
        entries = (row.entry_port for row in self.streams if row.direction in out)
        exits = (row.exit_port for row in self.streams if row.receiver == process)
        return (*self.process(process).ports, *radio, *entries, *exits)

    @property
    def ports(self) -> range:
        """Every UDP port that a session may take."""
        return range(self.setup.base_port, self.setup.base_port + PORTS)

    def radio_port(self, segment: Segment) -> int:
        """Return the port on which a segment's gateway receives frames."""
        return self.link(segment.peer.transmits).port

    def frame_topics(self, segment: Segment) -> dict[Direction, Topic[Frames]]:
        """Return the topics with all frames that a segment's gateway handles."""
        out, back = self.link(segment.transmits), self.link(segment.peer.transmits)
        return {back.direction: back.received_frames_topic, out.direction: out.sent_frames_topic}

    def process(self, name: str) -> ProcessRow:
        return self._processes[name]

    @property
    def alone(self) -> Segment | None:
        """The only segment on this machine; None if both are."""
        return self.segments[0] if len(self.segments) == 1 else None

    @property
    def processes_here(self) -> tuple[ProcessRow, ...]:
        """The processes of this machine, in the order in which they are started."""
        return tuple(row for row in self.processes if self.runs(row.name))

    @property
    def ports_here(self) -> tuple[int, ...]:
        """The UDP ports that the session holds on this machine, the launcher's first.

        The radio's ports are not among them if the radio is between two machines.
        """
        if self.alone is None:
            # A partner's program may be there already.
            _, partner = partner_ports(self.setup)
            return tuple(port for port in self.ports if port != partner)
        radio = {self.radio_port(segment) for segment in Segment}
        taken = (port for row in self.processes_here for port in self.ports_of(row.name))
        return (self.launcher_port, *(port for port in taken if port not in radio))

    def runs(self, process: str) -> bool:
        segment = self._processes[process].segment
        return segment is None or segment in self.segments

    def side_here(self, row: StreamRow) -> str | None:
        """The only side of a stream on this machine, "sender" or "receiver"; None: both are."""
        if self.alone is None:
            return None
        return "sender" if row.direction.sender is self.alone else "receiver"

    def stream(self, name: str) -> StreamRow:
        return self._streams[name]

    def entry_port(self, stream: str) -> int:
        """Return the port to which a stream's sender sends.

        It is the port of the sending segment's gateway, or with `bypass` that of the receiver.
        """
        row = self._streams[stream]
        return row.exit_port if self.options.bypass else row.entry_port

    def exit_port(self, stream: str) -> int:
        """Return the port on which a stream's receiver listens, in the other segment."""
        return self._streams[stream].exit_port

    @cached_property
    def media_streams(self) -> tuple[MediaRow, ...]:
        """The pictures and voices, in the setup's order."""
        return tuple(self.media(stream.name) for stream in self.setup.streams)

    @property
    def video_streams(self) -> tuple[VideoRow, ...]:
        return tuple(row for row in self.media_streams if isinstance(row, VideoRow))

    def media(self, name: str) -> MediaRow:
        row = self._streams[name]
        if not isinstance(row, MediaRow):
            raise KeyError(name)
        return row

    @cached_property
    def haptics(self) -> tuple[HapticRow, ...]:
        """The haptic samples, up first."""
        return tuple(row for row in self.streams if isinstance(row, HapticRow))

    def haptic(self, key: str) -> HapticRow:
        return next(row for row in self.haptics if row.key == key)

    def flows(self, direction: Direction) -> tuple[Flow, ...]:
        """Return the flows of a direction; a flow's index is its number on the link."""
        rows = (row for row in self.streams if row.direction is direction)
        return tuple(row.flow for row in rows if row.flow is not None)

    def link(self, direction: Direction) -> LinkRow:
        return next(row for row in self.links if row.direction is direction)

    def gateway(self, segment: Segment) -> ProcessRow:
        return self.process(self.link(segment.transmits).sender)

    def input(self, name: str) -> InputRow:
        return next(row for row in self.inputs if row.name == name)

    def camera(self, name: str) -> CameraRow:
        return next(row for row in self.cameras if row.name == name)

    def topic(self, name: str) -> TopicRow:
        return self._topics[name]

    def video(self, name: str) -> VideoRow:
        row = self._streams[name]
        if not isinstance(row, VideoRow):
            raise KeyError(name)
        return row

    def shown_with(self, voice: str) -> VideoRow | None:
        """The picture that is shown where a voice is heard."""
        display = self.media(voice).display
        shown = (row for row in self.media_streams if row.display == display)
        return next((row for row in shown if isinstance(row, VideoRow)), None)

    @cached_property
    def _processes(self) -> Mapping[str, ProcessRow]:
        return {row.name: row for row in self.processes}

    @cached_property
    def _topics(self) -> Mapping[str, TopicRow]:
        return {row.name: row for row in self.topics}

    @cached_property
    def _streams(self) -> Mapping[str, StreamRow]:
        return {row.name: row for row in self.streams}
