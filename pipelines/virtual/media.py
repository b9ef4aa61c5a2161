"""The media of a simulated session, joined: inputs, senders and receivers with their coders."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from typing import cast

from kontur_av.errors import ConfigError
from kontur_av.media import BLOCK_NS, I420, CaptureStamp, VideoFrame
from kontur_av.sources.instants import Pace
from kontur_av.sources.source import FILLED_BY_OTHERS
from kontur_av.sources.spec import is_address
from kontur_av.sources.stereo import PicturePairer
from pipelines.media.following import Choice
from pipelines.media.media_metrics import CompositionMetrics
from pipelines.media.showing import OPERATORS, Showing
from pipelines.media.taking_over import Capturing
from pipelines.session.setup.sources import check_sources
from pipelines.session.setup.table import (
    GROUND_MIC,
    OPERATOR_CAMERA,
    OPERATOR_MIC,
    VOICE_PACKETS_PER_S,
    Setup,
    VideoStream,
    VoiceStream,
)
from pipelines.session.topology.rows import CameraRow
from pipelines.virtual.streams import (
    Consumer,
    Display,
    VideoReceiveProcess,
    VideoSendProcess,
    VoiceProcess,
    VoiceReceiveProcess,
    VoiceSendProcess,
)
from pipelines.virtual.studio import Paired, Picture, Shot, VideoDecoding, VideoStudio, VoiceStudio
from pipelines.virtual.workers import Coder, Job, Scene, Worker
from telepresence.link.gateway import Backlog
from telepresence.world import WorldState

#: Takes a captured picture: (picture, stamp, now).
ShowPicture = Callable[[Picture, CaptureStamp, int], None]


def check_virtual_sources(setup: Setup) -> None:
    """ConfigError for an input that cannot be opened, or exists in real time only: a pipe, say."""
    for name in setup.inputs:
        spec = setup.source(name)
        kind, colon, _ = spec.partition(":")
        live = (colon and kind in ("pipe", "v4l2", "alsa")) or is_address(spec)
        if live or spec in FILLED_BY_OTHERS:
            raise ConfigError(
                f"input {name}: {spec} lives in real time; "
                "a simulation takes scene:NAME, a media file or mcap:FILE#CHANNEL"
            )
    check_sources(setup, setup.inputs)


class _Input:
    """Captures at its instants, with or without readers.

    film: plays its file; None for a scene, which is captured at `pace`. take: called with each, and
    the state of the world, None for a file's.
    job: asks for the file's next picture or block. block_ns: what is captured began so long before.
    """

    def __init__(
        self,
        scene: Scene,
        name: str,
        film: Worker | None,
        pace: Pace,
        take: Callable[[CaptureStamp, WorldState | None, int], None],
        *,
        job: str | None = None,
        block_ns: int = 0,
    ) -> None:
        self._name, self._agenda, self._state_at = name, scene.agenda, scene.state_at
        self._film, self._pace, self._take = film, pace, take
        self._job, self._block_ns = job, block_ns
        self._coming: Job | None = None
        self._sequence = 0
        self._capturing = Capturing(scene.telling.probe(scene.topology.input(name).process))
        scene.telling.add(self._capturing.publish)
        if film is None:
            self._agenda.at(pace.due_ns(scene.start_ns), self._capture)
        else:
            self._ask(film)
            self._agenda.at(scene.start_ns, self._wait)

    def _ask(self, film: Worker) -> None:
        """Begin to prepare the file's next picture or block."""
        self._coming = film.submit(self._job)

    def _stamp(self, capture_ns: int) -> CaptureStamp:
        stamp = CaptureStamp(capture_ns, self._sequence, self._name)
        self._sequence += 1
        self._capturing.handle_captured(stamp)
        return stamp

    def _capture(self, now_ns: int) -> None:
        self._take(self._stamp(now_ns - self._block_ns), self._state_at(now_ns), now_ns)
        self._pace.handle_taken()
        self._agenda.at(self._pace.due_ns(now_ns), self._capture)

    def _wait(self, now_ns: int) -> None:
        assert self._coming is not None and self._film is not None
        capture_ns = self._coming.result()
        if capture_ns is not None:
            self._ask(self._film)
            self._agenda.at(max(capture_ns + self._block_ns, now_ns), self._play)

    def _play(self, now_ns: int) -> None:
        self._take(self._stamp(now_ns - self._block_ns), None, now_ns)
        self._wait(now_ns)


class Camera(_Input):
    """Captures pictures of a scene at its rate, or pictures of a file at the file's instants.

    film: plays the file; None for a scene. show: called the cost of a capture after each.
    ahead: called at once with each that is drawn.
    """

    def __init__(
        self,
        scene: Scene,
        name: str,
        fps: float,
        film: Worker | None,
        show: ShowPicture,
        ahead: Callable[[Shot], object] | None = None,
    ) -> None:
        self._cost_ns, self._show, self._ahead = scene.costs.ns("capture"), show, ahead
        # All cameras capture at the same instants. Live scenes have phases to spread the load of
        # the machine; here the encoders of the same instant share the cores.
        super().__init__(scene, name, film, Pace(fps, scene.start_ns), self._shoot, job=name)

    def _shoot(self, stamp: CaptureStamp, state: WorldState | None, now_ns: int) -> None:
        shot = Shot(self._name, stamp.sequence, state)
        if state is not None and self._ahead is not None:
            self._ahead(shot)
        self._agenda.at(now_ns + self._cost_ns, partial(self._show, shot, stamp))


class Microphone(_Input):
    """Captures sound in blocks of 20 ms.

    studio: encodes. film: as of `Camera`. show: called with a whole block and the job whose result
    is its Opus packet.
    """

    def __init__(
        self,
        scene: Scene,
        name: str,
        studio: Worker,
        film: Worker | None,
        show: Callable[[CaptureStamp, Job, int], None],
    ) -> None:
        self._studio, self._show = studio, show
        pace = Pace(VOICE_PACKETS_PER_S, scene.start_ns, timeout=2)
        super().__init__(scene, name, film, pace, self._hear, block_ns=BLOCK_NS)

    def _hear(self, stamp: CaptureStamp, state: WorldState | None, now_ns: int) -> None:
        job = stamp.sequence if state is None else (now_ns, state)
        self._show(stamp, self._studio.submit(job), now_ns)


class ComposedCamera:
    """Pairs the pictures of two inputs. Drawing comes later, when a pair is encoded."""

    def __init__(
        self,
        scene: Scene,
        row: CameraRow,
        show: ShowPicture,
        on_oldest: Sequence[Callable[[str, int], None]] = (),
    ) -> None:
        self._row = row
        period_ns = scene.setup.uplink_video.period_ns
        self._pairer = PicturePairer(period_ns=period_ns, name=row.name)
        self._on_oldest = on_oldest
        self._agenda, self._show = scene.agenda, show
        self._probe = scene.telling.probe(row.process)
        scene.telling.add(self.publish)

    def handle_picture(self, name: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture of an input; others than its two are ignored."""
        if name not in self._row.inputs:
            return
        right = name == self._row.inputs[1]
        handle = self._pairer.handle_right if right else self._pairer.handle_left
        # The pairer reads stamps only, so a Shot can stand in for a picture.
        handle(VideoFrame(cast(I420, picture), stamp), now_ns)
        self._give(now_ns)
        due_ns = self._pairer.poll_timeout()
        if due_ns is not None:
            self._agenda.at(max(due_ns, now_ns + 1), self._expire)

    def _expire(self, now_ns: int) -> None:
        self._pairer.handle_timeout(now_ns)
        self._give(now_ns)

    def _give(self, now_ns: int) -> None:
        while (pair := self._pairer.next_event()) is not None:
            for call in self._on_oldest:
                call(self._row.name, pair.oldest_ns)
            self._show(Paired(self._row.name, pair, now_ns), pair.stamp, now_ns)

    def publish(self) -> None:
        pairer = self._pairer
        self._probe.publish(CompositionMetrics(paired=pairer.paired, single=pairer.single))


class Media:
    """All inputs and streams of a setup.

    on_confirmed: called with the number of a choice that the sender has confirmed, and the instant.
    consumers: by flow, to be called with (datagram, now_ns) that come out of the link.
    backlogs: by direction, to be called with (backlog, now_ns) that the gateway reports.
    """

    def __init__(self, scene: Scene, on_confirmed: Callable[[int, int], None]) -> None:
        self.consumers: dict[str, Consumer] = {}
        self.backlogs: defaultdict[str, list[Callable[[Backlog, int], None]]] = defaultdict(list)
        self._scene = scene
        self._on_confirmed = on_confirmed
        #: Called with each composed camera's name, and its older part's instant of capture.
        self.on_oldest: list[Callable[[str, int], None]] = []
        self.video_receivers: dict[str, VideoReceiveProcess] = {}
        #: By display.
        self._displays: dict[str, Display] = {}
        self._follow_choice: Callable[[Choice, int], None] | None = None
        setup = scene.setup
        pictures = self._receive_video(setup.uplink_video)
        self._send_uplink_video()
        if setup.uplink_voice is not None:
            self._receive_voice(setup.uplink_voice, pictures)
            self._send_voice(setup.uplink_voice, GROUND_MIC)
        pictures_down = None
        if setup.downlink_video is not None:
            pictures_down = self._receive_video(setup.downlink_video)
            self._send_downlink_video(setup.downlink_video)
        if setup.downlink_voice is not None:
            self._receive_voice(setup.downlink_voice, pictures_down)
            self._send_voice(setup.downlink_voice, OPERATOR_MIC)

    def _send_uplink_video(self) -> None:
        setup, stream = self._scene.setup, self._scene.setup.uplink_video
        studio = self._studio(stream, setup.camera_inputs, regions=True)
        sender = self._add_sender(
            stream,
            VideoSendProcess(self._scene, stream, studio, follows=True, robot=self._scene.robot),
        )
        sender.on_confirmed = self._on_confirmed
        self._follow_choice = sender.handle_choice

        def select(camera: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
            if camera == sender.end.camera:
                sender.handle_picture(picture, stamp, now_ns)

        composed = [
            ComposedCamera(self._scene, row, partial(select, row.name), self.on_oldest)
            for row in self._scene.topology.composed
        ]

        def show(camera: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
            for one in composed:
                one.handle_picture(camera, picture, stamp, now_ns)
            select(camera, picture, stamp, now_ns)

        def ahead(shot: Shot) -> None:
            camera = sender.end.camera
            if camera is not None and shot.camera in setup.inputs_of(camera):
                studio.submit(shot)

        for name in setup.camera_inputs:
            film = self._film(name, studio)
            Camera(self._scene, name, stream.fps, film, partial(show, name), ahead)

    def _send_downlink_video(self, stream: VideoStream) -> None:
        studio = self._studio(stream, [OPERATOR_CAMERA])
        show = self._add_sender(
            stream, VideoSendProcess(self._scene, stream, studio)
        ).handle_picture
        film = self._film(OPERATOR_CAMERA, studio)
        Camera(self._scene, OPERATOR_CAMERA, stream.fps, film, show, studio.submit)

    def handle_choice(self, choice: Choice, now_ns: int) -> None:
        if self._follow_choice is not None:
            self._follow_choice(choice, now_ns)

    def _studio(
        self, stream: VideoStream, cameras: Sequence[str], *, regions: bool = False
    ) -> Worker:
        setup, start_ns = self._scene.setup, self._scene.start_ns
        specs = {name: setup.source(name) for name in cameras}
        composed = self._scene.topology.composed
        return self._scene.workers.start(
            partial(VideoStudio, stream, specs, start_ns, regions=regions, composed=composed)
        )

    def _film(self, name: str, studio: Worker) -> Worker | None:
        """What plays the file of an input; None for a scene."""
        return None if self._scene.setup.source(name).startswith("scene:") else studio

    def _add_sender(self, stream: VideoStream, sender: VideoSendProcess) -> VideoSendProcess:
        scene = self._scene
        self.consumers[scene.topology.video(stream.name).feedback] = sender.handle_feedback
        self.backlogs[scene.setup.profile_of(stream).name].append(sender.handle_backlog)
        return sender

    def _add_voice(self, stream: VoiceStream, sender: VoiceProcess) -> None:
        self.backlogs[self._scene.setup.profile_of(stream).name].append(sender.handle_backlog)

    def _send_voice(self, stream: VoiceStream, name: str) -> None:
        scene = self._scene
        spec = scene.setup.source(name)
        studio = scene.workers.start(partial(VoiceStudio, stream, name, spec, scene.start_ns))
        sender = VoiceSendProcess(scene, stream)
        self._add_voice(stream, sender)
        Microphone(scene, name, studio, self._film(name, studio), sender.handle_sound)

    def _receive_video(self, stream: VideoStream) -> VideoReceiveProcess:
        display = self._display(stream.name)
        watched = (stream.width, stream.height) if stream.name in OPERATORS else None
        make = self._decoding(stream, watched)
        receiver = VideoReceiveProcess(self._scene, stream, display, make)
        self._add_receiver(stream.name, receiver)
        self.video_receivers[stream.name] = receiver
        return receiver

    def _decoding(
        self, stream: VideoStream, watched: tuple[int, int] | None
    ) -> Callable[[], Coder]:
        """What makes the decoder of a stream, in the process of its worker."""
        return partial(VideoDecoding, watched, codec=stream.codec)

    def _receive_voice(self, stream: VoiceStream, pictures: VideoReceiveProcess | None) -> None:
        receiver = VoiceReceiveProcess(self._scene, stream, self._display(stream.name))
        if pictures is not None:
            pictures.on_shown.append(receiver.handle_picture_shown)
        self._add_receiver(stream.name, receiver)

    def _add_receiver(
        self, stream: str, receiver: VideoReceiveProcess | VoiceReceiveProcess
    ) -> None:
        self.consumers[stream] = receiver.handle_packet
        self.consumers[f"{stream}_rtcp"] = receiver.handle_report

    def _display(self, stream: str) -> Display:
        telling, topology = self._scene.telling, self._scene.topology
        name = topology.media(stream).display
        if name not in self._displays:
            streams = [row.stream for row in topology.media_streams if row.display == name]
            showing = Showing(self._scene.setup, streams, telling.probe(name))
            telling.add(lambda: showing.publish(telling.now_ns))
            self._displays[name] = Display(self._scene, showing)
        return self._displays[name]
