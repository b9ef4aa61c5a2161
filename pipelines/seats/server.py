"""The server of one seat: HTTP and web sockets around `Seat`, and the topics that it reads."""

import asyncio
import logging
import socket
import ssl
from collections import deque
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
from aiohttp import WSMessage, WSMsgType, web

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import I420, CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.topics.bus import Lease, TopicBus, Writer
from pipelines.hand.hand_topics import (
    INPUT_OCTETS,
    REQUEST_OCTETS,
    pack_input,
    pack_request,
    unpack_status,
)
from pipelines.media.following import Choice
from pipelines.media.local_key import filmed_key, key_of
from pipelines.mission.tmtc_messages import unpack_news
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.seats.own_inputs import Given
from pipelines.seats.plan import SeatStream, Unpack, Via, seat_plan
from pipelines.seats.recorder_link import ask_recorder
from pipelines.seats.seat import (
    CommandGiven,
    HandMoved,
    RecordingAsked,
    Seat,
    SessionOrdered,
    TmtcAsked,
)
from pipelines.session.access import Access, AccessError, Found, Kind, headers
from pipelines.session.feeds import Feed, State
from pipelines.session.figures import PageCounters, PageGauges
from pipelines.session.messages import MOST_SEAT_OCTETS, most_media_octets
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.seat_roles import Role
from pipelines.session.topology import (
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    PAGES,
    SELECTED_TOPIC,
    TMTC_TOPICS,
    Segment,
)
from telepresence.link.backlog import Backlog
from telepresence.tasks.definitions import Catalogue
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

STATIC = Path(__file__).parent / "static"
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
#: In an HTML file: where the seat's own files are.
_BASE = "__BASE__"
#: Sockets beyond these are refused.
_MOST_PAGES, _MOST_MEDIA = 16, 16
#: The kernel's buffer for one page: a stalled page keeps less than a second, and gets the newest.
_SEND_OCTETS = 64 << 10
#: A page that takes nothing for so long is closed.
_STALLED_NS = 30 * NS_PER_S
_CLOSE_S = 0.5
#: After so many messages to one page the others have their turn.
_TURN = 16
#: Unread samples of a topic that are kept.
_DEPTH = 8
#: Pictures that are kept until the unit of one comes: a sender may wait for its channel.
_FILMED = 8
_GOING_AWAY, _POLICY_VIOLATION = 1001, 1008
#: As many news of telecommands and telemetry as their topic keeps.
_NEWS = 32
#: By end: the pages beside the seat of the same name.
_OTHERS = {Segment.SPACE: ("panel", "k2cp"), Segment.GROUND: ("top", "k2sv")}
#: In the query of a socket: without pictures, sound and haptics.
_PLAIN = "plain"


class PageServer:
    """Serves the pages of `segment` until `context.stopping`.

    While nobody looks, only the units of pictures and what telecommands and telemetry bring are
    read, for those who join. tasks: what people in space know of the session's.
    """

    def __init__(
        self,
        context: Context,
        segment: Segment,
        bus: TopicBus,
        tasks: Catalogue | None = None,
    ) -> None:
        self._context, self._bus, self._segment = context, bus, segment
        self._now_ns = context.clock.now_ns
        self._listener = context.pages[PAGES[segment]]
        self._access = Access(
            seat=segment.value,
            scheme=self._listener.scheme,
            port=self._listener.port,
            names=self._listener.names,
            operator_token=self._listener.operator_token,
            viewer_token=self._listener.viewer_token,
            role_tokens=self._listener.role_tokens,
            others=_OTHERS[segment],
        )
        plan = seat_plan(
            context.topology, segment, context.session, built_in_dictionary(), tasks=tasks
        )
        self._seat = Seat(plan, first_command=self._now_ns())
        self._loop = asyncio.get_running_loop()
        self._ended: asyncio.Future[None] = self._loop.create_future()
        self._tasks: set[asyncio.Task[None]] = set()
        self._sockets: set[web.WebSocketResponse] = set()
        self._wakes: dict[int, asyncio.Event] = {}
        self._media = 0
        #: By page: since when it takes nothing.
        self._blocked: dict[int, tuple[int, asyncio.Transport]] = {}
        self._connections = self._garbage = self._closed = 0
        self._refused: dict[str, int] = {}
        self._numbers = count()
        # Read always: what is said in the chat while no page is open must not be missed.
        self._news = Feed(self._loop, bus, TMTC_TOPICS[segment], self._handle_news, depth=_NEWS)
        self._histories = [
            Feed(self._loop, bus, each.topic, partial(self._unit, each.index), depth=_DEPTH)
            for each in plan.streams
            if each.via is not Via.SOUND
        ]
        self._live = [
            *(
                Feed(self._loop, bus, one.topic, partial(self._sound, one.index), depth=_DEPTH)
                for one in plan.streams
                if one.via is Via.SOUND
            ),
            *(
                Feed(self._loop, bus, topic, partial(self._haptics, end), depth=_DEPTH)
                for end, topic in plan.traces.items()
            ),
            *(
                Feed(self._loop, bus, one.topic, partial(self._preview, one.index), depth=1)
                for one in plan.previews
            ),
        ]
        self._backlog = State(bus, plan.backlog_topic)
        #: By kind of text: what a process of the mission shows, and how to read it.
        self._shown: dict[str, tuple[State, Unpack]] = {
            kind: (State(bus, topic), unpack) for kind, (topic, unpack) in plan.shown.items()
        }
        self._selected: State | None = None
        self._decoded: dict[int, Feed] = {}
        #: By stream: the pictures that its sender may encode, and from which topic they come.
        self._filmed: dict[int, tuple[str, Feed, deque[tuple[int, I420]]]] = {}
        self._coding: set[int] = set()
        self._hand: Writer | None = None
        self._commands: Writer | None = None
        if segment is Segment.SPACE:
            self._live.append(
                Feed(self._loop, bus, JOYSTICK_STATE_TOPIC, self._status, depth=_DEPTH)
            )
            self._hand = bus.writer(HAND_INPUT_TOPIC, max_octets=INPUT_OCTETS, wake=False)
            self._commands = bus.writer(HAND_REQUEST_TOPIC, max_octets=REQUEST_OCTETS, wake=False)
        else:
            self._selected = State(bus, SELECTED_TOPIC)
        self._own = {
            each.index: bus.writer(
                each.topic,
                max_octets=each.size[0] * each.size[1] * 3 // 2 if each.size else 2 * 960,
            )
            for each in plan.inputs
        }

    async def run(self) -> None:
        """Serve, and close all sockets in the end."""
        context = self._context
        context.on_flush(self._tell)
        self._loop.set_exception_handler(self._handle_bug)
        for feed in (*self._histories, self._news):
            feed.open()
        if context.link is not None:
            self._loop.add_reader(context.link.fileno(), self._figures)
        # Requests that are no HTTP are no news; our own mistakes end the process.
        quiet = logging.getLogger("pipelines.seats")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        server = web.Server(self._handle, access_log=None, logger=quiet)
        runner = web.ServerRunner(server, shutdown_timeout=_CLOSE_S)
        await runner.setup()
        site = web.SockSite(runner, self._listener.socket, ssl_context=self._tls())
        await site.start()
        self._tick()
        try:
            await self._ended
        finally:
            await asyncio.gather(
                *(self._close(each, _GOING_AWAY, "the server ends") for each in self._sockets)
            )
            for task in self._tasks:
                task.cancel()
            await runner.cleanup()
            filmed = (feed for _, feed, _ in self._filmed.values())
            for feed in (
                *self._histories,
                self._news,
                *self._live,
                *self._decoded.values(),
                *filmed,
            ):
                feed.close()

    def _tls(self) -> ssl.SSLContext | None:
        if self._listener.scheme != "https" or self._listener.certificate is None:
            return None
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        tls.load_cert_chain(self._listener.certificate)
        return tls

    # Time

    def _tick(self) -> None:
        context, now_ns = self._context, self._now_ns()
        context.tick(now_ns)
        if context.stopping:
            if not self._ended.done():
                self._ended.set_result(None)
            return
        self._loop.call_later(PATIENCE_NS / NS_PER_S, self._tick)
        if self._seat.watching:
            self._look(now_ns)
            self._seat.handle_time(now_ns)
            self._settle()
        for since_ns, transport in list(self._blocked.values()):
            if now_ns - since_ns > _STALLED_NS:
                transport.abort()

    def _look(self, now_ns: int) -> None:
        """Read what changes too often to wake for it."""
        told = self._backlog.latest()
        if told is not None:
            self._seat.handle_signal(Backlog.unpack(told).peer_heard, now_ns)
        for kind, (state, unpack) in self._shown.items():
            if (shown := state.latest()) is not None:
                self._seat.handle_shown(kind, unpack(shown))
        chosen = None if self._selected is None else self._selected.latest()
        if chosen is not None:
            self._seat.handle_camera(Choice.unpack(chosen).camera, now_ns)

    # Topics

    def _unit(self, stream: int, lease: Lease) -> None:
        unit = CodedUnit.unpack(lease.octets())
        self._seat.handle_unit(stream, unit, lease.stamp, self._now_ns())
        if stream in self._filmed and stream not in self._coding:
            self._match(stream, unit, lease.stamp)
        self._settle()

    def _sound(self, stream: int, lease: Lease) -> None:
        self._seat.handle_sound(stream, lease.octets(), lease.stamp)
        self._settle()

    def _haptics(self, end: int, lease: Lease) -> None:
        self._seat.handle_haptics(end, lease.octets())
        self._settle()

    def _preview(self, preview: int, lease: Lease) -> None:
        self._seat.handle_preview(preview, lease.video().data, lease.stamp)
        self._settle()

    def _handle_news(self, lease: Lease) -> None:
        news = unpack_news(lease.octets())
        if news is not None:
            self._seat.handle_news(news, self._now_ns())
            self._settle()

    def _status(self, lease: Lease) -> None:
        status = unpack_status(lease.octets())
        if status is not None:
            self._seat.handle_status(status, self._now_ns())
            self._settle()

    def _figures(self) -> None:
        while (text := self._context.receive_figures()) is not None:
            self._seat.handle_figures(text, self._now_ns())
        self._settle()

    def _picture(self, stream: SeatStream, lease: Lease) -> None:
        """A decoded picture, for those who cannot begin otherwise."""
        timestamp = lease.stamp.rtp_timestamp
        if stream.index in self._coding or timestamp is None:
            return
        self._coding.add(stream.index)
        picture = lease.video().data.copy()
        taken = partial(self._seat.handle_decoded, stream.index, rtp_timestamp=timestamp)
        self._begin(self._code(stream.index, partial(key_of, picture), taken))

    def _match(self, stream: int, unit: CodedUnit, stamp: CaptureStamp) -> None:
        """A unit whose picture may be here, for those who cannot begin otherwise."""
        for capture_ns, picture in self._filmed[stream][2]:
            if capture_ns == stamp.capture_ns:
                self._coding.add(stream)
                taken = partial(self._seat.handle_filmed, stream, sequence=stamp.sequence)
                coded = partial(filmed_key, picture, unit.width, unit.height)
                self._begin(self._code(stream, coded, taken))
                return

    async def _code(
        self, stream: int, coded: Callable[[], bytes], taken: Callable[[bytes], bool]
    ) -> None:
        # In a thread, because it takes longer than pages may wait.
        key = await asyncio.to_thread(coded)
        self._coding.discard(stream)
        taken(key)
        self._settle()

    def _watch(self) -> None:
        """Open what pages are shown with the first of them, and close it with the last."""
        feeds: list[Feed | State] = [*self._live, self._backlog]
        feeds += [state for state, _ in self._shown.values()]
        if self._selected is not None:
            feeds.append(self._selected)
        for feed in feeds:
            if self._seat.watching:
                feed.open()
            else:
                feed.close()
        # The launcher sends figures only when it knows.
        self._context.flush(self._now_ns())

    def _settle(self) -> None:
        """Do what the seat has decided, and wake the pages for which something waits."""
        seat = self._seat
        while (event := seat.next_event()) is not None:
            match event:
                case HandMoved(hand) if self._hand is not None:
                    stamp = CaptureStamp(hand.received_ns, hand.sequence, "page")
                    self._hand.publish_octets(pack_input(hand), stamp)
                case CommandGiven(request) if self._commands is not None:
                    stamp = CaptureStamp(self._now_ns(), next(self._numbers), "page")
                    self._commands.publish_octets(pack_request(request), stamp)
                case SessionOrdered(order):
                    self._context.order(order, self._now_ns())
                case RecordingAsked():
                    self._begin(self._record(event))
                case TmtcAsked(asked):
                    # One that is not taken now is repeated.
                    send_to_tmtc(self._context.session, self._segment, asked)
        for number, wake in self._wakes.items():
            if seat.waits(number):
                wake.set()
        self._fetch_pictures()

    def _fetch_pictures(self) -> None:
        wanted = set(self._seat.wanted_pictures())
        for index in [index for index in self._decoded if index not in wanted]:
            self._decoded.pop(index).close()
        for each in self._seat.plan.streams:
            if each.index in wanted - self._decoded.keys() and each.decoded_topic is not None:
                feed = Feed(
                    self._loop, self._bus, each.decoded_topic, partial(self._picture, each), depth=1
                )
                self._decoded[each.index] = feed
                feed.open()
        self._fetch_filmed()

    def _fetch_filmed(self) -> None:
        """Keep the newest pictures of the selected camera while a page waits for a stream of it."""
        wanted = self._seat.wanted_filmed()
        for index, (topic, feed, _) in list(self._filmed.items()):
            if wanted.get(index) != topic:
                del self._filmed[index]
                feed.close()
        for index, topic in wanted.items():
            if index not in self._filmed:
                kept: deque[tuple[int, I420]] = deque(maxlen=_FILMED)
                feed = Feed(self._loop, self._bus, topic, partial(_keep, kept), depth=_DEPTH)
                self._filmed[index] = topic, feed, kept
                feed.open()

    async def _record(self, asked: RecordingAsked) -> None:
        error = await ask_recorder(self._context.session, begin=asked.begin)
        self._seat.handle_recorder(asked, error)
        self._settle()

    # HTTP

    async def _handle(self, request: web.BaseRequest) -> web.StreamResponse:
        host = request.headers.get("Host", "")
        try:
            found = self._access.find(
                request.method, request.raw_path, host, request.headers.get("Origin")
            )
            return await self._serve(request, found, host)
        except AccessError as refusal:
            if refusal.reason:
                self._refused[refusal.reason] = self._refused.get(refusal.reason, 0) + 1
            return web.Response(
                status=refusal.status, text=f"{refusal}\n", headers=headers("localhost")
            )
        except (ConnectionError, asyncio.CancelledError):
            raise
        except Exception as error:
            self._fail(error)
            raise

    async def _serve(self, request: web.BaseRequest, found: Found, host: str) -> web.StreamResponse:
        if found.kind is Kind.SEAT:
            return await self._serve_seat(request, found.role)
        if found.kind is Kind.MEDIA:
            return await self._serve_media(request, found.role)
        name = f"{found.name}.html" if found.kind is Kind.PAGE else found.name
        data = _file(name)
        if found.kind is Kind.PAGE:
            data = data.replace(_BASE.encode(), f"/{found.token}/static/".encode())
        kind = _TYPES[Path(name).suffix]
        fields = headers(host) | {"Content-Type": f"{kind}; charset=utf-8"}
        return web.Response(body=data, headers=fields)

    async def _serve_seat(self, request: web.BaseRequest, role: Role) -> web.StreamResponse:
        if self._seat.watching >= _MOST_PAGES:
            raise AccessError(503, "too many pages are open")
        ws = await self._open(request, MOST_SEAT_OCTETS)
        transport = request.transport
        if transport is None:
            return ws
        plain = request.query_string == _PLAIN
        number = self._seat.handle_opened(role, self._now_ns(), plain=plain)
        if self._seat.watching == 1:
            self._watch()
        self._wakes[number] = asyncio.Event()
        sending = asyncio.create_task(self._send(ws, transport, number))
        self._settle()
        try:
            await self._receive(ws, partial(self._take_seat, number))
        finally:
            sending.cancel()
            self._wakes.pop(number)
            self._seat.handle_closed(number, self._now_ns())
            self._settle()
            if not self._seat.watching:
                self._watch()
            with suppress(asyncio.CancelledError):
                await sending
        return ws

    async def _serve_media(self, request: web.BaseRequest, role: Role) -> web.StreamResponse:
        if self._media >= _MOST_MEDIA:
            raise AccessError(503, "too many cameras and microphones are open")
        seat = self._seat
        ws = await self._open(request, most_media_octets(seat.plan.sizes))
        number = seat.handle_media_opened(role)
        self._media += 1
        answers: asyncio.Queue[str | bytes] = asyncio.Queue(_TURN)
        sending = asyncio.create_task(_send_all(ws, answers))
        try:
            await self._receive(ws, partial(self._take_media, number, answers))
        finally:
            sending.cancel()
            self._media -= 1
            seat.inputs.handle_closed(number)
            with suppress(asyncio.CancelledError):
                await sending
        return ws

    async def _open(self, request: web.BaseRequest, most_octets: int) -> web.WebSocketResponse:
        # aiohttp refuses messages of its limit, too.
        ws = web.WebSocketResponse(
            timeout=_CLOSE_S, compress=False, max_msg_size=most_octets + 1, writer_limit=0
        )
        await ws.prepare(request)
        transport = request.transport
        if transport is not None:
            # Then a message is written only when the one before has left this process. Not 0:
            # with TLS, asyncio takes an empty buffer for one that has reached that limit.
            transport.set_write_buffer_limits(high=1)
            connection = transport.get_extra_info("socket")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_OCTETS)
        self._connections += 1
        self._sockets.add(ws)
        return ws

    async def _receive(self, ws: web.WebSocketResponse, take: Callable[[WSMessage], None]) -> None:
        """Take what comes until the socket is closed; close it after garbage."""
        try:
            async for message in ws:
                take(message)
        except ProtocolError as error:
            self._garbage += 1
            self._closed += 1
            await self._close(ws, _POLICY_VIOLATION, str(error))
        finally:
            self._sockets.discard(ws)

    def _take_seat(self, number: int, message: WSMessage) -> None:
        now_ns = self._now_ns()
        if message.type is WSMsgType.BINARY:
            self._seat.handle_message(number, message.data, now_ns)
        elif message.type is WSMsgType.TEXT:
            self._seat.handle_text(number, message.data, now_ns)
        else:
            raise ProtocolError("no message of a page")
        if self._seat.overflowed(number):
            raise ProtocolError("answers are not read")
        self._settle()

    def _take_media(
        self, number: int, answers: "asyncio.Queue[str | bytes]", message: WSMessage
    ) -> None:
        now_ns, inputs = self._now_ns(), self._seat.inputs
        result: str | bytes | Given | None
        if message.type is WSMsgType.BINARY:
            result = inputs.handle_message(number, message.data, now_ns)
        elif message.type is WSMsgType.TEXT:
            result = inputs.handle_text(number, message.data, now_ns)
        else:
            raise ProtocolError("no message of a page")
        if isinstance(result, Given):
            self._publish(result)
        elif result is not None:
            if answers.full():
                raise ProtocolError("answers are not read")
            answers.put_nowait(result)

    def _publish(self, given: Given) -> None:
        writer, size = self._own[given.input.index], given.input.size
        if size is None:
            writer.publish_octets(bytes(given.data), given.stamp)
            return
        loan = writer.loan_picture(*size)
        loan.payload[:] = np.frombuffer(given.data, np.uint8)
        loan.publish(given.stamp)

    async def _send(
        self, ws: web.WebSocketResponse, transport: asyncio.Transport, number: int
    ) -> None:
        """Send to one page what waits for it, as fast as it takes it."""
        wake, sent = self._wakes[number], 0
        with suppress(ConnectionError):
            while True:
                message = self._seat.poll_transmit(number)
                if message is None:
                    wake.clear()
                    await wake.wait()
                    continue
                self._blocked[number] = self._now_ns(), transport
                try:
                    if isinstance(message, bytes):
                        await ws.send_bytes(message)
                    else:
                        await ws.send_str(message)
                finally:
                    del self._blocked[number]
                sent += 1
                if sent % _TURN == 0:
                    await asyncio.sleep(0)

    async def _close(self, ws: web.WebSocketResponse, code: int, words: str) -> None:
        """Close a socket, also one whose page reads nothing."""
        with suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(_CLOSE_S):
                # A close frame has room for 123 octets of reason (RFC 6455 section 5.5).
                await ws.close(code=code, message=words.encode()[:120])

    # Faults of our own

    def _begin(self, task: Coroutine[None, None, None]) -> None:
        begun = self._loop.create_task(task)
        self._tasks.add(begun)
        begun.add_done_callback(self._handle_done)

    def _handle_done(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._fail(error)

    def _handle_bug(self, loop: asyncio.AbstractEventLoop, told: dict[str, object]) -> None:
        error = told.get("exception")
        if isinstance(error, Exception) and not isinstance(error, OSError):
            self._fail(error)

    def _fail(self, error: BaseException) -> None:
        """A bug ends the process; the launcher starts it again."""
        if not self._ended.done():
            self._ended.set_exception(error)

    def _tell(self) -> None:
        probe = self._context.probe
        probe.gauge(PageGauges(watching=self._seat.watching, holder=self._seat.holder or 0))
        probe.count(
            PageCounters(
                connections=self._connections,
                refused=dict(self._refused),
                garbage=self._garbage,
                units_left_out=self._seat.left_out,
                sockets_closed=self._closed,
            )
        )


async def _send_all(ws: web.WebSocketResponse, answers: "asyncio.Queue[str | bytes]") -> None:
    with suppress(ConnectionError):
        while True:
            answer = await answers.get()
            if isinstance(answer, bytes):
                await ws.send_bytes(answer)
            else:
                await ws.send_str(answer)


def _keep(kept: deque[tuple[int, I420]], lease: Lease) -> None:
    kept.append((lease.stamp.capture_ns, lease.video().data.copy()))


def _file(name: str) -> bytes:
    path = STATIC / name
    if path.suffix not in _TYPES or not path.is_file():
        raise AccessError(404, "no such file")
    return path.read_bytes()
