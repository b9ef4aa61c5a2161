"""The process of `--foxglove`: the channels of a recording over Foxglove's WebSocket protocol.

`Bridge` decides; this module has the sockets, the topics and the sleep.
"""

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from aiohttp import web

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.topics.bus import Lease, Reader, TopicBus
from pipelines.foxglove.bridge import Bridge
from pipelines.foxglove.protocol import MOST_CLIENT_OCTETS, SUBPROTOCOLS
from pipelines.media.following import SELECTED_TOPIC
from pipelines.mission.supervisor import session_dictionary
from pipelines.mission.tmtc_messages import TMTC_TOPICS, CommandUpdate
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.recording.camera_reader import CameraReader
from pipelines.recording.channels import Source, sources_of
from pipelines.recording.session_messages import Instants
from pipelines.recording.topic_samples import waiting_samples
from pipelines.seats.seat_sockets import Message, SeatSockets
from pipelines.session.access import AccessError, AccessKind, Found, Role
from pipelines.session.mission_messages import MISSION_GROUND_TOPIC
from pipelines.session.process import Context
from pipelines.session.serving_loop import Feed, ServingLoop
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader
from pipelines.session.topology.topics import FOXGLOVE
from pipelines.session.web_site import WebSite
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

#: How often topics are read, and without a client.
_WAKE_NS, _IDLE_NS = 20 * NS_PER_MS, 50 * NS_PER_MS
#: Unread samples of a topic that are kept: the most that there can be.
_DEPTH = 32


def run_foxglove(context: Context) -> None:
    """Serve on the socket that the launcher has bound."""

    async def serve() -> None:
        with context.open_bus() as bus:
            await _FoxgloveServer(context, bus).run()

    asyncio.run(serve())


class _FoxgloveServer:
    def __init__(self, context: Context, bus: TopicBus) -> None:
        self._context, self._now_ns, self._bus = context, context.clock.now_ns, bus
        self._bridge = Bridge(
            context.topology,
            session_dictionary(built_in_dictionary(), context.topology),
            context.session,
            wall_offset_ns=context.clock.wall_offset_ns,
            boot_id=self._now_ns(),
        )
        self._site = WebSite(context.pages[FOXGLOVE], seat=FOXGLOVE)
        self._sockets = SeatSockets(self._now_ns)
        self._serving = ServingLoop(context, self._sockets.handle_time)
        self._wakes: dict[int, asyncio.Event] = {}
        self._topics = _Topics(context, bus, self._bridge)
        self._news = [
            Feed(
                self._serving.loop,
                bus,
                TMTC_TOPICS[segment],
                partial(self._take_news, segment),
                depth=_DEPTH,
            )
            for segment in self._bridge.services.segments
        ]

    async def run(self) -> None:
        """Serve, and close all sockets in the end."""
        self._context.on_flush(self._publish)
        for feed in self._news:
            feed.open()
        if self._context.link is not None:
            self._serving.loop.add_reader(self._context.link.fileno(), self._take_metrics)
        try:
            async with self._site.served("pipelines.foxglove", self._answer, self._sockets.close):
                self._serving.begin(self._read())
                await self._serving.run()
        finally:
            for feed in self._news:
                feed.close()
            self._topics.close()

    async def _read(self) -> None:
        while True:
            self._topics.read(self._now_ns())
            self._settle()
            await asyncio.sleep((_WAKE_NS if self._wakes else _IDLE_NS) / NS_PER_S)

    def _take_metrics(self) -> None:
        while (news := self._context.receive_news()) is not None:
            self._bridge.handle_session(news, self._now_ns())
        self._settle()

    def _take_news(self, segment: Segment, lease: Lease) -> None:
        news = TMTC_TOPICS[segment].unpack(lease.octets())
        if isinstance(news, CommandUpdate):
            self._bridge.services.handle_update(segment, news)
            self._settle()

    def _settle(self) -> None:
        """Do what was decided, and wake the clients for which something waits."""
        now_ns, bridge = self._now_ns(), self._bridge
        while (request := bridge.services.poll_transmit(now_ns)) is not None:
            send_to_tmtc(self._context.session, *request)
        bridge.handle_time(now_ns)
        for number, wake in self._wakes.items():
            if bridge.waits(number):
                wake.set()

    def _publish(self) -> None:
        self._context.probe.publish(
            replace(
                self._bridge.metrics(self._now_ns()),
                connections=self._sockets.connections,
                refused=dict(self._site.refused),
                garbage=self._sockets.garbage,
            )
        )

    # Clients

    async def _answer(self, request: web.BaseRequest, found: Found) -> web.StreamResponse:
        if found.kind is not AccessKind.PAGE:
            raise AccessError(404, f"only /{FOXGLOVE}")
        offered = request.headers.get("Sec-WebSocket-Protocol", "")
        if not {word.strip() for word in offered.split(",")}.intersection(SUBPROTOCOLS):
            raise AccessError(400, f"this address is for web sockets of {SUBPROTOCOLS[0]}")
        if self._bridge.is_full:
            raise AccessError(503, "too many clients", "clients")
        socket = await self._sockets.open(request, MOST_CLIENT_OCTETS, SUBPROTOCOLS)
        number = self._bridge.handle_opened(commands=found.role is Role.OPERATOR)
        wake = self._wakes[number] = asyncio.Event()
        # The launcher sends figures only when it knows.
        self._context.flush(self._now_ns())
        try:
            await self._sockets.serve(
                socket, partial(self._take, number), partial(self._next_message, number, wake)
            )
        finally:
            del self._wakes[number]
            self._bridge.handle_closed(number)
        return socket.ws

    def _take(self, number: int, message: Message) -> None:
        if isinstance(message, bytes):
            self._bridge.handle_octets(number, message, self._now_ns())
        else:
            self._bridge.handle_text(number, message, self._now_ns())
        self._settle()

    async def _next_message(self, number: int, wake: asyncio.Event) -> Message:
        while (message := self._bridge.poll_transmit(number)) is None:
            wake.clear()
            await wake.wait()
        return message


class _Topics:
    """The topics of the channels, read while somebody needs them."""

    def __init__(self, context: Context, bus: TopicBus, bridge: Bridge) -> None:
        self._bus, self._bridge = bus, bridge
        topology = context.topology
        self._sources = [source for source in sources_of(topology) if not source.is_camera]
        self._readers: dict[str, Reader] = {}
        self._cameras = [
            CameraReader(bus, source, bridge.coder(source), context.clock.now_ns())
            for source in sources_of(topology)
            if source.is_camera
        ]
        self._carried: Mapping[str, tuple[str, ...]] = {
            camera.name: camera.inputs for camera in topology.cameras
        }
        self._camera = context.setup.cameras[0]
        self._selected = TopicReader(bus, SELECTED_TOPIC)
        self._mission = TopicReader(bus, MISSION_GROUND_TOPIC)

    def read(self, now_ns: int) -> None:
        bridge = self._bridge
        wanted = {source.topic for source in bridge.wanted}
        for source in self._sources:
            self._open(source, source.topic in wanted)
        readers = [
            (source, self._readers[source.topic])
            for source in self._sources
            if source.topic in self._readers
        ]
        for source, octets, stamp, at_ns in waiting_samples(readers):
            bridge.handle_sample(source, octets, stamp, Instants(at_ns, now_ns))
        for source, reader in readers:
            if bridge.poll_ask(source, now_ns):
                reader.rejoin()
        if (selected := self._selected.latest()) is not None:
            self._camera = selected.camera
        if (mission := self._mission.latest()) is not None:
            bridge.services.tasks = [task.name for task in mission.tasks]
        for camera in self._cameras:
            source = camera.source
            carried = source.name in self._carried.get(self._camera, ())
            camera.handle_carried(carried or source.topic not in wanted)
            if (coded := camera.poll(now_ns)) is not None:
                bridge.handle_camera(source, *coded, now_ns)

    def close(self) -> None:
        for reader in self._readers.values():
            reader.close()
        self._selected.close()
        self._mission.close()

    def _open(self, source: Source, wanted: bool) -> None:
        if wanted and source.topic not in self._readers:
            self._readers[source.topic] = self._bus.reader(source.topic, depth=_DEPTH)
            self._bridge.handle_joined(source)
        elif not wanted and source.topic in self._readers:
            self._readers.pop(source.topic).close()
