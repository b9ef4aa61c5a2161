"""The camera and the microphone of a page's person, on a socket of their own.

A page's instants become the session's by the least delay that its messages had on their way: what
is captured is then dated too late by that least delay, less than a millisecond on one machine.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Protocol

import msgspec
from aiohttp import WSMsgType, web

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.errors import ProtocolError
from kontur_av.media import BLOCK_SAMPLES, CaptureStamp
from kontur_av.topics.bus import TopicBus, Writer
from pipelines.page import wire
from pipelines.page.access import Role
from pipelines.page.client import POLICY
from pipelines.page.rates import RateGuard
from pipelines.setup.table import VideoStream
from pipelines.topology import InputRow, Topology

#: Nothing is dated earlier than this before it came.
_OLDEST_NS = 500 * NS_PER_MS


class Counted(Protocol):
    """What is counted of the sockets."""

    connections: int
    garbage: int
    closed: int


class _Input:
    def __init__(self, row: InputRow, size: tuple[int, int] | None, writer: Writer) -> None:
        self.row, self.size, self.writer = row, size, writer
        self.holder: int | None = None
        self.sequence = 0


class PageTime:
    """A page's clock, by its messages. A core."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def handle_message(self, page_ms: float, now_ns: int) -> None:
        """A message that was sent at once has come."""
        offset_ns = now_ns - round(page_ms * NS_PER_MS)
        if self._offset_ns is None or offset_ns < self._offset_ns:
            self._offset_ns = offset_ns

    def session_ns(self, page_ms: float, now_ns: int) -> int:
        """Return a page's instant on the session's clock: at most now, and at least 500 ms ago."""
        offset_ns = 0 if self._offset_ns is None else self._offset_ns
        return max(now_ns - _OLDEST_NS, min(now_ns, round(page_ms * NS_PER_MS) + offset_ns))


class OwnMedia:
    """The inputs of a seat that its pages can take over; each belongs to one page at most."""

    def __init__(
        self,
        bus: TopicBus,
        topology: Topology,
        inputs: Sequence[InputRow],
        clock: MonotonicClock,
    ) -> None:
        self._clock = clock
        self._inputs = []
        for row in inputs:
            stream = topology.media(row.stream).stream
            size = (stream.width, stream.height) if isinstance(stream, VideoStream) else None
            octets = 2 * BLOCK_SAMPLES if size is None else size[0] * size[1] * 3 // 2
            self._inputs.append(_Input(row, size, bus.writer(row.page_topic, max_octets=octets)))
        self._most_octets = wire.HEADER_OCTETS + max(
            (one.size[0] * one.size[1] * 3 // 2 for one in self._inputs if one.size is not None),
            default=wire.OWN_SOUND_OCTETS,
        )
        self._sockets = 0

    @property
    def holders(self) -> dict[str, int | None]:
        """By input: the number of the socket whose page gives it."""
        return {one.row.name: one.holder for one in self._inputs}

    async def serve(self, request: web.Request, role: Role, counts: Counted) -> web.StreamResponse:
        """Serve one page's socket until it is closed."""
        if role is not Role.OPERATOR:
            return web.Response(status=403, text="a viewer may watch only\n")
        # aiohttp refuses a message of the limit itself.
        socket = web.WebSocketResponse(compress=False, max_msg_size=self._most_octets + 1)
        await socket.prepare(request)
        counts.connections += 1
        self._sockets += 1
        page, rates, time = self._sockets, RateGuard(self._clock.now_ns()), PageTime()
        try:
            async for message in socket:
                answer = self._handle(page, message.type, message.data, rates, time)
                if isinstance(answer, bytes):
                    await socket.send_bytes(answer)
                elif answer is not None:
                    await socket.send_str(answer)
        except ProtocolError as error:
            counts.garbage += 1
            counts.closed += 1
            with suppress(ConnectionError):
                await socket.close(code=POLICY, message=str(error).encode()[:120])
        except ConnectionError:
            pass
        finally:
            for one in self._inputs:
                if one.holder == page:
                    one.holder = None
        return socket

    def _handle(
        self, page: int, kind: WSMsgType, data: Any, rates: RateGuard, time: PageTime
    ) -> bytes | str | None:
        now_ns = self._clock.now_ns()
        if kind is WSMsgType.TEXT:
            rates.handle_message("text", now_ns)
            request = wire.parse_request(data)
            error = self._take(page, request)
            answer = wire.Answer(request=request.request, ok=not error, error=error)
            return msgspec.json.encode(answer).decode()
        if kind is not WSMsgType.BINARY:
            return None
        message = wire.parse_binary(data)
        if isinstance(message, wire.Ping):
            rates.handle_message("ping", now_ns)
            time.handle_message(message.page_ms, now_ns)
            return wire.pack_pong(message, now_ns)
        if isinstance(message, wire.HandMoved):
            raise ProtocolError("the hand has another socket")
        picture = isinstance(message, wire.OwnPicture)
        rates.handle_message("picture" if picture else "sound", now_ns)
        if message.input >= len(self._inputs):
            raise ProtocolError(f"input {message.input}: there are {len(self._inputs)}")
        one = self._inputs[message.input]
        size = (message.width, message.height) if isinstance(message, wire.OwnPicture) else None
        if size != one.size:
            raise ProtocolError(f"{one.row.name}: {size} in the place of {one.size}")
        if one.holder != page:
            return None
        stamp = CaptureStamp(time.session_ns(message.page_ms, now_ns), one.sequence, one.row.name)
        one.sequence += 1
        octets = message.i420 if isinstance(message, wire.OwnPicture) else message.samples
        width, height = size or (0, 0)
        loan = one.writer.loan(len(octets), width, height)
        loan.payload[:] = memoryview(octets)
        loan.publish(stamp)
        return None

    def _take(self, page: int, request: wire.Request) -> str:
        found = [one for one in self._inputs if one.row.name == request.name]
        if request.do != "input" or not found:
            return "there is no such input at this seat"
        (one,) = found
        if one.holder not in (None, page):
            return f"another page gives {one.row.name}"
        one.holder = page if request.on else None
        return ""
