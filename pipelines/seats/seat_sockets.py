"""The web sockets of pages: each is written as fast as its page reads, and closed after garbage."""

import asyncio
import socket
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress

from aiohttp import WSMsgType, web

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.session.access import AccessError

#: The kernel's buffer for one page: a stalled page keeps less than a second, and gets the newest.
_SEND_OCTETS = 64 << 10
#: A page that takes nothing for this long is closed.
_STALLED_NS = 30 * NS_PER_S
_CLOSE_S = 0.5
#: After this many messages to one page the others have their turn.
_TURN = 16
_GOING_AWAY, _POLICY_VIOLATION = 1001, 1008

Message = bytes | str
Take = Callable[[Message], None]
Next = Callable[[], Awaitable[Message]]


class SeatSockets:
    """All web sockets of a server. connections, garbage, closed: counted since the start."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.connections = self.garbage = self.closed = 0
        self._now_ns = now_ns
        self._open: set[SeatSocket] = set()

    def __len__(self) -> int:
        return len(self._open)

    async def open(
        self, request: web.BaseRequest, most_octets: int, protocols: Sequence[str] = ()
    ) -> "SeatSocket":
        """Answer a request with a web socket.

        most_octets: of a message of the page. protocols: of which the page must know one, if any.
        """
        # aiohttp refuses messages of its limit, too.
        ws = web.WebSocketResponse(
            timeout=_CLOSE_S,
            protocols=protocols,
            compress=False,
            max_msg_size=most_octets + 1,
            writer_limit=0,
        )
        try:
            await ws.prepare(request)
        except web.HTTPException as error:
            raise AccessError(error.status, "this address is for web sockets") from None
        self.connections += 1
        return SeatSocket(ws, request.transport, self._now_ns)

    async def serve(self, one: "SeatSocket", take: Take, next_message: Next) -> None:
        """Take what comes and send what there is, until it is closed; close it after garbage."""
        self._open.add(one)
        sending = asyncio.create_task(one.send(next_message))
        # A page that is sent nothing any more must not wait for it.
        sending.add_done_callback(one.handle_sent)
        try:
            await one.receive(take)
        except ProtocolError as error:
            self.garbage += 1
            self.closed += 1
            await one.close(_POLICY_VIOLATION, str(error))
        finally:
            self._open.discard(one)
            sending.cancel()
            with suppress(asyncio.CancelledError):
                await sending

    def handle_time(self, now_ns: int) -> None:
        for one in self._open:
            one.handle_time(now_ns)

    async def close(self) -> None:
        """Close all, because the server ends."""
        await asyncio.gather(*(one.close(_GOING_AWAY, "the server ends") for one in self._open))


class SeatSocket:
    """One web socket. ws: as aiohttp wants it for an answer."""

    def __init__(
        self,
        ws: web.WebSocketResponse,
        transport: asyncio.Transport | None,
        now_ns: Callable[[], int],
    ) -> None:
        self.ws = ws
        self._transport, self._now_ns = transport, now_ns
        #: Since when the page takes nothing; None while it takes.
        self._blocked_ns: int | None = None
        if transport is not None:
            # Then a message is written only when the one before has left this process. Not 0:
            # with TLS, asyncio takes an empty buffer for one that has reached that limit.
            transport.set_write_buffer_limits(high=1)
            connection = transport.get_extra_info("socket")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_OCTETS)

    async def receive(self, take: Take) -> None:
        """Pass messages on until the socket is closed. ProtocolError for garbage."""
        async for message in self.ws:
            if message.type not in (WSMsgType.BINARY, WSMsgType.TEXT):
                raise ProtocolError("no message of a page")
            take(message.data)

    async def send(self, next_message: Next) -> None:
        """Send what `next_message` returns, as fast as the page takes it, until it is gone."""
        sent = 0
        with suppress(ConnectionError):
            while True:
                message = await next_message()
                self._blocked_ns = self._now_ns()
                try:
                    if isinstance(message, bytes):
                        await self.ws.send_bytes(message)
                    else:
                        await self.ws.send_str(message)
                finally:
                    self._blocked_ns = None
                sent += 1
                if sent % _TURN == 0:
                    await asyncio.sleep(0)

    def handle_sent(self, sending: "asyncio.Task[None]") -> None:
        """Sending has ended: after a mistake, end the connection."""
        if not sending.cancelled() and sending.exception() and self._transport is not None:
            self._transport.abort()

    def handle_time(self, now_ns: int) -> None:
        since_ns = self._blocked_ns
        if since_ns is not None and now_ns - since_ns > _STALLED_NS and self._transport is not None:
            self._transport.abort()

    async def close(self, code: int, words: str) -> None:
        """Close the socket, also if its page reads nothing."""
        with suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(_CLOSE_S):
                # A close frame has room for 123 octets of reason (RFC 6455 section 5.5).
                await self.ws.close(code=code, message=words.encode()[:120])
