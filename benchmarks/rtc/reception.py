"""How soon a partner's pictures and voice are decoded: our reception beside plain aiortc.

A process of its own sends the same coded units and packets to both, by WHEP over loopback. The
voice is silent but for clicks, whose arrival is heard.
"""

import asyncio
import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from aiortc import RTCPeerConnection, RTCSessionDescription
from aiortc.mediastreams import MediaStreamError
from numpy.typing import NDArray

from benchmarks.page.alone import forked
from benchmarks.page.footage import FPS, HEIGHT, WIDTH
from benchmarks.page.views import numbers
from benchmarks.rtc.rtc_metrics import OURS, ReceptionRun
from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.media import BLOCK_NS, BLOCK_SAMPLES, AccessUnit, CaptureStamp, empty_picture
from kontur_av.streams.voice_receiver import VoicePlayer
from pipelines.bench.course.marks import MARK_ROWS, levels, read_number
from pipelines.partner.description import Kind
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.partner.peer import Programme, RtcPeer
from pipelines.partner.server import RtcServer
from pipelines.partner.whip import WhipClient
from pipelines.report.result import spread
from pipelines.session.page_sockets import PageListener

_TOKEN = "bench"
_RATES: dict[Kind, int] = {"video": 1_500_000, "audio": 32_000}
#: A click each half second; all else is silence.
_CLICK_BLOCKS = 25
_LOUD, _QUIET_NS = 1000.0, 200 * NS_PER_MS
_CONNECT_S = 20.0
#: For the connection, and for the first estimate of jitter.
_SETTLE_S = 3.0


def reception_run(who: str, units: Sequence[tuple[bytes, bool]], seconds: float) -> ReceptionRun:
    """Receive for `seconds`. who: OURS or PEER. RuntimeError if nothing comes."""
    sent, clicked = numbers(), numbers()
    seen: dict[int, int] = {}
    heard: list[int] = []
    with socket.create_server(("127.0.0.1", 0)) as bound:
        url = f"http://127.0.0.1:{bound.getsockname()[1]}/whep/main"
        with forked(_serve, bound, units, sent, clicked):
            receive = _ours if who == OURS else _plain
            asyncio.run(receive(url, seen, heard, seconds + _SETTLE_S))
    if not seen or not heard:
        raise RuntimeError(f"{who}: nothing was received")
    from_ns = min(seen.values()) + round(_SETTLE_S * NS_PER_S)
    pictures = [(at - sent[one]) / NS_PER_MS for one, at in seen.items() if at > from_ns]
    clicks = [at_ns for at_ns in clicked if at_ns]
    voices = [
        (at - max(click for click in clicks if click <= at)) / NS_PER_MS
        for at in heard
        if at > from_ns and clicks[0] <= at
    ]
    return ReceptionRun(
        who=who,
        picture_ms=spread(pictures),
        voice_ms=spread(voices),
        pictures=len(pictures),
        clicks=len(voices),
    )


class _Ear:
    """Notes when a click begins."""

    def __init__(self, heard: list[int]) -> None:
        self._heard, self._loud_ns = heard, 0

    def hear(self, samples: NDArray[np.int16], now_ns: int) -> None:
        """Samples that are played at `now_ns`."""
        if float(np.sqrt(np.mean(np.square(samples, dtype=np.float64)))) < _LOUD:
            return
        if now_ns - self._loud_ns > _QUIET_NS:
            self._heard.append(now_ns)
        self._loud_ns = now_ns


async def _ours(url: str, seen: dict[int, int], heard: list[int], seconds: float) -> None:
    clock, decoder, player, ear = MonotonicClock(), H264Decoder(), VoicePlayer(), _Ear(heard)
    kept = empty_picture(WIDTH, HEIGHT)

    def take(event: PictureCame | SoundCame) -> None:
        if isinstance(event, SoundCame):
            ear.hear(player.play(event.block)[0], clock.now_ns())
            return
        for picture in decoder.decode(event.unit.data, event.unit.timestamp):
            now_ns = clock.now_ns()
            picture.copy_to(kept)
            _note(kept, now_ns, seen)

    peer = RtcPeer(clock=clock, sends={}, receives=("audio", "video"), handle=take)
    async with WhipClient(url, token=_TOKEN) as client:
        await peer.accept(await client.post(await peer.offer()))
        running = asyncio.create_task(peer.run())
        await asyncio.wait([running], timeout=seconds)
        await peer.close()
        await running


async def _plain(url: str, seen: dict[int, int], heard: list[int], seconds: float) -> None:
    clock, ear = MonotonicClock(), _Ear(heard)
    peer = RTCPeerConnection()
    reading: list[asyncio.Task[None]] = []

    async def look(track: Any) -> None:
        with suppress(MediaStreamError):
            while True:
                frame = await track.recv()
                now_ns = clock.now_ns()
                if track.kind == "video":
                    _note(frame.to_ndarray(format="yuv420p"), now_ns, seen)
                else:
                    ear.hear(frame.to_ndarray()[0], now_ns)

    peer.on("track", lambda track: reading.append(asyncio.ensure_future(look(track))))
    peer.addTransceiver("audio", direction="recvonly")
    peer.addTransceiver("video", direction="recvonly")
    async with WhipClient(url, token=_TOKEN) as client:
        await peer.setLocalDescription(await peer.createOffer())
        answer = await client.post(peer.localDescription.sdp)
        await peer.setRemoteDescription(RTCSessionDescription(answer, "answer"))
        await asyncio.sleep(seconds)
        await peer.close()
    await asyncio.gather(*reading)


def _note(picture: NDArray[np.uint8], now_ns: int, seen: dict[int, int]) -> None:
    number = read_number(levels(picture[:MARK_ROWS]))
    if number is not None:
        seen.setdefault(number, now_ns)


def _serve(
    bound: socket.socket, units: Sequence[tuple[bytes, bool]], sent: Any, clicked: Any
) -> None:
    with suppress(KeyboardInterrupt):
        asyncio.run(_send(bound, units, sent, clicked))


async def _send(
    bound: socket.socket, units: Sequence[tuple[bytes, bool]], sent: Any, clicked: Any
) -> None:
    clock = MonotonicClock()
    bound.setblocking(False)
    listener = PageListener(
        socket=bound,
        scheme="http",
        host="127.0.0.1",
        port=bound.getsockname()[1],
        names=("127.0.0.1",),
        operator_token=_TOKEN,
        viewer_token="none",
    )
    programme = Programme("main", sends=_RATES, want_key=lambda _: None)
    server = RtcServer(listener, [programme], clock=clock, handle=None)
    await server.start()
    async with asyncio.timeout(_CONNECT_S):
        while not any(peer.connected for peer in programme.peers):
            await asyncio.sleep(0.01)
    await asyncio.gather(
        _send_pictures(programme, clock, units, sent), _send_voice(programme, clock, clicked)
    )


async def _send_pictures(
    programme: Programme, clock: MonotonicClock, units: Sequence[tuple[bytes, bool]], sent: Any
) -> None:
    begin_ns = clock.now_ns()
    for number, (data, key) in enumerate(units):
        await _sleep_until(clock, begin_ns + number * NS_PER_S // FPS)
        sent[number] = now_ns = clock.now_ns()
        programme.send_unit(AccessUnit(data, CaptureStamp(now_ns, number, "bench"), key))


async def _send_voice(programme: Programme, clock: MonotonicClock, clicked: Any) -> None:
    encoder, begin_ns, number = OpusEncoder(bitrate_bps=_RATES["audio"]), clock.now_ns(), 0
    tone = np.sin(np.arange(BLOCK_SAMPLES) * 2 * np.pi / 48) * 12_000
    blocks = [np.zeros(BLOCK_SAMPLES, np.int16), tone.astype(np.int16)]
    while True:
        click = number % _CLICK_BLOCKS == _CLICK_BLOCKS - 1
        opus = encoder.encode(blocks[click])
        await _sleep_until(clock, begin_ns + number * BLOCK_NS)
        now_ns = clock.now_ns()
        if click:
            clicked[number // _CLICK_BLOCKS] = now_ns
        programme.send_opus(opus, CaptureStamp(now_ns, number, "bench"))
        number += 1


async def _sleep_until(clock: MonotonicClock, due_ns: int) -> None:
    await asyncio.sleep(max(0, due_ns - clock.now_ns()) / NS_PER_S)
