"""Between the bench's pipes and two pages in Chromium, one that sends and one that receives.

python -m benchmarks.video.bridge OPTIONS      until SIGTERM; OPTIONS: `BridgeOptions` as JSON

Each page has a WebSocket. Pictures go to the sending page as I420 and become `VideoFrame`s; the
receiving page gives back each decoded picture at once. Descriptions of both are exchanged without
their own candidates: the only way from one to the other is the bench's channel.
"""

import asyncio
import json
import os
import re
import select
import signal
import struct
import sys
import threading
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import av
import numpy as np
from aiohttp import WSMsgType, web
from av.video.reformatter import VideoReformatter

from kontur_av.sources.y4m import Y4mPicture, Y4mReader

_PAGES = Path(__file__).with_name("pages")
_SIZE = struct.Struct("<II")
_MOST_OCTETS = 1 << 24
_CANDIDATE = re.compile(r"a=(candidate|end-of-candidates).*\r\n")
_CODEC = re.compile(r"(a=fmtp:[^\r]*profile[^\r]*)")


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeOptions:
    """film, screen: FIFOs as in `Course`. entrance, exit: ports of the channel. ready: written with
    the port of the pages, and again with the word "connected". shrink: width and height of the
    pictures over those of the coded ones.
    """

    film: str
    screen: str
    entrance: int
    exit: int
    codec: str
    cap_kbps: float
    width: int
    height: int
    fps: int
    shrink: float
    ready: str

    def words(self) -> str:
        """As `bridge` takes them."""
        return json.dumps(asdict(self))


def through_the_channel(sdp: str, cap_kbps: float) -> str:
    """The description without candidates, and with the rate for its video.

    The rate is the largest one (RFC 4566, b=AS) and Chromium's least one: its estimate falls at the
    first queue, and takes seconds to grow again.
    """
    kbps = round(cap_kbps)
    bare = _CODEC.sub(rf"\1;x-google-min-bitrate={kbps}", _CANDIDATE.sub("", sdp))
    return re.sub(r"(m=video [^\r]*\r\nc=[^\r]*\r\n)", rf"\1b=AS:{kbps}\r\n", bare)


class _Bridge:
    def __init__(self, options: BridgeOptions) -> None:
        self._options = options
        self._sockets: dict[str, web.WebSocketResponse] = {}
        self._loop = asyncio.get_running_loop()
        self._filming = False
        self._out = os.open(options.screen, os.O_WRONLY)
        self._header_written = False
        self._scaler = VideoReformatter()
        # Open it before the camera: that waits for a reader.
        self._in = os.open(options.film, os.O_RDONLY | os.O_NONBLOCK)

    async def page(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in ("send", "receive"):
            raise web.HTTPNotFound
        text = (_PAGES / f"{name}.html").read_text()
        return web.Response(text=text, content_type="text/html")

    async def socket(self, request: web.Request) -> web.WebSocketResponse:
        name = request.match_info["name"]
        socket = web.WebSocketResponse(max_msg_size=_MOST_OCTETS, compress=False)
        await socket.prepare(request)
        self._sockets[name] = socket
        if len(self._sockets) == 2:
            for each, port in (("send", self._options.entrance), ("receive", self._options.exit)):
                told = {"codec": self._options.codec, "cap": 1000 * self._options.cap_kbps}
                told |= {"port": port, "fps": self._options.fps, "shrink": self._options.shrink}
                await self._sockets[each].send_json({"begin": told})
        async for message in socket:
            if message.type == WSMsgType.TEXT:
                await self._told(name, json.loads(message.data))
            elif message.type == WSMsgType.BINARY and self._filming:
                self._show(message.data)
        return socket

    async def _told(self, name: str, told: dict[str, str]) -> None:
        if "sdp" in told:
            other = "receive" if name == "send" else "send"
            sdp = through_the_channel(told["sdp"], self._options.cap_kbps)
            await self._sockets[other].send_json({"type": told["type"], "sdp": sdp})
        elif told.get("state") == "connected" and name == "send":
            Path(self._options.ready).write_text("connected")
            threading.Thread(target=self._film, daemon=True).start()
        elif "error" in told:
            print(f"page {name}: {told['error']}", flush=True)

    async def _give(self, width: int, height: int, octets: bytes) -> None:
        await self._sockets["send"].send_bytes(_SIZE.pack(width, height) + octets)

    def _film(self) -> None:
        """Pass the camera's pictures on. In a thread, because a FIFO has no event."""
        reader, poller = Y4mReader(), select.poll()
        poller.register(self._in, select.POLLIN)
        while True:
            poller.poll()
            with suppress(BlockingIOError):
                reader.handle_written(os.readv(self._in, [reader.write_view()]))
            while (event := reader.next_event()) is not None:
                if isinstance(event, Y4mPicture):
                    self._filming = True
                    header = event.header
                    given = self._give(header.width, header.height, bytes(event.octets))
                    asyncio.run_coroutine_threadsafe(given, self._loop)

    def _show(self, message: bytes) -> None:
        """Write a decoded picture to the screen, in the size of the clip."""
        width, height = _SIZE.unpack_from(message)
        shape = height * 3 // 2, width
        if len(message) != _SIZE.size + shape[0] * shape[1]:
            return
        picture = np.frombuffer(message, np.uint8, offset=_SIZE.size).reshape(shape)
        frame = av.VideoFrame.from_ndarray(picture, "yuv420p")
        large = self._scaler.reformat(
            frame, self._options.width, self._options.height, interpolation="LANCZOS", threads=1
        )
        octets = b"FRAME\n" + large.to_ndarray().tobytes()
        if not self._header_written:
            size = self._options.width, self._options.height, self._options.fps
            octets = b"YUV4MPEG2 W%d H%d F%d:1 Ip A1:1 C420jpeg\n" % size + octets
            self._header_written = True
        rest = memoryview(octets)
        while rest:
            rest = rest[os.write(self._out, rest) :]


async def _run(options: BridgeOptions) -> None:
    bridge = _Bridge(options)
    application = web.Application()
    application.add_routes(
        [web.get("/{name}", bridge.page), web.get("/{name}/socket", bridge.socket)]
    )
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    port = runner.addresses[0][1]
    Path(options.ready).write_text(str(port))
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await stop.wait()
    # The thread that films ends with the process, whatever the pages do.
    os._exit(0)


if __name__ == "__main__":
    asyncio.run(_run(BridgeOptions(**json.loads(sys.argv[1]))))
