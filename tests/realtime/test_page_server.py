"""The server of a session's pages, as browsers and unknown senders meet it."""

import asyncio
import re
import socket
from urllib.parse import urlsplit

import aiohttp
import numpy as np
import pytest
from common import psnr_db
from mcap.reader import make_reader
from page_client import decoded, unit_of, visiting
from running_session import RunningSession, eventually

SETUP = "spacejustin"


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    with RunningSession(SETUP, "--page", "8310", directory=tmp_path_factory.mktemp("pages")) as one:
        one.wait_for_flow()
        yield one
        report = one.finish(clean=True, sound=True)
        assert report["processes"]["page_space"]["restarts"] == 0


def connects(url):
    """Whether something listens where the address says."""
    where = urlsplit(url)
    with socket.socket() as tcp:
        return tcp.connect_ex((where.hostname, where.port)) == 0


def stream_of(page, via):
    return next(each["index"] for each in page.hello["streams"] if each["via"] == via)


# First the one with a session of its own: from the next one on, the module's session runs.


async def test_over_tls_pages_get_streams_of_hevc_as_h264(tmp_path):
    setup = (
        'cameras = ["static"]\n[uplink_video]\ncap_kbps = 85\nsize = "320x240"\ncodec = "h265"\n'
        '[downlink_video]\ncap_kbps = 200\nsize = "320x240"\ncodec = "h265"\n'
    )
    with RunningSession(setup, "--page", "0.0.0.0:8320", directory=tmp_path) as one:
        one.wait_for_flow()
        pages = one.pages()
        out = (tmp_path / "out.txt").read_text()
        assert pages["pages"] in out and f"token={pages['viewer_token']}" in out
        printed = re.search("(?:[0-9A-F]{2}:){31}[0-9A-F]{2}", out)
        tls = aiohttp.Fingerprint(bytes.fromhex(printed[0].replace(":", "")))
        assert pages["space"].startswith("https://")
        with pytest.raises(aiohttp.ClientConnectorCertificateError):
            async with visiting(pages["space"]) as visitor:
                await visitor.get("/")
        for seat in ("ground", "space"):
            async with visiting(pages[seat], tls=tls) as visitor, visitor.page() as page:
                ways = {each["via"] for each in page.hello["streams"]}
                begun = {stream_of(page, via): [] for via in ways}
                while any(sum(not one.replayed for one in units) < 32 for units in begun.values()):
                    unit = unit_of(await page.next())
                    if unit is not None and unit.stream in begun:
                        begun[unit.stream].append(unit)
            for units in begun.values():
                assert units[0].key
                assert units[-1].sequence in decoded(units)
        report = one.finish(clean=True)
        assert not connects(pages["space"])
        assert report["processes"]["page_space"]["restarts"] == 0


HANDSHAKES = (
    {"Sec-WebSocket-Version": "99", "Sec-WebSocket-Key": "A" * 22 + "=="},
    {"Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "bad"},
    {"Sec-WebSocket-Version": "13"},
)


async def test_strangers_and_bad_handshakes_are_refused(session):
    async with visiting(session.pages()["space"]) as visitor:
        token = visitor.token
        status, html = await visitor.get(f"/space?token={token}")
        assert status == 200 and f'href="/{token}/static/"' in html
        assert (await visitor.get(f"/{token}/static/seat_worker.js"))[0] == 200
        for path in ("/space", "/space?token=x", "/", "/x/static/space.js", "/x/ws"):
            status, text = await visitor.get(path)
            assert (status, text.count("\n")) == (403, 1), path
        for path in ("../server.py", "..%2fserver.py", "%2e%2e/server.py", "nothing.js"):
            status, _ = await visitor.get(f"/{token}/static/{path}")
            assert status in (403, 404), path
        assert (await visitor.get(f"/space?token={token}", Host="evil.example:8310"))[0] == 403
        for origin in ("http://evil.example", "null"):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with visitor.page(origin=origin):
                    pass
            assert refused.value.status == 403
        asks = {"Origin": visitor.origin, "Upgrade": "websocket", "Connection": "Upgrade"}
        async with visitor.page() as good:
            for path in ("ws", "media"):
                for headers in (*({**asks, **one} for one in HANDSHAKES), {"Origin": "x"}):
                    status, _ = await visitor.get(f"/{visitor.token}/{path}", **headers)
                    assert status in (400, 403), headers
            await good.text("state")


def garbage(rng):
    """Yield what no page sends, in bytes or text."""
    yield from (b"", "", b"\x00", b"\xff" * 24, "{}", "[]", "null", "{" * 4000, "\u20ac" * 1000)
    yield '{"request":1,"do":"format"}'
    yield '{"request":1,"do":"hand","action":' + "[" * 2000
    for kind in range(0x80, 0x86):
        for length in (1, 15, 17, 23, 24, 25, 4000):
            yield bytes([kind]) + rng.bytes(length - 1)
    yield b"\x81" + b"\x00" * 7 + b"\xff" * 8
    yield bytes(10_000)
    yield "x" * 10_000
    yield b"\x82\x01" + b"\x00" * 6 + b"\x00\x00\xc0\x7f" * 2 + b"\x00" * 8


@pytest.mark.parametrize("seat", ["space", "ground"])
async def test_garbage_closes_the_socket_that_sent_it_only(session, seat):
    async with visiting(session.pages()[seat]) as visitor, visitor.page() as good:
        for path in ("ws", "media"):
            for message in garbage(np.random.default_rng(3)):
                async with visitor.page(path) as bad:
                    send = bad.ws.send_str if isinstance(message, str) else bad.ws.send_bytes
                    await send(message)
                    # Policy violation, or a message that is too big.
                    assert await bad.close_code() in {1008, 1009}, message
        for _ in range(3):
            await good.text("state")


async def test_who_joins_in_the_middle_has_the_same_picture(session):
    async with visiting(session.pages()["space"]) as visitor:
        async with visitor.page() as first:
            stream = stream_of(first, "coded")
            seen = await first.units(stream, lambda unit: not unit.replayed)
            seen += await first.units(stream, lambda unit: unit.sequence >= seen[-1].sequence + 60)
            async with visitor.page() as late:
                joined = await late.units(stream, lambda unit: not unit.replayed)
                assert joined[0].key and joined[0].replayed
                last = joined[-1].sequence + 30
                joined += await late.units(stream, lambda unit: unit.sequence >= last)
            seen += await first.units(stream, lambda unit: unit.sequence >= last)
        one, other = decoded(seen), decoded(joined)
        # One that was stalled is sent a replay.
        both = {*range(last - 30, last + 1)} & one.keys() & other.keys()
        assert both
        # The first one has the stream itself, the late one a key picture of the receiver.
        for sequence in both:
            assert psnr_db(one[sequence], other[sequence]) > 38


async def test_ground_control_records_and_a_viewer_does_not(session):
    def recorded():
        found = session.directory.glob(f"{session.session}-*.mcap")
        return any(path.stat().st_size > 50_000 for path in found)

    async def told(page, wanted):
        while wanted((await page.text("figures"))["figures"].get("recorder.file")) is None:
            pass

    pages = session.pages()
    async with visiting(pages["ground"]) as visitor, visitor.page() as page:
        assert (await page.ask("record", action="start"))["ok"]
        await told(page, lambda file: file)
        again = await page.ask("record", action="start")
        assert not again["ok"] and ".mcap" in again["error"]
        await asyncio.to_thread(eventually, recorded, "some of the session in the file")
        assert (await page.ask("record", action="stop"))["ok"]
        await told(page, lambda file: True if file is None else None)
        assert "not being recorded" in (await page.ask("record", action="stop"))["error"]
    (path,) = session.directory.glob(f"{session.session}-*.mcap")
    with path.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count > 0
    ground, viewer = pages["ground"].partition("token=")[0], pages["viewer_token"]
    async with visiting(f"{ground}token={viewer}") as visitor, visitor.page() as page:
        assert "watch only" in (await page.ask("record", action="start"))["error"]
