"""A site serves those who have a token; a web socket is written as fast as its page reads."""

import asyncio
import socket
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from aiohttp import web

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.seats.seat_sockets import SeatSockets
from pipelines.session.access import MOST_WATCHING, AccessError
from pipelines.session.page_sockets import PageListener
from pipelines.session.web_site import WebSite

TIMEOUT_S = 90
GARBAGE = b"garbage"


@asynccontextmanager
async def served(words):
    """A site of files: its port, and the site."""
    bound = socket.create_server(("127.0.0.1", 0))
    port = bound.getsockname()[1]
    tokens = {"operator_token": "operator", "viewer_token": "viewer"}
    listener = PageListener(socket=bound, scheme="http", host="127.0.0.1", port=port, **tokens)
    site = WebSite(listener, seat="space", others=["panel"])

    async def handle(request, found):
        return site.file(request, found, words)

    async def close():
        pass

    async with asyncio.timeout(TIMEOUT_S), site.served("test", handle, close):
        yield f"http://127.0.0.1:{port}", site


def asked(*paths, words):
    """Status, header fields and text of each answer, and what was counted."""

    async def run():
        found = []
        async with served(words) as (base, site), aiohttp.ClientSession() as client:
            for path in paths:
                async with client.get(base + path) as answer:
                    found.append((answer.status, dict(answer.headers), await answer.text()))
        return found, site.refused

    return asyncio.run(run())


@pytest.mark.parametrize("path", ["", "/space?token=viewer"])
async def test_neither_strangers_nor_viewers_take_all_connections(path):
    """They stay open, with a request or without one."""

    def descriptors():
        return len([*Path("/proc/self/fd").iterdir()])

    async with served({}) as (base, _), AsyncExitStack() as stack:
        before, opened = descriptors(), 400
        for _ in range(opened):
            port = int(base.rpartition(":")[2])
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            stack.callback(writer.close)
            if path:
                writer.write(f"GET {path} HTTP/1.1\r\nHost: {base[7:]}\r\n\r\n".encode())
                await reader.readexactly(15)
        # Both ends of each are here.
        while descriptors() > before + opened + MOST_WATCHING:
            await asyncio.sleep(0.01)
        async with aiohttp.request("GET", f"{base}/space?token=operator") as answer:
            assert answer.status == 200


def test_a_page_names_its_files_by_its_own_token_and_strangers_are_counted():
    # Who is refused: test_page_server.py.
    paths = ("/space?token=viewer", "/viewer/static/space.css", "/space?token=x", "/viewer/ws2")
    found, refused = asked(*paths, words={"<body": "<B"})
    assert [status for status, _, _ in found] == [200, 200, 403, 404]
    assert refused == {"token": 1}
    (_, fields, page), (_, css_fields, _), *_ = found
    for part in ('<base href="/viewer/static/" />', "<B", '<dialog id="keys"'):
        assert part in page
    assert page.startswith("<!doctype html>")
    assert "__BASE__" not in page and "#include" not in page
    assert fields["Content-Type"] == "text/html; charset=utf-8"
    assert css_fields["Content-Type"] == "text/css; charset=utf-8"
    assert "default-src 'none'" in fields["Content-Security-Policy"]


class Server:
    """Serves one kind of socket, which is sent the same message again and again."""

    def __init__(self, message):
        self.message = message
        self.now_ns = 0
        self.taken = []
        self.sent = 0
        self.sockets = SeatSockets(lambda: self.now_ns)

    async def next_message(self):
        if self.message is None:
            await asyncio.Event().wait()
        self.sent += 1
        return self.message

    def take(self, message):
        if message == GARBAGE:
            raise ProtocolError("no sense in it")
        self.taken.append(message)

    async def handle(self, request):
        try:
            page = await self.sockets.open(request, 1000)
        except AccessError as refusal:
            return web.Response(status=refusal.status, text=str(refusal))
        await self.sockets.serve(page, self.take, self.next_message)
        return page.ws


@asynccontextmanager
async def serving(message=None):
    server = Server(message)
    runner = web.ServerRunner(web.Server(server.handle), shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    try:
        async with aiohttp.ClientSession() as client, asyncio.timeout(TIMEOUT_S):
            yield server, client, f"http://127.0.0.1:{runner.addresses[0][1]}/"
    finally:
        await runner.cleanup()


async def until(condition):
    while not condition():
        await asyncio.sleep(0.01)


@pytest.mark.rule("10")
async def test_texts_and_octets_are_taken_and_garbage_closes_the_socket():
    async with serving() as (server, client, url), client.ws_connect(url) as ws:
        # No handshake.
        async with client.get(url) as answer:
            assert answer.status == 400
        await ws.send_str("a text")
        await ws.send_bytes(b"octets")
        await ws.send_bytes(GARBAGE)
        closed = await ws.receive()
        assert (closed.type, closed.data) == (aiohttp.WSMsgType.CLOSE, 1008)
        assert closed.extra == "no sense in it"
        assert server.taken == ["a text", b"octets"]
        sockets = server.sockets
        assert (sockets.connections, sockets.garbage, sockets.closed) == (1, 1, 1)


async def test_a_page_that_reads_nothing_is_sent_no_more_and_closed_after_30_s():
    async with serving(b"x" * 50_000) as (server, client, url):
        ws = await client.ws_connect(url, max_msg_size=0)
        ws._response.connection.transport.pause_reading()
        sent = -1
        while sent != server.sent:
            sent = server.sent
            await asyncio.sleep(0.3)
        # Not more than the buffers of two kernels' sockets.
        assert sent * 50_000 < 10_000_000
        server.now_ns = 30 * NS_PER_S
        server.sockets.handle_time(server.now_ns)
        await asyncio.sleep(0.1)
        assert len(server.sockets) == 1
        server.now_ns += 1
        server.sockets.handle_time(server.now_ns)
        await until(lambda: len(server.sockets) == 0)


async def test_all_are_told_when_the_server_ends():
    async with serving() as (server, client, url), client.ws_connect(url) as ws:
        reading = asyncio.create_task(ws.receive())
        await until(lambda: len(server.sockets) == 1)
        await server.sockets.close()
        closed = await reading
        assert (closed.data, closed.extra) == (1001, "the server ends")
