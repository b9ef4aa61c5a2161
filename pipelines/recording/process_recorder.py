"""The process that records the session: topics in, files out, and a socket for requests.

`Recorder` decides what is written, `RecorderRequests` what is carried out. This module has topics,
the files and the sleep. While nothing is recorded, it reads no topic.

What is being recorded is also in a file of the session's directory. So a recorder that was killed
goes on, in a new part.
"""

from dataclasses import replace
from pathlib import Path

from kontur_av import __version__
from kontur_av.clock import NS_PER_MS, NS_PER_US
from kontur_av.errors import ConfigError
from kontur_av.metrics import plus
from pipelines.media.following import SELECTED_TOPIC
from pipelines.mission.supervisor import session_dictionary
from pipelines.recording import part_files
from pipelines.recording.camera_reader import CameraReader
from pipelines.recording.channels import sources_of
from pipelines.recording.metadata import RecordingMetadata
from pipelines.recording.recorded_messages import RecordedEvent
from pipelines.recording.recorder import EVENTS_LATE_NS, Recorder
from pipelines.recording.recorder_metrics import RecorderMetrics
from pipelines.recording.recorder_requests import RecorderRequests
from pipelines.recording.topic_samples import waiting_samples
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.recording_requests import (
    RECORDER_SOCKET,
    RecordAnswer,
    RecordingOptions,
    RecordRequest,
    StartRecording,
    StopRecording,
    read_request,
    remove_request,
    write_request,
)
from pipelines.session.requests import RequestServer
from pipelines.session.session_metrics import SessionNews, gathered
from pipelines.session.setup.setup_text import setup_toml
from pipelines.session.topic_ends import TopicReader
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

#: How often topics are read.
_WAKE_NS = 50 * NS_PER_MS
#: Octets that are handed to the writing thread at once.
_IN_FLIGHT_OCTETS = 1 << 20
#: At the end of the session, the others' last samples come within this time.
_DRAIN_NS = 150 * NS_PER_MS
#: How long a slow disk may take at the end.
_CLOSE_S = 1.5
#: Unread samples of a topic that are kept: the most that there can be.
_DEPTH = 32
#: Pictures of a camera that are coded before other things are done: twice as many as come.
_PICTURES = 4


def run_recorder(context: Context) -> None:
    """Record while it is wished, until the session ends."""
    _RecorderProcess(context).run()


class _RecorderProcess:
    """The requests, and the present recording."""

    def __init__(self, context: Context) -> None:
        self._context, self._now_ns = context, context.clock.now_ns
        self._requests = RecorderRequests(read_request(context.session), self._now_ns())
        self._recording: _Recording | None = None
        #: Of all recordings that have ended in this start, and of the newest of them.
        self._past = self._newest = RecorderMetrics()
        context.on_flush(self._publish)

    def run(self) -> None:
        context, now_ns = self._context, self._now_ns
        if self._requests.options is not None:
            self._recording = _Recording(context, self._requests.options)
            # The launcher waits for it.
            context.flush(now_ns())
        with RequestServer(
            context,
            RECORDER_SOCKET,
            RecordRequest,
            self._handle,
            closed=lambda terminal: self._requests.handle_closed(terminal, now_ns()),
        ) as server:
            while not context.stopping:
                server.serve(TIMEOUT_NS if self._recording is None else _WAKE_NS)
                if self._requests.poll_abandoned(now_ns()):
                    self._stop()
                context.tick(now_ns())
                while (news := context.receive_news()) is not None:
                    if self._recording is not None:
                        self._recording.handle_news(news)
                if self._recording is not None:
                    self._recording.handle_wake()
        if self._recording is not None:
            end_ns = now_ns() + _DRAIN_NS
            while now_ns() < end_ns:
                self._recording.handle_wake()
                context.clock.sleep_until_ns(now_ns() + _WAKE_NS)
            self._end()

    def _handle(self, request: RecordRequest, terminal: int) -> RecordAnswer:
        if isinstance(request, StartRecording):
            if self._requests.handle_start(request, terminal):
                self._start(request)
                self._requests.handle_started(request.options, terminal)
        elif isinstance(request, StopRecording):
            self._stop()
        return self._answer()

    def _start(self, start: StartRecording) -> None:
        """Begin to record; ConfigError if that is not possible."""
        path = Path(start.options.file)
        part_files.check_recordable(
            path, overwrite=start.overwrite, sources=self._context.setup.sources.values()
        )
        try:
            cameras = part_files.recorded_cameras(path, self._context.setup, start.options.cameras)
            part_files.check_disk(path, cameras, part_files.LEAST_RECORDED_S)
            part_files.clear_parts(path)
            write_request(self._context.session, start.options)
        except OSError as error:
            raise ConfigError(f"{path} cannot be written: {error.strerror}") from None
        self._recording = _Recording(self._context, start.options)

    def _stop(self) -> None:
        self._requests.handle_stop()
        self._end()
        remove_request(self._context.session)

    def _end(self) -> None:
        if self._recording is not None:
            self._newest = self._recording.end()
            self._past = plus(self._past, self._newest)
            self._recording = None

    def _answer(self) -> RecordAnswer:
        recording = self._recording
        counters = self._newest if recording is None else recording.metrics
        return RecordAnswer(
            file="" if recording is None else str(recording.file),
            files=counters.parts,
            messages=counters.messages,
            lost=counters.lost,
            fault="" if recording is None else recording.fault,
            cameras="" if recording is None else recording.cameras,
        )

    def _publish(self) -> None:
        recording = self._recording
        probe = self._context.probe
        probe.publish(self._past if recording is None else plus(self._past, recording.metrics))


class _Recording:
    """The topics and the files of one recording."""

    def __init__(self, context: Context, options: RecordingOptions) -> None:
        self._now_ns = context.clock.now_ns
        cameras = part_files.recorded_cameras(Path(options.file), context.setup, options.cameras)
        self.cameras = cameras.words
        setup = replace(context.setup, recorded_cameras=cameras.choice)
        topology = replace(context.topology, setup=setup)
        offset_ns = context.clock.wall_offset_ns
        now_ns = self._now_ns()
        # Those of a session that is recorded from its start, and those that a killed recorder held.
        self._since_ns = now_ns if options.held else now_ns - EVENTS_LATE_NS
        metadata = RecordingMetadata(
            session=context.session,
            setup=setup.name,
            setup_toml=setup_toml(setup),
            version=__version__,
            seed=context.seed,
            command=options.command,
            part=1,
            session_ns=now_ns,
            wall_ns=now_ns + offset_ns,
            started_ns=context.started_ns,
            radio_start_s=setup.radio_profile.start_s,
        )
        self._recorder = Recorder(
            topology,
            metadata,
            session_dictionary(built_in_dictionary(), topology),
            wall_offset_ns=offset_ns,
            link_frames=options.link_frames,
            limits=options.limits,
        )
        self._files = part_files.PartFiles(Path(options.file))
        self._open_part()
        self._bus = context.open_bus()
        sources = sources_of(topology, link_frames=options.link_frames)
        self._readers = [
            (source, self._bus.reader(source.topic, depth=_DEPTH))
            for source in sources
            if not source.is_camera
        ]
        self._selected = TopicReader(self._bus, SELECTED_TOPIC)
        whole = cameras.choice == "all"
        self._cameras = [
            CameraReader(self._bus, source, self._recorder.coder(source), now_ns, whole=whole)
            for source in sources
            if source.is_camera
        ]
        self._carried = {camera.name: camera.inputs for camera in topology.cameras}
        self._follow(setup.cameras[0])

    @property
    def file(self) -> Path:
        return self._files.newest

    @property
    def fault(self) -> str:
        return self._recorder.parts.fault

    @property
    def metrics(self) -> RecorderMetrics:
        return replace(self._recorder.metrics(str(self.file)), cameras=self.cameras)

    def handle_news(self, news: SessionNews) -> None:
        """The launcher tells the figures, and what happened, also before the recording."""
        self._recorder.handle_metrics(news.figures, news.at_us * NS_PER_US, self._now_ns())
        for event in news.events:
            at_ns = event.at_us * NS_PER_US
            if at_ns >= self._since_ns:
                recorded = gathered(RecordedEvent, event, session_ns=at_ns)
                self._recorder.handle_event(recorded, self._now_ns())

    def handle_wake(self) -> None:
        """Read what has come, and write what can be written."""
        recorder = self._recorder
        for source, reader in self._readers:
            if recorder.poll_ask(source, self._now_ns()):
                reader.rejoin()
        for source, octets, stamp, at_ns in waiting_samples(self._readers):
            recorder.handle_sample(source, octets, stamp, self._now_ns(), published_ns=at_ns)
        if (choice := self._selected.latest()) is not None:
            self._follow(choice.camera)
        for camera in self._cameras:
            for _ in range(_PICTURES):
                if (coded := camera.poll(self._now_ns())) is None:
                    break
                recorder.handle_camera(camera.source, *coded, self._now_ns())
        recorder.handle_time(self._now_ns())
        self._pump()

    def end(self) -> RecorderMetrics:
        for _, reader in self._readers:
            reader.close()
        self._recorder.handle_end(self._now_ns())
        self._pump(most_octets=1 << 62)
        self._files.close(_CLOSE_S)
        self._take_results()
        self._recorder.parts.handle_abandoned()
        self._bus.close()
        return replace(self.metrics, recording=False, fault=None, waiting_octets=0)

    def _follow(self, camera: str) -> None:
        carried = self._carried.get(camera, ())
        for each in self._cameras:
            each.handle_carried(each.source.name in carried)

    def _open_part(self) -> None:
        now_ns = self._now_ns()
        try:
            self._recorder.handle_opened(self._files.open(), now_ns)
        except OSError as error:
            self._recorder.parts.handle_fault(None, error.strerror or str(error), now_ns)

    def _pump(self, most_octets: int = _IN_FLIGHT_OCTETS) -> None:
        self._take_results()
        if self._recorder.wants_part(self._now_ns()):
            self._open_part()
        while self._files.waiting_octets < most_octets:
            piece = self._recorder.parts.poll_transmit(self._now_ns())
            if piece is None:
                return
            self._files.put(piece)

    def _take_results(self) -> None:
        for part, why in self._files.results():
            if why:
                self._recorder.parts.handle_fault(part, why, self._now_ns())
            else:
                self._recorder.parts.handle_written()
