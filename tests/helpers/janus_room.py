"""Janus, the media server, with one video room, and a WHIP endpoint before its own interface.

Debian's Janus has no WHIP: the endpoint here turns a WHIP offer into a publisher of the room.
"""

import asyncio
import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import aiohttp
import common
from aiohttp import web
from programs import running

from kontur_av.clock import MonotonicClock
from kontur_av.codecs.h26x import H264Decoder
from pipelines.partner.media import PictureCame
from pipelines.partner.peer import RtcPeer
from pipelines.session.command_process import end_with_parent

ROOM = 15
CLOCK = MonotonicClock()
_ROOM_PLUGIN = "janus.plugin.videoroom"
_LIBRARIES = Path("/usr/lib")


def missing():
    """What is not installed, or ""."""
    return "" if shutil.which("janus") else "janus (Debian's package)"


def free_port():
    return common.free_port(socket.SOCK_STREAM)


class Janus(contextlib.ExitStack):
    """A server with its own configuration and ports."""

    def __init__(self, folder):
        super().__init__()
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}/janus"
        self._folder = folder
        self.process = None

    def __enter__(self):
        plugins = next(_LIBRARIES.glob("*/janus/plugins"))
        others = self._others(plugins, _ROOM_PLUGIN)
        transports = self._others(plugins.parent / "transports", "janus_http")
        self._write(
            "janus.jcfg",
            f'general: {{ configs_folder = "{self._folder}" plugins_folder = "{plugins}" '
            f'transports_folder = "{plugins.parent}/transports" debug_level = 4 '
            f'events_folder = "{self._folder}" loggers_folder = "{self._folder}" }}\n'
            f"media: {{ ipv6 = false }}\n"
            f"nat: {{ full_trickle = false }}\n"
            f'plugins: {{ disable = "{others}" }}\ntransports: {{ disable = "{transports}" }}\n',
        )
        self._write(
            "janus.transport.http.jcfg",
            f'general: {{ base_path = "/janus" http = true port = {self.port} ip = "127.0.0.1" '
            f'json = "compact" https = false }}\nadmin: {{ admin_http = false }}\n',
        )
        self._write(
            "janus.plugin.videoroom.jcfg",
            f'room-{ROOM}: {{ description = "pictures" publishers = 1 bitrate = 0 '
            f'videocodec = "h264" audiocodec = "opus" fir_freq = 0 record = false }}\n',
        )
        self.process = self.enter_context(
            running(
                self._folder / "janus.log",
                *("janus", "-F", self._folder, "-o"),
                end=signal.SIGTERM,
                patience_s=10,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )
        )
        until_s = time.monotonic() + 20
        while not self._listens():
            assert self.process.poll() is None, (self._folder / "janus.log").read_text()[-2000:]
            assert time.monotonic() < until_s
            time.sleep(0.05)
        return self

    def _others(self, folder, wanted):
        names = sorted(path.name for path in folder.glob("*.so"))
        return ",".join(name for name in names if wanted.rpartition(".")[2] not in name)

    def _write(self, name, text):
        (self._folder / name).write_text(text)

    def _listens(self):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False


class Handle:
    """A handle of the room plugin, in a session of its own at Janus."""

    def __init__(self, http, url):
        self._http, self._url = http, url
        self._session = self._handle = None

    async def open(self):
        self._session = (await self._post("", janus="create"))["data"]["id"]
        found = await self._post(f"/{self._session}", janus="attach", plugin=_ROOM_PLUGIN)
        self._handle = found["data"]["id"]
        return self

    async def ask(self, jsep=None, **body):
        """The event that answers a request: (its data, its description or "")."""
        more = {} if jsep is None else {"jsep": jsep}
        place = f"/{self._session}/{self._handle}"
        await self._post(place, janus="message", body=body, **more)
        event = await self.wait_for("event")
        data = event["plugindata"]["data"]
        assert "error" not in data, data
        return data, event.get("jsep", {}).get("sdp", "")

    async def wait_for(self, kind):
        """The next event of a kind; others are dropped."""
        while True:
            async with self._http.get(f"{self._url}/{self._session}") as answer:
                event = await answer.json()
            if event["janus"] == kind:
                return event

    async def close(self):
        await self._post(f"/{self._session}", janus="destroy")

    async def _post(self, place, **message):
        message["transaction"] = os.urandom(6).hex()
        async with self._http.post(self._url + place, json=message) as answer:
            found = await answer.json()
        assert found["janus"] in ("success", "ack"), found
        return found


class WhipDoor:
    """POST /whip makes the room's publisher; DELETE of its address ends it. A context manager."""

    def __init__(self, http, url):
        self._http, self._janus = http, url
        self.offers = 0
        #: The publisher's number in the room, once it can be watched.
        self.feed = asyncio.get_running_loop().create_future()

    async def __aenter__(self):
        application = web.Application()
        application.router.add_route("*", "/whip", self._whip)
        application.router.add_delete("/session", self._end)
        self._runner = web.AppRunner(application, access_log=None)
        await self._runner.setup()
        port = free_port()
        await web.TCPSite(self._runner, "127.0.0.1", port).start()
        self.url = f"http://127.0.0.1:{port}/whip"
        return self

    async def __aexit__(self, *_):
        await self._runner.cleanup()

    async def _whip(self, request):
        if request.method != "POST":
            return web.Response(status=204)
        self.offers += 1
        self._handle = await Handle(self._http, self._janus).open()
        data, answer = await self._handle.ask(
            request="joinandconfigure",
            ptype="publisher",
            room=ROOM,
            jsep={"type": "offer", "sdp": await request.text()},
        )
        self._waiting = asyncio.create_task(self._publish(data["id"]))
        return web.Response(
            status=201,
            text=answer,
            content_type="application/sdp",
            headers={"Location": "/session"},
        )

    async def _publish(self, feed):
        # Before its pictures can come, nobody can watch it.
        await self._handle.wait_for("webrtcup")
        self.feed.set_result(feed)

    async def _end(self, _request):
        await self._handle.close()
        return web.Response()


class Viewer:
    """Watches the room. Its pictures are counted, and the first few are decoded."""

    DECODED = 5

    def __init__(self):
        self._room = self._running = None
        self.pictures = 0
        self.decoded = []
        self._decoder = H264Decoder(reordered=True)
        self._peer = RtcPeer(
            clock=CLOCK,
            sends={},
            receives=("video",),
            handle=self._handle_event,
            offers=False,
        )

    async def watch(self, http, url, feed):
        self._room = await Handle(http, url).open()
        _, offer = await self._room.ask(
            request="join", ptype="subscriber", room=ROOM, streams=[{"feed": feed}]
        )
        answer = await self._peer.answer(offer)
        await self._room.ask(request="start", jsep={"type": "answer", "sdp": answer})
        self._running = asyncio.create_task(self._peer.run())

    async def leave(self):
        await self._peer.close()
        if self._running is not None:
            await self._running
        if self._room is not None:
            await self._room.close()

    def _handle_event(self, event):
        if isinstance(event, PictureCame):
            self.pictures += 1
            if len(self.decoded) < self.DECODED:
                found = self._decoder.decode(event.unit.data, self.pictures)
                self.decoded += [(picture.width, picture.height) for picture in found]


class Audience:
    """One sender, `kontur-av publish`, and viewers of what Janus hands on. A context manager."""

    def __init__(self, folder, *options):
        self._folder = folder
        self._options = options
        self.report = folder / "publish.json"
        self.viewers = []

    async def __aenter__(self):
        self._stack = contextlib.AsyncExitStack()
        async with self._stack as stack:
            self.janus = stack.enter_context(Janus(self._folder))
            self._http = await stack.enter_async_context(aiohttp.ClientSession())
            self.admission = await stack.enter_async_context(WhipDoor(self._http, self.janus.url))
            words = ["-m", "pipelines.cli", "publish", "--whip", self.admission.url]
            words += ["--report", str(self.report), *self._options]
            self.sender = await asyncio.create_subprocess_exec(
                sys.executable, *words, stdout=subprocess.DEVNULL
            )
            stack.push_async_callback(self.end_sender)
            stack.push_async_callback(self._leave)
            self._feed = await asyncio.wait_for(asyncio.shield(self.admission.feed), 30)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_):
        await self._stack.aclose()

    async def add_viewers(self, count):
        """Each shows some pictures when this returns."""
        found = [Viewer() for _ in range(count)]
        self.viewers += found
        async with asyncio.timeout(60):
            await asyncio.gather(
                *(one.watch(self._http, self.janus.url, self._feed) for one in found)
            )
            while any(len(viewer.decoded) < Viewer.DECODED for viewer in found):
                await asyncio.sleep(0.05)

    async def end_sender(self):
        """It writes its report."""
        if self.sender.returncode is None:
            self.sender.send_signal(signal.SIGINT)
        await self.sender.wait()

    async def _leave(self):
        await asyncio.gather(*(viewer.leave() for viewer in self.viewers))
