"""The server of a segment's browser pages: sockets, topics and timers around the cores."""

import asyncio
import ssl
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import count
from typing import Any

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.topics.bus import Lease, TopicBus, Writer
from pipelines.cores.figures import PageCounters, PageGauges
from pipelines.cores.following import Choice
from pipelines.cores.hand_topics import (
    INPUT_OCTETS,
    REQUEST_OCTETS,
    HandRequest,
    JoystickStatus,
    pack_input,
    pack_request,
    unpack_status,
)
from pipelines.cores.haptic_trace import rows_of
from pipelines.cores.session_switch import Order
from pipelines.page import wire
from pipelines.page.access import (
    BASE_MARK,
    CONTENT_TYPES,
    Gatekeeper,
    Role,
    is_static_name,
    security_headers,
)
from pipelines.page.client import POLICY, PageClient
from pipelines.page.client_queue import ClientQueue
from pipelines.page.console_link import select_camera
from pipelines.page.feeds import Feed, Feeds
from pipelines.page.hand_gate import HandGate
from pipelines.page.own_media import OwnMedia
from pipelines.page.ownership import HandleOwnership
from pipelines.page.seat_streams import SeatStream, seat_streams
from pipelines.page.start_picture import StartPictures
from pipelines.page.texts import (
    JoystickText,
    StateText,
    hand_text,
    hello,
    own_inputs,
    previewed_inputs,
)
from pipelines.page.unit_history import HistoryUnit, UnitHistory
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.topology import (
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    JOYSTICK_TRACE_TOPIC,
    PAGES,
    ROBOT_TRACE_TOPIC,
    SELECTED_TOPIC,
    Segment,
    VideoRow,
)
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.link.backlog import Backlog

_STATE_S = 0.1
_EVENTS_KEPT = 200
#: How long a joystick may take to answer a command.
_JOYSTICK_S = 1.0
#: Octets that wait in the library below the queue, so that what is late is left out above it.
_WRITE_LIMIT_OCTETS = 1 << 16
_END_S = 1.0

_encode = msgspec.json.encode


@dataclass(kw_only=True)
class _Counts:
    connections: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    garbage: int = 0
    left_out: int = 0
    closed: int = 0


class PageServer:
    """Serves the pages of `segment` on an event loop, until `context.stopping`.

    joystick: the kind that `--joystick` names, for the page to know whether it may steer.
    """

    def __init__(self, context: Context, segment: Segment, bus: TopicBus) -> None:
        self._context, self._segment, self._bus = context, segment, bus
        self._clock, self._topology = context.clock, context.topology
        topology = self._topology
        self._listener = context.pages[PAGES[segment]]
        self._gate = Gatekeeper(
            scheme=self._listener.scheme,
            names=self._listener.names,
            port=self._listener.port,
            operator_token=self._listener.operator_token,
            viewer_token=self._listener.viewer_token,
        )
        self._streams = seat_streams(topology, segment)
        self._videos = [one for one in self._streams if one.via != "sound"]
        self._histories = {one.index: UnitHistory() for one in self._videos}
        self._starts = StartPictures(bus, self._videos, self._histories, self._begin_at)
        self._clients: dict[int, PageClient] = {}
        self._numbers = count(1)
        self._counts = _Counts()
        self._watched: Feeds | None = None
        self._ownership = HandleOwnership()
        self._hand = HandGate(self._ownership)
        space = segment is Segment.SPACE
        self._to_hand = self._writer(HAND_INPUT_TOPIC, INPUT_OCTETS) if space else None
        self._to_joystick = self._writer(HAND_REQUEST_TOPIC, REQUEST_OCTETS) if space else None
        #: Above those of an earlier life of this process.
        self._requests = count(self._clock.now_ns())
        self._samples = count()
        self._joystick: JoystickStatus | None = None
        self._joystick_kind = str(topology.process("joystick").arguments.get("spec", ""))
        self._signal = False
        self._camera: str | None = None
        self._figures: dict[str, object] | None = None
        self._events: deque[Any] = deque(maxlen=_EVENTS_KEPT)
        self._previews = {
            row.name: index for index, row in enumerate(previewed_inputs(topology, segment))
        }
        self.own = OwnMedia(bus, topology, own_inputs(topology, segment), self._clock)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._base = files("pipelines.page") / "static"

    async def run(self) -> None:
        """Serve until the process is told to stop."""
        context = self._context
        context.on_flush(self._tell)
        loop = asyncio.get_running_loop()
        units = Feeds(self._bus, [self._unit_feed(one) for one in self._videos])
        if context.link is not None:
            loop.add_reader(context.link.fileno(), self._read_figures)
        application = web.Application()
        application.router.add_route("*", "/{path:.*}", self._serve)
        runner = web.AppRunner(
            application, access_log=None, handle_signals=False, shutdown_timeout=_END_S
        )
        await runner.setup()
        site = web.SockSite(runner, self._listener.socket, ssl_context=self._tls())
        await site.start()
        state_ns = 0
        while not context.stopping:
            now_ns = self._clock.now_ns()
            context.tick(now_ns)
            if self._clients and now_ns >= state_ns:
                state_ns = now_ns + round(_STATE_S * NS_PER_S) - NS_PER_MS
                self._tell_state(now_ns)
            await asyncio.sleep(PATIENCE_NS / NS_PER_S)
        for client in [*self._clients.values()]:
            with suppress(Exception):
                await asyncio.wait_for(client.socket.close(code=WSCloseCode.GOING_AWAY), _END_S)
        await asyncio.wait_for(runner.cleanup(), 2 * _END_S)
        units.close()
        if self._watched is not None:
            self._watched.close()
        self._starts.close()

    # Requests

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        headers = security_headers(self._listener.scheme, request.headers.get("Host", ""))
        path = request.match_info["path"]
        first, _, rest = path.partition("/")
        seat = path == self._segment.value
        token = request.query.get("token", "") if seat else first
        refusal = self._gate.refusal(
            token=token,
            host=request.headers.get("Host"),
            origin=request.headers.get("Origin"),
            socket=rest in ("ws", "media"),
        )
        if refusal is not None:
            refused = self._counts.refused
            refused[refusal.reason] = refused.get(refusal.reason, 0) + 1
            return web.Response(status=403, text=refusal.text + "\n")
        if request.method != "GET":
            return web.Response(status=405, text="only GET\n", headers=headers)
        role = self._gate.role_of(token)
        assert role is not None
        if seat:
            page = (self._base / f"{self._segment.value}.html").read_text("utf-8")
            page = page.replace(BASE_MARK, f"/{token}/static/")
            return web.Response(text=page, content_type="text/html", headers=headers)
        if rest == "ws":
            return await self._watch(request, role)
        if rest == "media":
            return await self.own.serve(request, role, self._counts)
        name = rest.removeprefix("static/")
        if rest.startswith("static/") and is_static_name(name):
            file = self._base / name
            if file.is_file():
                kind = CONTENT_TYPES[name.rpartition(".")[2]]
                return web.Response(
                    body=file.read_bytes(), content_type=kind, charset="utf-8", headers=headers
                )
        return web.Response(status=404, text="nothing is here\n", headers=headers)

    async def _watch(self, request: web.Request, role: Role) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(
            compress=False,
            max_msg_size=wire.MOST_TEXT_OCTETS,
            writer_limit=_WRITE_LIMIT_OCTETS,
        )
        await socket.prepare(request)
        now_ns = self._clock.now_ns()
        queue = ClientQueue([one.index for one in self._videos])
        client = PageClient(next(self._numbers), role, socket, queue, now_ns)
        self._join(client)
        sending = asyncio.create_task(client.send_all())
        try:
            async for message in socket:
                self._handle_message(client, message.type, message.data)
        except ProtocolError as error:
            self._counts.garbage += 1
            self._counts.closed += 1
            with suppress(ConnectionError):
                await socket.close(code=POLICY, message=str(error).encode()[:120])
        finally:
            self._leave(client)
            sending.cancel()
        return socket

    def _join(self, client: PageClient) -> None:
        self._counts.connections += 1
        first = not self._clients
        self._clients[client.number] = client
        if client.role is Role.OPERATOR:
            self._ownership.handle_joined(client.number)
        if first:
            self._watched = Feeds(self._bus, self._watched_feeds())
            self._context.flush(self._clock.now_ns())
        text = hello(
            self._topology,
            self._segment,
            self._streams,
            role=client.role,
            page=client.number,
            now_ns=self._clock.now_ns(),
            session=self._context.session,
            joystick=self._joystick_kind,
        )
        client.queue.handle_answer(_encode(text).decode())
        if self._figures is not None:
            figures = {**self._figures, "events": [*self._events]}
            client.queue.handle_text("figures", _encode(figures).decode())
        for one in self._videos:
            self._replay(client, one.index)
        self._tell_state(self._clock.now_ns())

    def _leave(self, client: PageClient) -> None:
        self._counts.left_out += client.queue.left_out
        del self._clients[client.number]
        self._ownership.handle_gone(client.number)
        self._release()
        if not self._clients and self._watched is not None:
            self._watched.close()
            self._watched = None
            self._signal, self._joystick = False, None

    def _handle_message(self, client: PageClient, kind: WSMsgType, data: Any) -> None:
        now_ns = self._clock.now_ns()
        if kind is WSMsgType.TEXT:
            client.rates.handle_message("text", now_ns)
            self._handle_request(client, wire.parse_request(data))
        elif kind is WSMsgType.BINARY:
            message = wire.parse_binary(data)
            if isinstance(message, wire.Ping):
                client.rates.handle_message("ping", now_ns)
                client.queue.handle_answer(wire.pack_pong(message, now_ns))
                client.wake()
            elif isinstance(message, wire.HandMoved):
                client.rates.handle_message("hand", now_ns)
                self._handle_hand(client, message, now_ns)
            else:
                raise ProtocolError("pictures and sound have a socket of their own")

    def _handle_hand(self, client: PageClient, moved: wire.HandMoved, now_ns: int) -> None:
        told = PageInput(
            moved.dead_man, moved.x, moved.y, moved.buttons, moved.sequence, received_ns=now_ns
        )
        passed = self._hand.handle_input(client.number, told)
        if passed is not None:
            self._publish_hand(passed)

    def _release(self) -> None:
        released = self._hand.poll_release(self._clock.now_ns())
        if released is not None:
            self._publish_hand(released)

    def _publish_hand(self, hand: PageInput) -> None:
        if self._to_hand is not None:
            stamp = CaptureStamp(hand.received_ns, next(self._samples), "page")
            self._to_hand.publish_octets(pack_input(hand), stamp)

    # What a page asks for in words

    def _handle_request(self, client: PageClient, request: wire.Request) -> None:
        if client.role is not Role.OPERATOR:
            self._answer(client, request, "a viewer may watch only")
            return
        match request.do:
            case "hand":
                self._answer(client, request, self._ask_hand(client, request.action))
                self._release()
                self._tell_state(self._clock.now_ns())
            case "select":
                self._run(self._select(client, request))
            case "joystick":
                self._run(self._command(client, request))
            case "session":
                self._answer(client, request, self._order(request.action))
            case "input":
                self._answer(client, request, "inputs are taken on a socket of their own")

    def _ask_hand(self, client: PageClient, action: str) -> str:
        if self._to_hand is None:
            return "the handle is at the operator's seat"
        handlers = {
            "take": self._ownership.handle_take,
            "give": self._ownership.handle_give,
            "ask": self._ownership.handle_ask,
            "refuse": self._ownership.handle_refuse,
        }
        handler = handlers.get(action)
        return f"{action[:20]}: unknown" if handler is None else handler(client.number)

    def _order(self, action: str) -> str:
        if self._segment is not Segment.GROUND:
            return "the session is started and stopped on the ground"
        try:
            order = Order(action)
        except ValueError:
            return f"{action[:20]}: unknown"
        self._context.order(order, self._clock.now_ns())
        return ""

    async def _select(self, client: PageClient, request: wire.Request) -> None:
        if self._segment is not Segment.SPACE:
            self._answer(client, request, "the operator selects the camera")
            return
        answer = await select_camera(self._context.session, request.camera)
        if answer.ok:
            self._camera = answer.camera
        error = "" if answer.ok else answer.error or "the console gave no reason"
        self._answer(client, request, error, round_trip_ms=answer.round_trip_ms)

    async def _command(self, client: PageClient, request: wire.Request) -> None:
        if self._to_joystick is None:
            self._answer(client, request, "the joystick is at the operator's seat")
            return
        try:
            event = JoystickEvent(request.event)
            packed = pack_request(HandRequest(number := next(self._requests), event))
        except ValueError:
            self._answer(client, request, f"{request.event[:20]}: unknown")
            return
        self._to_joystick.publish_octets(packed, CaptureStamp(self._clock.now_ns(), number, "page"))
        until_ns = self._clock.now_ns() + round(_JOYSTICK_S * NS_PER_S)
        while self._clock.now_ns() < until_ns:
            status = self._joystick
            if status is not None and status.answered == number:
                self._answer(client, request, status.refusal)
                return
            await asyncio.sleep(0.02)
        self._answer(client, request, "the joystick does not answer")

    def _answer(
        self,
        client: PageClient,
        request: wire.Request,
        error: str,
        *,
        round_trip_ms: float | None = None,
    ) -> None:
        answer = wire.Answer(
            request=request.request, ok=not error, error=error, round_trip_ms=round_trip_ms
        )
        client.queue.handle_answer(_encode(answer).decode())
        client.wake()

    # What the seat shows

    def _unit_feed(self, stream: SeatStream) -> Feed:
        history = self._histories[stream.index]

        def handle(lease: Lease) -> None:
            try:
                unit = CodedUnit.unpack(lease.octets())
            except ProtocolError:
                self._counts.garbage += 1
                return
            stamp = lease.stamp
            one = HistoryUnit(
                unit=unit,
                sequence=stamp.sequence,
                capture_ns=stamp.capture_ns if unit.dated else None,
                rtp_timestamp=stamp.rtp_timestamp,
            )
            history.handle_unit(one)
            if unit.refused or not self._clients:
                return
            message = packed_unit(stream.index, one)
            for client in self._clients.values():
                if client.queue.needs_replay(stream.index):
                    self._replay(client, stream.index)
                else:
                    client.queue.handle_unit(stream.index, message)
                client.wake()

        return Feed(topic=stream.topic, handle=handle)

    def _replay(self, client: PageClient, index: int) -> None:
        """Begin a stream at a page: by what is kept, or by a local IDR that is asked for."""
        units = self._histories[index].replay
        if units is None:
            self._starts.want(index)
            return
        *earlier, newest = units
        messages = [packed_unit(index, one, flags=wire.REPLAYED) for one in earlier]
        client.queue.handle_replay(index, [*messages, packed_unit(index, newest)])
        client.wake()

    def _begin_at(self, index: int, messages: list[bytes]) -> None:
        """A local IDR and the units after it are there for all pages that wait for them."""
        for client in self._clients.values():
            if client.queue.needs_replay(index):
                client.queue.handle_replay(index, messages)
                client.wake()

    def _watched_feeds(self) -> list[Feed]:
        """What is read only while somebody watches."""
        topology, segment = self._topology, self._segment
        feeds = [
            Feed(topic=one.topic, handle=self._sound_handler(one))
            for one in self._streams
            if one.via == "sound"
        ]
        link = topology.link(segment.transmits)
        feeds.append(Feed(topic=link.backlog_topic, handle=self._handle_backlog, newest=True))
        if segment is Segment.SPACE:
            feeds += [
                Feed(topic=JOYSTICK_TRACE_TOPIC, handle=lambda lease: self._haptics(0, lease)),
                Feed(topic=JOYSTICK_STATE_TOPIC, handle=self._handle_joystick, newest=True),
            ]
        else:
            feeds += [
                Feed(topic=ROBOT_TRACE_TOPIC, handle=lambda lease: self._haptics(1, lease)),
                Feed(topic=SELECTED_TOPIC, handle=self._handle_selected, newest=True),
                *(
                    Feed(
                        topic=topology.input(name).preview_topic,
                        handle=self._preview_handler(index),
                        depth=1,
                        newest=True,
                    )
                    for name, index in self._previews.items()
                ),
            ]
        return feeds

    def _sound_handler(self, stream: SeatStream) -> Any:
        def handle(lease: Lease) -> None:
            stamp = lease.stamp
            message = wire.pack_sound(
                stream.index,
                lease.octets(),
                flags=wire.CONCEALED if stamp.quality is Quality.CONCEALED else 0,
                sequence=stamp.sequence,
                capture_ns=stamp.capture_ns,
            )
            for client in self._clients.values():
                client.queue.handle_sound(stream.index, message)
                client.wake()

        return handle

    def _preview_handler(self, index: int) -> Any:
        def handle(lease: Lease) -> None:
            message = wire.pack_preview(
                index, lease.width, lease.height, lease.stamp.capture_ns, lease.octets()
            )
            for client in self._clients.values():
                client.queue.handle_preview(index, message)
                client.wake()

        return handle

    def _haptics(self, end: int, lease: Lease) -> None:
        message = wire.pack_haptics(end, rows_of(lease.octets()))
        for client in self._clients.values():
            client.queue.handle_haptics(end, message)
            client.wake()

    def _handle_backlog(self, lease: Lease) -> None:
        self._signal = Backlog.unpack(lease.octets()).peer_heard

    def _handle_selected(self, lease: Lease) -> None:
        self._camera = Choice.unpack(lease.octets()).camera

    def _handle_joystick(self, lease: Lease) -> None:
        self._joystick = unpack_status(lease.octets())

    def _read_figures(self) -> None:
        while (text := self._context.receive_figures()) is not None:
            self._figures = figures = msgspec.json.decode(text)
            self._events.extend(figures["events"])
            camera = figures["figures"].get("processes.selector.selected")
            if camera is not None and self._segment is Segment.SPACE:
                self._camera = camera
            for client in self._clients.values():
                client.queue.handle_text("figures", text.decode())
                client.wake()

    def _tell_state(self, now_ns: int) -> None:
        if self._watched is not None:
            # The state of the link and of commands is published without a notification.
            self._watched.read_all()
        status = self._joystick
        joystick = None
        if status is not None:
            joystick = JoystickText(
                state=JoystickState(status.state).words,
                reason=status.reason,
                dead_man=status.dead_man,
                force_limit_n=status.force_limit_n,
                device=status.device,
            )
        for client in self._clients.values():
            text = StateText(
                now_us=now_ns // NS_PER_US,
                link="connected" if self._signal else "lost",
                signal=self._signal,
                camera=self._camera,
                joystick=joystick,
                hand=hand_text(self._ownership.state, client.number),
                inputs=self.own.holders,
            )
            client.queue.handle_text("state", _encode(text).decode())
            client.wake()

    def _writer(self, topic: str, octets: int) -> Writer:
        return self._bus.writer(topic, max_octets=octets, wake=False)

    def _run(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _tls(self) -> ssl.SSLContext | None:
        certificate = self._listener.certificate
        if certificate is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        return context

    def _tell(self) -> None:
        counts, probe = self._counts, self._context.probe
        waiting = sum(client.queue.left_out for client in self._clients.values())
        probe.count(
            PageCounters(
                connections=counts.connections,
                refused=dict(counts.refused),
                garbage=counts.garbage,
                units_left_out=counts.left_out + waiting,
                sockets_closed=counts.closed,
            )
        )
        probe.gauge(PageGauges(watching=len(self._clients)))


def packed_unit(index: int, one: HistoryUnit, *, flags: int = 0) -> bytes:
    """Return a unit as a message to a page."""
    unit: CodedUnit = one.unit
    flags |= wire.KEY * unit.key | wire.DAMAGED * unit.damaged
    return wire.pack_unit(
        index, unit.data, flags=flags, sequence=one.sequence, capture_ns=one.capture_ns
    )


def row_of(stream: SeatStream) -> VideoRow:
    """Return the row of a stream of pictures."""
    assert isinstance(stream.row, VideoRow)
    return stream.row
