"""The media of a simulated session, joined: inputs, senders and receivers with their coders."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from random import Random

from kontur_av.media import CaptureStamp
from kontur_av.rtp.sender import RtpIdentity
from pipelines.media.following import CameraFollower, Choice
from pipelines.media.gain import gain_of
from pipelines.media.session_streams import (
    video_receiver,
    video_sender,
    voice_receiver,
    voice_sender,
)
from pipelines.media.showing import Showing
from pipelines.media.tip_region import tip_region
from pipelines.media.watching import OPERATORS
from pipelines.session.setup.table import (
    GROUND_MIC,
    ISS_CAMERA,
    ISS_MIC,
    STEREO,
    STEREO_INPUTS,
    Setup,
    VideoStream,
    VoiceStream,
)
from pipelines.session.topology import Topology
from pipelines.virtual.agenda import Agenda, CodingCosts, Telling
from pipelines.virtual.inputs import Camera, Microphone, ShowPicture, Stereo
from pipelines.virtual.receivers import Display, VideoReceiveProcess, VoiceReceiveProcess
from pipelines.virtual.senders import RecordedVideoProcess, VideoSendProcess, VoiceSendProcess
from pipelines.virtual.studio import (
    Picture,
    VideoDecoding,
    VideoStudio,
    VoiceDecoding,
    VoiceStudio,
)
from pipelines.virtual.workers import Coder, Worker, Workers
from telepresence.link.backlog import Backlog
from telepresence.link.gateway import Gateway
from telepresence.world import WorldState

#: The instants of virtual time are Unix times.
WALL_OFFSET_NS = 0

#: Takes the datagrams of a flow that come out of the link, with the instant.
Consumer = Callable[[bytes, int], object]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What the parts of a simulated session share.

    ground, space: the gateways. state_at: the newest state of the robot. start_ns: when it begins.
    """

    setup: Setup
    topology: Topology
    costs: CodingCosts
    seed: int
    agenda: Agenda
    telling: Telling
    workers: Workers
    ground: Gateway
    space: Gateway
    state_at: Callable[[int], WorldState]
    start_ns: int


class Media:
    """All inputs and streams of a setup.

    on_confirmed: called with the number of a choice that the sender has confirmed, and the instant.
    consumers: by flow, to be called with (datagram, now_ns) that come out of the link.
    backlogs: by direction, to be called with (backlog, now_ns) that the gateway reports.
    """

    def __init__(self, scene: Scene, on_confirmed: Callable[[int, int], None]) -> None:
        self.consumers: dict[str, Consumer] = {}
        self.backlogs: dict[str, Callable[[Backlog, int], None]] = {}
        self._scene = scene
        self._on_confirmed = on_confirmed
        self._receivers: list[VideoReceiveProcess | VoiceReceiveProcess] = []
        self._video_receivers: dict[str, VideoReceiveProcess] = {}
        #: By display.
        self._displays: dict[str, Display] = {}
        self._follow_choice: Callable[[Choice, int], None] | None = None
        #: Everything shown up to this instant is known.
        self._settled_ns = scene.start_ns
        setup = scene.setup
        pictures = self._receive_video(setup.uplink_video)
        self._send_uplink_video()
        if setup.uplink_voice is not None:
            self._receive_voice(setup.uplink_voice, pictures)
            self._send_voice(setup.uplink_voice, GROUND_MIC, scene.ground)
        pictures_down = None
        if setup.downlink_video is not None:
            pictures_down = self._receive_video(setup.downlink_video)
            self._send_downlink_video(setup.downlink_video)
        if setup.downlink_voice is not None:
            self._receive_voice(setup.downlink_voice, pictures_down)
            self._send_voice(setup.downlink_voice, ISS_MIC, scene.space)

    def settle(self, until_ns: int, now_ns: int) -> None:
        """Wait for all that was decoded by `until_ns`; it is `now_ns`."""
        for receiver in self._receivers:
            receiver.settle(until_ns)
        self._settled_ns = min(until_ns, now_ns)
        for display in self._displays.values():
            display.handle_time(self._settled_ns)

    def _send_uplink_video(self) -> None:
        setup, stream = self._scene.setup, self._scene.setup.uplink_video
        tip = tip_region(setup)
        studio = self._studio(stream, setup.camera_inputs, regions=tip is not None)
        sender = self._video_sender(stream, self._scene.ground, studio)
        sender.tip = None if tip is None else (tip, self._scene.state_at)
        follower = sender.follower = CameraFollower()
        sender.on_confirmed = self._on_confirmed
        self._follow_choice = sender.handle_choice

        def select(camera: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
            if camera == follower.camera:
                sender.handle_picture(picture, follower.restamp(stamp), now_ns)

        stereo = None
        if STEREO in setup.cameras:
            merged = self._scene.topology.topic(self._scene.topology.camera(STEREO).topic)
            probe = self._scene.telling.probe(merged.writer)
            stereo = Stereo(
                stream.fps, agenda=self._scene.agenda, probe=probe, show=partial(select, STEREO)
            )
            self._scene.telling.add(stereo.tell)

        def show(camera: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
            if stereo is not None and camera in STEREO_INPUTS:
                stereo.handle_picture(picture, stamp, now_ns, right=camera == STEREO_INPUTS[1])
            select(camera, picture, stamp, now_ns)

        for name in setup.camera_inputs:
            self._camera(name, stream, self._film(name, studio), partial(show, name))

    def _send_downlink_video(self, stream: VideoStream) -> None:
        studio = self._studio(stream, [ISS_CAMERA])
        sender = self._video_sender(stream, self._scene.space, studio)
        self._camera(ISS_CAMERA, stream, self._film(ISS_CAMERA, studio), sender.handle_picture)

    def handle_choice(self, choice: Choice, now_ns: int) -> None:
        """The selector says which camera to take."""
        if self._follow_choice is not None:
            self._follow_choice(choice, now_ns)

    def _studio(
        self, stream: VideoStream, cameras: Sequence[str], *, regions: bool = False
    ) -> Worker:
        specs = {name: self._scene.setup.source(name) for name in cameras}
        return self._scene.workers.start(
            partial(VideoStudio, stream, specs, self._scene.start_ns, regions=regions)
        )

    def _film(self, name: str, studio: Worker) -> Worker | None:
        """What plays the file of an input; None for a scene."""
        return None if self._scene.setup.source(name).startswith("scene:") else studio

    def _camera(
        self, name: str, stream: VideoStream, film: Worker | None, show: ShowPicture
    ) -> None:
        scene = self._scene
        camera = Camera(
            name,
            stream.fps,
            agenda=scene.agenda,
            worker=film,
            probe=scene.telling.probe(scene.topology.input(name).process),
            state_at=scene.state_at,
            cost_ns=scene.costs.ns("capture"),
            show=show,
            now_ns=scene.start_ns,
        )
        scene.telling.add(camera.tell)

    def _video_sender(
        self, stream: VideoStream, gateway: Gateway, studio: Worker
    ) -> VideoSendProcess:
        scene = self._scene
        identity = self._identity(stream.name)
        sender = VideoSendProcess(
            stream.name,
            video_sender(scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS),
            scene.telling.probe(scene.topology.media(stream.name).sender),
            gain_of(scene.setup, stream),
            agenda=scene.agenda,
            gateway=gateway,
            studio=studio,
            costs=scene.costs,
        )
        self._add_sender(stream, sender)
        return sender

    def _add_sender(
        self, stream: VideoStream, sender: VideoSendProcess | RecordedVideoProcess
    ) -> None:
        scene = self._scene
        scene.telling.add(sender.tell)
        self.consumers[scene.topology.video(stream.name).feedback] = sender.handle_feedback
        self.backlogs[scene.setup.profile_of(stream).name] = sender.handle_backlog

    def _send_voice(self, stream: VoiceStream, name: str, gateway: Gateway) -> None:
        scene = self._scene
        spec = scene.setup.source(name)
        studio = scene.workers.start(partial(VoiceStudio, stream, name, spec, scene.start_ns))
        identity = self._identity(stream.name)
        sender = VoiceSendProcess(
            stream.name,
            voice_sender(scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS),
            scene.telling.probe(scene.topology.media(stream.name).sender),
            agenda=scene.agenda,
            gateway=gateway,
            studio=studio,
            costs=scene.costs,
        )
        microphone = Microphone(
            name,
            agenda=scene.agenda,
            worker=None if spec.startswith("scene:") else studio,
            probe=scene.telling.probe(scene.topology.input(name).process),
            state_at=scene.state_at,
            show=sender.handle_sound,
            now_ns=scene.start_ns,
        )
        scene.telling.add(sender.tell)
        scene.telling.add(microphone.tell)

    def _receive_video(self, stream: VideoStream) -> VideoReceiveProcess:
        scene, display = self._scene, self._display(stream.name)
        probe = scene.telling.probe(scene.topology.media(stream.name).receiver)
        far = scene.space if stream is scene.setup.uplink_video else scene.ground
        watched = (stream.width, stream.height) if stream.name in OPERATORS else None
        ssrc = Random(f"{scene.seed} {stream.name} receiver").getrandbits(32)
        receiver = VideoReceiveProcess(
            stream.name,
            video_receiver(stream, ssrc=ssrc, wall_offset_ns=WALL_OFFSET_NS),
            probe,
            display,
            agenda=scene.agenda,
            decoder=scene.workers.start(self._decoding(stream, watched)),
            costs=scene.costs,
            ask=partial(far.handle_datagram, scene.topology.video(stream.name).feedback),
        )
        self._add_receiver(stream.name, receiver)
        self._video_receivers[stream.name] = receiver
        return receiver

    def _decoding(
        self, stream: VideoStream, watched: tuple[int, int] | None
    ) -> Callable[[], Coder]:
        """What makes the decoder of a stream, in the process of its worker."""
        return partial(VideoDecoding, watched)

    def _receive_voice(self, stream: VoiceStream, pictures: VideoReceiveProcess | None) -> None:
        scene, display = self._scene, self._display(stream.name)
        probe = scene.telling.probe(scene.topology.media(stream.name).receiver)
        receiver = VoiceReceiveProcess(
            stream.name,
            voice_receiver(scene.topology, stream, wall_offset_ns=WALL_OFFSET_NS),
            probe,
            display,
            agenda=scene.agenda,
            decoder=scene.workers.start(partial(VoiceDecoding, watched=stream.name in OPERATORS)),
            costs=scene.costs,
        )
        if pictures is not None:
            pictures.on_shown = receiver.handle_picture_shown
        self._add_receiver(stream.name, receiver)

    def _add_receiver(
        self, stream: str, receiver: VideoReceiveProcess | VoiceReceiveProcess
    ) -> None:
        self.consumers[stream] = receiver.handle_packet
        self.consumers[f"{stream}_rtcp"] = receiver.handle_report
        self._receivers.append(receiver)
        self._scene.telling.add(receiver.tell)

    def _display(self, stream: str) -> Display:
        """The display that shows `stream`."""
        telling, topology = self._scene.telling, self._scene.topology
        name = topology.media(stream).display
        if name not in self._displays:
            streams = [row.stream for row in topology.media_streams if row.display == name]
            showing = Showing(self._scene.setup, streams, telling.probe(name))
            telling.add(lambda: showing.tell(self._settled_ns))
            self._displays[name] = Display(showing)
        return self._displays[name]

    def _identity(self, stream: str) -> RtpIdentity:
        return RtpIdentity.draw(Random(f"{self._scene.seed} {stream}").getrandbits)
