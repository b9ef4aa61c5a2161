"""The peer of the bench: the same access units over WebRTC by aiortc, into a <video>.

aiortc sends the units as they are. The page asks for no playout delay.
"""

import asyncio
import json
import signal
from fractions import Fraction
from socket import socket
from typing import Any

import av
from aiohttp import web
from aiortc import MediaStreamTrack, RTCConfiguration, RTCPeerConnection, RTCSessionDescription

from benchmarks.page.footage import FPS
from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.media import VIDEO_CLOCK_HZ

_PAGE = """<!doctype html><meta charset="utf-8"><title>peer</title>
<style>html, body { margin: 0; background: #222 } video { width: 640px; height: 480px }</style>
<video id="picture" muted autoplay playsinline></video>
<script type="module">
const peer = new RTCPeerConnection();
const video = document.getElementById("picture");
const receiver = peer.addTransceiver("video", { direction: "recvonly" });
const known = RTCRtpReceiver.getCapabilities("video").codecs;
receiver.setCodecPreferences(known.filter((codec) => codec.mimeType === "video/H264"));
peer.ontrack = (event) => {
  event.receiver.playoutDelayHint = 0;
  event.receiver.jitterBufferTarget = 0;
  video.srcObject = new MediaStream([event.track]);
};
await peer.setLocalDescription(await peer.createOffer());
const body = JSON.stringify(peer.localDescription);
const answer = await fetch("offer", { method: "POST", body });
await peer.setRemoteDescription(await answer.json());
</script>
"""


class _CodedTrack(MediaStreamTrack):
    """A track of access units that were coded before, at their rate."""

    kind = "video"

    def __init__(self, units: list[tuple[bytes, bool]], published: Any) -> None:
        super().__init__()
        self._units, self._published = units, published
        self._clock = MonotonicClock()
        self._number = 0
        self._begin_ns = self._clock.now_ns()

    async def recv(self) -> Any:
        """Return the next unit when it is due."""
        number = self._number
        self._number += 1
        if number >= len(self._units):
            self.stop()
            raise asyncio.CancelledError
        due_ns = self._begin_ns + number * NS_PER_S // FPS
        await asyncio.sleep(max(0, due_ns - self._clock.now_ns()) / NS_PER_S)
        packet = av.Packet(self._units[number][0])
        packet.time_base = Fraction(1, VIDEO_CLOCK_HZ)
        packet.pts = number * VIDEO_CLOCK_HZ // FPS
        self._published[number] = self._clock.now_ns()
        return packet


def serve_webrtc(listener: socket, units: list[tuple[bytes, bool]], published: Any) -> None:
    """Serve the page, and the units to who opens it. For a process of its own, until SIGTERM."""
    asyncio.run(_serve(listener, units, published))


async def _serve(listener: socket, units: list[tuple[bytes, bool]], published: Any) -> None:
    peers: set[RTCPeerConnection] = set()

    async def page(_request: web.Request) -> web.Response:
        return web.Response(text=_PAGE, content_type="text/html")

    async def offer(request: web.Request) -> web.Response:
        wanted = RTCSessionDescription(**json.loads(await request.text()))
        peer = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        peers.add(peer)
        await peer.setRemoteDescription(wanted)
        peer.addTrack(_CodedTrack(units, published))
        await peer.setLocalDescription(await peer.createAnswer())
        local = peer.localDescription
        return web.json_response({"sdp": local.sdp, "type": local.type})

    application = web.Application()
    application.add_routes([web.get("/", page), web.post("/offer", offer)])
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    await web.SockSite(runner, listener).start()
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    await stop.wait()
    for peer in peers:
        await peer.close()
    await runner.cleanup()
