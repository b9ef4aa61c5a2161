"""A reader of a seat that draws nothing: what a page on another machine costs this one."""

import asyncio
import struct
from urllib.parse import parse_qs, urlsplit

import aiohttp

_PING = struct.Struct("<B7xd")
_PING_KIND = 0x81
_PING_S = 1.0


def watch_seat(url: str) -> None:
    """Read all that the seat at `url` sends, until the process is ended. For one of its own."""
    asyncio.run(_watch(url))


async def _watch(url: str) -> None:
    parts = urlsplit(url)
    (token,) = parse_qs(parts.query)["token"]
    origin = f"{parts.scheme}://{parts.netloc}"
    async with (
        aiohttp.ClientSession() as client,
        client.ws_connect(f"{origin}/{token}/ws", origin=origin, max_msg_size=0) as socket,
    ):
        pings = asyncio.create_task(_ping(socket))
        async for _ in socket:
            pass
        pings.cancel()


async def _ping(socket: aiohttp.ClientWebSocketResponse) -> None:
    while True:
        await socket.send_bytes(_PING.pack(_PING_KIND, 0.0))
        await asyncio.sleep(_PING_S)
