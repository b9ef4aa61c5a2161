"""The processes of a session, with their topics."""

from collections.abc import Iterable
from dataclasses import replace

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import STEREO, STEREO_INPUTS, VideoStream
from pipelines.session.topology.mission import (
    MISSION_SAMPLES,
    MISSION_SHOWN,
    ROBOT_COMMAND_TOPIC,
    ROBOT_STATUS_TOPIC,
    with_mission,
)
from pipelines.session.topology.partner import PARTNER_SAMPLES, with_partner
from pipelines.session.topology.rows import (
    LOOP_PRIORITY,
    VOICE_PRIORITY,
    Kind,
    MediaRow,
    ProcessRow,
    Stage,
    TopicRow,
    VideoRow,
)
from pipelines.session.topology.rtc import RTC_RECORDED, RTC_SAMPLES, RTC_SEEN, rtc_rows
from pipelines.session.topology.streams import STEREO_TOPIC, TELECOMMAND, TELEMETRY
from pipelines.session.topology.table import Topology
from telepresence.haptics.device.spec import PAGE

#: The state of the robot, from which the built-in scenes draw.
ROBOT_TOPIC = "robot/state"
#: The camera that the sender of the uplink video must follow, and the choice that it has confirmed.
SELECTED_TOPIC = "selected/uplink_video"
FOLLOWED_TOPIC = "followed/uplink_video"
#: The newest message with the wall that the joystick renders, where the hand is mediated.
WALL_TOPIC = "received/wall"
#: What the operator's page and the joystick tell each other; see `pipelines.hand.hand_topics`.
HAND_INPUT_TOPIC = "hand/input"
HAND_REQUEST_TOPIC = "hand/request"
JOYSTICK_COMMAND_TOPIC = "joystick/command"
JOYSTICK_STATE_TOPIC = "joystick/state"
#: Both ends' haptic samples at 1 kHz; see `pipelines.hand.haptic_trace`.
JOYSTICK_TRACE_TOPIC = "haptic/joystick"
ROBOT_TRACE_TOPIC = "haptic/robot"


def packets_topic(stream: str, *, sent: bool) -> str:
    """The space packets of a stream of telecommands or telemetry, at one of its ends."""
    return f"{stream}/{'sent' if sent else 'received'}"


def gateway_topic(segment: Segment) -> str:
    """The figures of a segment's gateway: `telepresence.link.figures.GatewayFigures`."""
    return f"figures/{segment.value}"


def link_state_topic(segment: Segment) -> str:
    """What telemetry says of a segment's gateway: `pipelines.mission.tmtc_sources.link_values`."""
    return f"link_state/{segment.value}"


#: By segment: what its end of telecommands and telemetry has to say, one `TmtcNews` a sample.
TMTC_TOPICS = {segment: f"tmtc/{segment.value}" for segment in Segment}
#: What a trainer wants to happen: `pipelines.session.training.Exercises`.
TRAINER_TOPIC = "trainer/exercises"
#: The process that takes a trainer's requests.
TRAINER = "trainer"
#: The process that records the session.
RECORDER = "recorder"
#: By segment: the process that serves its browser pages.
PAGES = {segment: f"page_{segment.value}" for segment in Segment}


def process_rows(
    session: Topology,
    *,
    joystick: str,
    snapshots: bool,
    pages: bool,
    recorder: bool,
    trainer: bool,
    tasks: bool,
) -> tuple[ProcessRow, ...]:
    """The processes, in the order in which they are started, of a table that has none yet."""
    rows = [*_ground(session), *_space(session, joystick, pages=pages)]
    rows = list(with_partner(rows, session.setup))
    if tasks:
        rows = list(
            with_mission(
                rows,
                session.setup,
                cameras=_cameras(session),
                news=TMTC_TOPICS,
                joystick_state=JOYSTICK_STATE_TOPIC,
                link_state={segment: link_state_topic(segment) for segment in Segment},
                selected=SELECTED_TOPIC,
                robot=ROBOT_TOPIC,
            )
        )
    if pages:
        rows = [_taken_over(row, session) for row in rows]
        rows += [_page(session, segment, tasks=tasks) for segment in Segment]
    if trainer:
        rows = [_trained(row, session) for row in rows]
        rows.append(_trainer())
    if snapshots:
        rows.append(_snapshots(session))
    rows += rtc_rows(session, SELECTED_TOPIC)
    if recorder:
        rows.insert(0, _recorder(session))
    rows.sort(key=lambda row: row.stage)
    return tuple(_with_streams(row, session) for row in rows)


def topic_rows(session: Topology) -> Iterable[TopicRow]:
    """The topics of a table that has its processes."""
    samples = {
        ROBOT_TOPIC: "instant, place of the tip, force and contact",
        STEREO_TOPIC: "two pictures side by side",
        SELECTED_TOPIC: "name of the selected camera, number of the choice",
        WALL_TOPIC: "message with the wall that the robot touched",
        **PARTNER_SAMPLES,
        **MISSION_SAMPLES,
        TRAINER_TOPIC: "until when a trainer's exercises last",
        FOLLOWED_TOPIC: "number of the choice that the sender has confirmed",
        HAND_INPUT_TOPIC: "where a page's hand wants the handle, dead-man button",
        HAND_REQUEST_TOPIC: "a person's command to the joystick",
        JOYSTICK_COMMAND_TOPIC: "a telecommand to the joystick",
        JOYSTICK_STATE_TOPIC: "state of the joystick, answer to a command",
        **RTC_SAMPLES,
        JOYSTICK_TRACE_TOPIC: "20 ms of the handle: place, force, energy",
        ROBOT_TRACE_TOPIC: "20 ms of the tip: place, force, energy",
    }
    for row in session.inputs:
        video = isinstance(session.media(row.stream).stream, VideoStream)
        samples[row.topic] = "captured picture" if video else "20 ms of captured sound"
        samples[row.preview_topic] = "small picture, 5 a second"
        samples[row.page_topic] = f"{'picture' if video else '20 ms of sound'} of a browser page"
    for segment in Segment:
        samples[gateway_topic(segment)] = "what the gateway counts, ten times a second"
        samples[link_state_topic(segment)] = "what telemetry says of the gateway"
        samples[TMTC_TOPICS[segment]] = "reports, verification, what applications are asked for"
    for name in (TELECOMMAND, TELEMETRY):
        samples[packets_topic(name, sent=True)] = "space packet as sent"
        samples[packets_topic(name, sent=False)] = "space packet as received"
    for link in session.links:
        samples[link.backlog_topic] = "what waits in the gateway, state of the radio"
        samples[link.sent_frames_topic] = "20 ms of frames as sent"
        samples[link.received_frames_topic] = "20 ms of frames as received"
    for media in session.media_streams:
        video = media.kind is Kind.VIDEO
        samples[media.received_topic] = "decoded picture" if video else "decoded sound"
        samples[media.coded_topic] = "received access unit" if video else "Opus packet as played"
        samples[media.sent_topic] = f"{'access unit' if video else 'Opus packet'} as it was sent"
        if isinstance(media, VideoRow):
            samples[media.displayed_topic] = "picture, marked where it is stale"
            samples[media.lag_topic] = "how late the newest picture was shown"
            samples[media.decoded_topic] = "decoded picture in its coded size"
    for process in session.processes:
        for name in process.writes:
            yield TopicRow(
                name=name,
                writer=process.name,
                readers=tuple(row.name for row in session.processes if name in row.reads),
                sample=samples[name],
            )


def _ground(session: Topology) -> Iterable[ProcessRow]:
    setup = session.setup
    yield _gateway(session, Segment.GROUND)
    yield ProcessRow(
        name="robot",
        segment=Segment.GROUND,
        stage=Stage.LINK,
        run="pipelines.hand.process_ends:run_robot",
        priority=LOOP_PRIORITY,
        reads=(ROBOT_COMMAND_TOPIC,),
        writes=(ROBOT_TOPIC, ROBOT_STATUS_TOPIC, ROBOT_TRACE_TOPIC),
        what="1 kHz loop of the robot and its task board",
    )
    video = session.media(setup.uplink_video.name)
    for name in video.inputs:
        yield _capture(session, name)
    if STEREO in setup.cameras:
        yield ProcessRow(
            name="stereo",
            segment=Segment.GROUND,
            stage=Stage.RELAY,
            run="pipelines.media.process_stereo:run_stereo",
            reads=tuple(session.input(name).topic for name in STEREO_INPUTS),
            writes=(STEREO_TOPIC,),
            what="merges the robot's two cameras into one picture",
        )
    yield ProcessRow(
        name="selector",
        segment=Segment.GROUND,
        stage=Stage.RELAY,
        run="pipelines.mission.process_selector:run_selector",
        reads=(
            FOLLOWED_TOPIC,
            ROBOT_TOPIC,
            ROBOT_STATUS_TOPIC,
            link_state_topic(Segment.GROUND),
        ),
        writes=(
            SELECTED_TOPIC,
            ROBOT_COMMAND_TOPIC,
            TMTC_TOPICS[Segment.GROUND],
            packets_topic(TELECOMMAND, sent=False),
            packets_topic(TELEMETRY, sent=True),
        ),
        what="PUS of the ground; tells the sender which camera telecommands select",
    )
    cameras = tuple(camera.topic for camera in session.cameras)
    tip = () if setup.region == "off" else (ROBOT_TOPIC,)
    yield replace(
        _send(video, None),
        reads=(SELECTED_TOPIC, *cameras, video.backlog_topic, *tip),
        writes=(FOLLOWED_TOPIC, video.sent_topic),
    )
    if setup.uplink_voice is not None:
        yield from _say(session, setup.uplink_voice.name)
    yield from _end(session, Segment.GROUND)


def _space(session: Topology, joystick: str, *, pages: bool) -> Iterable[ProcessRow]:
    setup = session.setup
    wall = (WALL_TOPIC,) if setup.hand == "mediated" else ()
    page = (HAND_REQUEST_TOPIC,) if pages else ()
    if pages and joystick == PAGE:
        page = (HAND_INPUT_TOPIC, *page)
    yield _gateway(session, Segment.SPACE)
    yield ProcessRow(
        name="joystick",
        segment=Segment.SPACE,
        stage=Stage.LINK,
        run="pipelines.hand.process_ends:run_joystick",
        arguments={"spec": joystick},
        priority=LOOP_PRIORITY,
        reads=(*wall, *page, JOYSTICK_COMMAND_TOPIC),
        writes=(JOYSTICK_STATE_TOPIC, JOYSTICK_TRACE_TOPIC),
        what="1 kHz loop of the operator's joystick",
    )
    yield ProcessRow(
        name="console",
        segment=Segment.SPACE,
        stage=Stage.LINK,
        run="pipelines.mission.process_console:run_console",
        reads=(JOYSTICK_STATE_TOPIC, link_state_topic(Segment.SPACE)),
        writes=(
            *wall,
            JOYSTICK_COMMAND_TOPIC,
            TMTC_TOPICS[Segment.SPACE],
            packets_topic(TELECOMMAND, sent=True),
            packets_topic(TELEMETRY, sent=False),
        ),
        what="PUS of space: sends telecommands",
    )
    yield from _end(session, Segment.SPACE)
    for stream in (setup.downlink_video, setup.downlink_voice):
        if stream is not None:
            yield from _say(session, stream.name)


def _gateway(session: Topology, segment: Segment) -> ProcessRow:
    link, back = session.link(segment.transmits), session.link(segment.transmits.opposite)
    return ProcessRow(
        name=link.sender,
        segment=segment,
        stage=Stage.LINK,
        run="pipelines.link.process_gateway:run_gateway",
        arguments={"segment": segment},
        priority=LOOP_PRIORITY,
        writes=(
            link.backlog_topic,
            gateway_topic(segment),
            link_state_topic(segment),
            link.sent_frames_topic,
            back.received_frames_topic,
        ),
        what="1 kHz slots: this segment's end of the radio link",
    )


def _capture(session: Topology, name: str) -> ProcessRow:
    row = session.input(name)
    media = session.media(row.stream)
    video = media.kind is Kind.VIDEO
    return ProcessRow(
        name=row.process,
        segment=media.direction.sender,
        stage=Stage.SOURCE,
        run=f"pipelines.media.process_capture:{'run_camera' if video else 'run_microphone'}",
        arguments={"name": name, "stream": media.stream} if video else {"name": name},
        priority=0 if video else VOICE_PRIORITY,
        reads=(ROBOT_TOPIC,),
        writes=(row.topic, row.preview_topic) if video else (row.topic,),
        what="captures pictures" if video else "captures sound",
    )


def _taken_over(row: ProcessRow, session: Topology) -> ProcessRow:
    """The process of an input also takes what a page gives for it; all others are unchanged."""
    for one in session.inputs:
        if one.process == row.name:
            arguments = {**row.arguments, "page": one.page_topic}
            return replace(row, arguments=arguments, reads=(*row.reads, one.page_topic))
    return row


def _trained(row: ProcessRow, session: Topology) -> ProcessRow:
    """A gateway, the joystick or a camera also heeds the trainer; all others are unchanged."""
    cameras = _cameras(session)
    gateways = {link.sender for link in session.links}
    if row.name not in cameras | gateways | {"joystick"}:
        return row
    arguments = {**row.arguments, "trainer": True}
    return replace(row, arguments=arguments, reads=(*row.reads, TRAINER_TOPIC))


def _cameras(session: Topology) -> set[str]:
    """The processes that capture pictures."""
    return {
        one.process
        for one in session.inputs
        if isinstance(session.media(one.stream).stream, VideoStream)
    }


def _trainer() -> ProcessRow:
    return ProcessRow(
        name=TRAINER,
        segment=None,
        stage=Stage.LINK,
        run="pipelines.mission.process_trainer:run_trainer",
        writes=(TRAINER_TOPIC,),
        what="takes a trainer's requests: no signal, a fault, a lost camera",
    )


def _say(session: Topology, stream: str) -> Iterable[ProcessRow]:
    """A stream with one input, from capture to sender."""
    media = session.media(stream)
    (name,) = media.inputs
    yield _capture(session, name)
    yield _send(media, session.input(name).topic)


def _send(media: MediaRow, topic: str | None) -> ProcessRow:
    video = media.kind is Kind.VIDEO
    return ProcessRow(
        name=media.sender,
        segment=media.direction.sender,
        stage=Stage.SENDER,
        run="pipelines.media.process_video_send:run_video_send"
        if video
        else "pipelines.media.process_voice_send:run_voice_send",
        arguments={"stream": media.stream, "topic": topic},
        priority=0 if video else VOICE_PRIORITY,
        reads=(*((topic,) if topic else ()), *((media.backlog_topic,) if video else ())),
        writes=(media.sent_topic,),
        what="encodes and sends pictures" if video else "encodes and sends sound",
    )


def _end(session: Topology, segment: Segment) -> Iterable[ProcessRow]:
    """The processes that receive and show pictures and sounds in a segment."""
    rows = [row for row in session.media_streams if row.direction.receiver is segment]
    lag_topics = tuple(row.lag_topic for row in rows if isinstance(row, VideoRow))
    shown = tuple(row.displayed_topic for row in rows if isinstance(row, VideoRow))
    for row in rows:
        video = row.kind is Kind.VIDEO
        yield ProcessRow(
            name=row.receiver,
            segment=segment,
            stage=Stage.RECEIVER,
            run="pipelines.media.process_video_receive:run_video_receive"
            if video
            else "pipelines.media.process_voice_receive:run_voice_receive",
            arguments={"stream": row.stream},
            priority=0 if video else VOICE_PRIORITY,
            reads=() if video else lag_topics,
            writes=(
                row.received_topic,
                row.coded_topic,
                *((row.decoded_topic,) if isinstance(row, VideoRow) else ()),
            ),
            what="receives and decodes pictures" if video else "receives and decodes sound",
        )
    if rows:
        yield ProcessRow(
            name=rows[0].display,
            segment=segment,
            stage=Stage.SINK,
            run="pipelines.media.process_display:run_display",
            arguments={"streams": tuple(row.stream for row in rows)},
            priority=VOICE_PRIORITY,
            reads=tuple(row.received_topic for row in rows),
            writes=(*shown, *lag_topics),
            what="shows pictures and plays sounds",
        )


def _snapshots(session: Topology) -> ProcessRow:
    rows = (row for row in session.media_streams if isinstance(row, VideoRow))
    stereo = (STEREO_TOPIC,) if STEREO in session.setup.cameras else ()
    return ProcessRow(
        name="snapshots",
        segment=None,
        stage=Stage.SINK,
        run="pipelines.media.process_snapshots:run_snapshots",
        reads=(*(row.displayed_topic for row in rows), *stereo),
        what="keeps what is shown as PNG files",
    )


def _recorder(session: Topology) -> ProcessRow:
    """It is started first, so that it misses nothing."""
    cameras = (row for row in session.inputs if session.media(row.stream).kind is Kind.VIDEO)
    return ProcessRow(
        name=RECORDER,
        segment=None,
        stage=Stage.LINK,
        run="pipelines.recording.process_recorder:run_recorder",
        reads=(
            ROBOT_TRACE_TOPIC,
            JOYSTICK_TRACE_TOPIC,
            SELECTED_TOPIC,
            *(
                topic
                for row in session.media_streams
                for topic in (row.sent_topic, row.coded_topic)
            ),
            *(RTC_RECORDED if session.setup.rtc is not None else ()),
            *(
                packets_topic(name, sent=sent)
                for name in (TELECOMMAND, TELEMETRY)
                for sent in (True, False)
            ),
            *(gateway_topic(segment) for segment in Segment),
            *(
                topic
                for link in session.links
                for topic in (link.sent_frames_topic, link.received_frames_topic)
            ),
            *(row.topic for row in cameras),
        ),
        what="records the session, if that is wished",
    )


def _page(session: Topology, segment: Segment, *, tasks: bool) -> ProcessRow:
    """What a seat shows of its own segment, and what its person tells it, films and says."""
    rows = [row for row in session.media_streams if row.direction.receiver is segment]
    sounds = (row.received_topic for row in rows if row.kind is Kind.VOICE)
    pictures = [row for row in rows if isinstance(row, VideoRow)]
    link = session.link(segment.transmits).backlog_topic
    space = segment is Segment.SPACE
    joystick, robot = (JOYSTICK_STATE_TOPIC, JOYSTICK_TRACE_TOPIC), (ROBOT_TRACE_TOPIC,)
    taken = [row for row in session.inputs if session.media(row.stream).direction.sender is segment]
    return ProcessRow(
        name=PAGES[segment],
        segment=segment,
        stage=Stage.SINK,
        run="pipelines.seats.process_page:run_page",
        arguments={"segment": segment},
        reads=(
            *(topic for row in pictures for topic in (row.coded_topic, row.decoded_topic)),
            *sounds,
            link,
            TMTC_TOPICS[segment],
            *(MISSION_SHOWN[segment] if tasks else ()),
            *(() if space or session.setup.rtc is None else RTC_SEEN),
            *(joystick if space else (*_robot_seen(session), SELECTED_TOPIC, *robot)),
        ),
        writes=(
            *((HAND_INPUT_TOPIC, HAND_REQUEST_TOPIC) if space else ()),
            *(row.page_topic for row in taken),
        ),
        what="serves the operator's page" if space else "serves ground's page",
    )


def _robot_seen(session: Topology) -> Iterable[str]:
    """What the ground sees of its own cameras: the picture as it is sent, and all of them small.

    The pictures themselves only for a page that joins a stream of which nothing is known.
    """
    video = session.video(session.setup.uplink_video.name)
    yield video.sent_topic
    yield from (row.topic for row in session.cameras)
    yield from (session.input(name).preview_topic for name in video.inputs)


def _with_streams(row: ProcessRow, session: Topology) -> ProcessRow:
    """The row with the streams and the ports of its process."""
    radio = [link.port for link in session.links if link.receiver == row.name]
    out = {link.direction for link in session.links if link.sender == row.name}
    entries = [stream.entry_port for stream in session.streams if stream.direction in out]
    exits = [stream.exit_port for stream in session.streams if stream.receiver == row.name]
    return replace(
        row,
        sends=tuple(stream.name for stream in session.streams if stream.sender == row.name),
        receives=tuple(stream.name for stream in session.streams if stream.receiver == row.name),
        ports=(*row.ports, *radio, *entries, *exits),
    )
