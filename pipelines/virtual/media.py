"""The media of a simulated session, joined: inputs, senders and receivers with their coders."""

from collections.abc import Callable, Sequence
from functools import partial

from kontur_av.media import CaptureStamp
from kontur_av.streams.video_sender import VideoSender
from pipelines.media.following import CameraFollower, Choice
from pipelines.media.session_streams import video_sender
from pipelines.media.showing import Showing
from pipelines.media.tip_region import tip_region
from pipelines.media.watching import OPERATORS
from pipelines.session.setup.table import (
    GROUND_MIC,
    ISS_CAMERA,
    ISS_MIC,
    STEREO,
    STEREO_INPUTS,
    VideoStream,
    VoiceStream,
)
from pipelines.virtual.agenda import WALL_OFFSET_NS
from pipelines.virtual.inputs import Camera, Microphone, Stereo
from pipelines.virtual.receivers import Display, VideoReceiveProcess, VoiceReceiveProcess
from pipelines.virtual.senders import VideoProcess, VideoSendProcess, VoiceSendProcess
from pipelines.virtual.studio import Picture, VideoDecoding, VideoStudio, VoiceStudio
from pipelines.virtual.workers import Coder, Scene, Worker
from telepresence.link.backlog import Backlog

#: Takes the datagrams of a flow that come out of the link, with the instant.
Consumer = Callable[[bytes, int], object]


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
            self._send_voice(setup.uplink_voice, GROUND_MIC)
        pictures_down = None
        if setup.downlink_video is not None:
            pictures_down = self._receive_video(setup.downlink_video)
            self._send_downlink_video(setup.downlink_video)
        if setup.downlink_voice is not None:
            self._receive_voice(setup.downlink_voice, pictures_down)
            self._send_voice(setup.downlink_voice, ISS_MIC)

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
        sender = self._video_sender(stream, studio)
        sender.tip = None if tip is None else (tip, self._scene.state_at)
        follower = sender.follower = CameraFollower()
        sender.on_confirmed = self._on_confirmed
        self._follow_choice = sender.handle_choice

        def select(camera: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
            if camera == follower.camera:
                sender.handle_picture(picture, follower.restamp(stamp), now_ns)

        stereo = None
        if STEREO in setup.cameras:
            stereo = Stereo(self._scene, stream.fps, partial(select, STEREO))

        def show(camera: str, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
            if stereo is not None and camera in STEREO_INPUTS:
                stereo.handle_picture(picture, stamp, now_ns, right=camera == STEREO_INPUTS[1])
            select(camera, picture, stamp, now_ns)

        for name in setup.camera_inputs:
            Camera(self._scene, name, stream.fps, self._film(name, studio), partial(show, name))

    def _send_downlink_video(self, stream: VideoStream) -> None:
        studio = self._studio(stream, [ISS_CAMERA])
        show = self._video_sender(stream, studio).handle_picture
        Camera(self._scene, ISS_CAMERA, stream.fps, self._film(ISS_CAMERA, studio), show)

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

    def _video_sender(self, stream: VideoStream, studio: Worker) -> VideoSendProcess:
        gateway = self._scene.sending_gateway(stream.name)
        sender = VideoSendProcess(self._scene, stream, self._core(stream), gateway, studio)
        self._add_sender(stream, sender)
        return sender

    def _core(self, stream: VideoStream) -> VideoSender:
        identity = self._scene.identity(stream.name)
        return video_sender(self._scene.setup, stream, identity, wall_offset_ns=WALL_OFFSET_NS)

    def _add_sender(self, stream: VideoStream, sender: VideoProcess) -> None:
        scene = self._scene
        self.consumers[scene.topology.video(stream.name).feedback] = sender.handle_feedback
        self.backlogs[scene.setup.profile_of(stream).name] = sender.handle_backlog

    def _send_voice(self, stream: VoiceStream, name: str) -> None:
        scene = self._scene
        spec = scene.setup.source(name)
        studio = scene.workers.start(partial(VoiceStudio, stream, name, spec, scene.start_ns))
        sender = VoiceSendProcess(scene, stream, studio)
        Microphone(scene, name, self._film(name, studio), sender.handle_sound)

    def _receive_video(self, stream: VideoStream) -> VideoReceiveProcess:
        display = self._display(stream.name)
        watched = (stream.width, stream.height) if stream.name in OPERATORS else None
        make = self._decoding(stream, watched)
        receiver = VideoReceiveProcess(self._scene, stream, display, make)
        self._add_receiver(stream.name, receiver)
        self._video_receivers[stream.name] = receiver
        return receiver

    def _decoding(
        self, stream: VideoStream, watched: tuple[int, int] | None
    ) -> Callable[[], Coder]:
        """What makes the decoder of a stream, in the process of its worker."""
        return partial(VideoDecoding, watched)

    def _receive_voice(self, stream: VoiceStream, pictures: VideoReceiveProcess | None) -> None:
        receiver = VoiceReceiveProcess(self._scene, stream, self._display(stream.name))
        if pictures is not None:
            pictures.on_shown = receiver.handle_picture_shown
        self._add_receiver(stream.name, receiver)

    def _add_receiver(
        self, stream: str, receiver: VideoReceiveProcess | VoiceReceiveProcess
    ) -> None:
        self.consumers[stream] = receiver.handle_packet
        self.consumers[f"{stream}_rtcp"] = receiver.handle_report
        self._receivers.append(receiver)

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
