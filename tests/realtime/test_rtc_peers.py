"""Partners over real sockets on this machine: WHIP and WHEP, restart of ICE, unknown senders."""

import asyncio
import contextlib
import socket

import aiohttp
import pytest
from partners import SENDS, kept, pictures, receiving, send, sending, sounds, until

from benchmarks.page.footage import coded
from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.rtp.annex_b import split_annex_b
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import Programme
from pipelines.partner.server import RtcServer
from pipelines.partner.whip import Keeper, WhipClient
from pipelines.session.page_sockets import PageListener

TOKEN = "word-of-the-partner"


@contextlib.asynccontextmanager
async def serving(handle=None):
    """A server with one programme; yields it, the programme and the base of its addresses."""
    clock = MonotonicClock()
    with socket.create_server(("127.0.0.1", 0)) as bound:
        bound.setblocking(False)
        port = bound.getsockname()[1]
        listener = PageListener(
            socket=bound,
            scheme="http",
            host="127.0.0.1",
            port=port,
            names=("127.0.0.1",),
            operator_token=TOKEN,
            viewer_token="other",
        )
        keys = []
        programme = Programme("main", sends=SENDS, want_key=keys.append)
        server = RtcServer(
            listener,
            [programme],
            clock=clock,
            handle=handle,
        )
        await server.start()
        try:
            yield server, programme, f"http://127.0.0.1:{port}"
        finally:
            await server.close()


def same_units(events, units):
    return [split_annex_b(unit.data) for unit in pictures(events)] == [
        split_annex_b(data) for data, _ in units
    ]


async def test_a_partner_watches_and_is_seen_with_the_same_octets():
    units = coded(50)
    watched, taken = [], []
    async with serving(taken.append) as (server, programme, base):
        async with (
            kept(f"{base}/whep/main", receiving(watched), TOKEN) as viewer,
            kept(f"{base}/whip", sending, TOKEN) as sender,
        ):
            await until(lambda: all(peer.connected for peer in server.peers))
            await send(units, programme.send_unit, programme.send_opus)
            await until(lambda: len(pictures(watched)) == 50)
            await send(units, sender.peer.send_unit, sender.peer.send_opus)
            await until(lambda: len(pictures(taken)) == 50)
            assert viewer.peer.route.local == "host"
        await until(lambda: not server.peers)
        assert server.made == 2
        assert server.garbage == 0
    for events in (watched, taken):
        assert same_units(events, units)
        assert sounds(events)


async def test_ice_begins_anew_in_the_middle_and_the_media_go_on():
    units = coded(40)
    watched = []
    async with (
        serving() as (server, programme, base),
        WhipClient(f"{base}/whep/main", token=TOKEN) as client,
    ):
        viewer = receiving(watched)(IceServers())
        await viewer.accept(await client.post(await viewer.offer()))
        running = asyncio.create_task(viewer.run())
        await until(lambda: viewer.connected and server.peers[0].connected)
        half = len(units) // 2
        await send(units[:half], programme.send_unit, programme.send_opus)
        port = viewer.route.remote_port
        local = await viewer.restart()
        await viewer.finish_restart(await client.restart(local))
        await until(lambda: server.peers[0].restarts == 1)
        assert viewer.route.remote_port != port
        await send(units[half:], programme.send_unit, programme.send_opus)
        await until(lambda: len(pictures(watched)) == 40)
        await viewer.close()
        await running
    assert same_units(watched, units)


#: Requests: status, method, path, body, type of content, and whether they have the token.
SDP = "application/sdp"
REFUSED = (
    (401, "POST", "/whep/main", b"v=0", SDP, False),
    (403, "GET", "/rtc", b"", SDP, False),
    (415, "POST", "/whep/main", b"v=0", "text/plain", True),
    (400, "POST", "/whep/main", b"nonsense", SDP, True),
    (400, "POST", "/whep/main", b"v=\xff", f"{SDP}; charset=klingon", True),
    (413, "POST", "/whep/main", b"v" * 100_000, SDP, True),
    (404, "POST", "/whep/other", b"v=0", SDP, True),
    (404, "POST", "/whip", b"v=0", SDP, True),  # nothing is taken here
    (404, "DELETE", "/session/none", b"", SDP, True),
)


async def test_strangers_and_nonsense_are_answered_and_the_partner_still_comes():
    units, watched = coded(20), []
    async with serving() as (server, programme, base):
        async with aiohttp.ClientSession() as session:

            async def status(method, path, body, **headers):
                async with session.request(
                    method, base + path, data=body, headers=headers
                ) as answer:
                    return answer.status

            for code, method, path, body, kind, known in REFUSED:
                headers = {"Authorization": f"Bearer {TOKEN}"} if known else {}
                found = await status(method, path, body, **{"Content-Type": kind}, **headers)
                assert found == code, (path, body[:10])
            asks = {"Access-Control-Request-Method": "POST", "Origin": "https://other"}
            assert await status("OPTIONS", "/whep/main", b"", **asks) == 204
        with pytest.raises(ConfigError, match="token"):
            await Keeper(
                f"{base}/whep/main",
                token="guess",
                make_peer=receiving([]),
                servers=IceServers,
                clock=MonotonicClock(),
            ).run()
        async with kept(f"{base}/whep/main", receiving(watched), TOKEN):
            await until(lambda: server.peers and server.peers[0].connected)
            await send(units, programme.send_unit, programme.send_opus)
            await until(lambda: len(pictures(watched)) == 20)
