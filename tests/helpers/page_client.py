"""A seat's page without a browser: its sockets, and what comes on them."""

import asyncio
import json
import struct
from contextlib import asynccontextmanager
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

import aiohttp

from kontur_av.codecs.h26x import H264Decoder

#: Protects against a hang; no test result depends on it.
TIMEOUT_S = 40.0


class Unit(NamedTuple):
    """An access unit as a page gets it."""

    stream: int
    key: bool
    replayed: bool
    sequence: int
    data: bytes


def unit_of(message):
    """The unit in a message of the server; None for any other."""
    if isinstance(message, str) or message[0] != 1:
        return None
    _, stream, flags, sequence = struct.unpack_from("<BBBxI", message)
    return Unit(stream, bool(flags & 1), bool(flags & 4), sequence, message[16:])


def hand(sequence, *, dead_man=True, x=0.0, y=0.0):
    return struct.pack("<BBHIffd", 0x82, dead_man, 0, sequence, x, y, -1.0)


class Page:
    """The socket of a seat."""

    def __init__(self, ws):
        self.ws = ws
        self.hello = None

    async def next(self):
        """The next message, text or octets; None when the server has closed."""
        message = await self.ws.receive(timeout=TIMEOUT_S)
        if message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY):
            return message.data
        return None

    async def text(self, kind, **fields):
        """The next text of this kind with these fields."""
        while (message := await self.next()) is not None:
            if isinstance(message, str):
                text = json.loads(message)
                if text["kind"] == kind and fields.items() <= text.items():
                    return text
        raise AssertionError(f"closed with {self.ws.close_code} before {kind}")

    async def ask(self, do, **fields):
        await self.ws.send_str(json.dumps({"request": 1, "do": do} | fields))
        return await self.text("answer", request=1)

    async def units(self, stream, until):
        """Units of a stream up to the first for which `until` is true."""
        found = []
        while (message := await self.next()) is not None:
            unit = unit_of(message)
            if unit is not None and unit.stream == stream:
                found.append(unit)
                if until(unit):
                    return found
        raise AssertionError(f"closed with {self.ws.close_code} before the unit")

    async def close_code(self):
        """Read on until the server closes; return its code."""
        while await self.next() is not None:
            pass
        return self.ws.close_code


class Visitor:
    """A client that knows a seat's address. url: as it was printed, or with the viewer's token."""

    def __init__(self, client, url):
        where = urlsplit(url)
        (self.token,) = parse_qs(where.query)["token"]
        self.origin = f"{where.scheme}://{where.netloc}"
        self.url = url
        self.client = client

    async def get(self, path, **headers):
        """Status and text of what lies at a path, as it is."""
        from yarl import URL

        url = URL(self.origin + path, encoded=True)
        async with self.client.get(url, headers=headers, allow_redirects=False) as answer:
            return answer.status, await answer.text()

    @asynccontextmanager
    async def page(self, path="ws", **options):
        options.setdefault("origin", self.origin)
        url = f"{self.origin}/{self.token}/{path}"
        async with self.client.ws_connect(url, max_msg_size=0, **options) as ws:
            page = Page(ws)
            if path == "ws":
                page.hello = await page.text("hello")
            yield page


@asynccontextmanager
async def visiting(url, *, tls=True):
    """A visitor of an address. tls: of HTTPS; an aiohttp.Fingerprint for a known one."""
    connector = aiohttp.TCPConnector(ssl=tls)
    async with aiohttp.ClientSession(connector=connector) as client, asyncio.timeout(2 * TIMEOUT_S):
        yield Visitor(client, url)


def decoded(units):
    """By sequence: the picture after each unit."""
    decoder, found = H264Decoder(), {}
    for number, unit in enumerate(units):
        for picture in decoder.decode(unit.data, number):
            found[unit.sequence] = picture.to_i420()
    return found
