"""The server of a session's pages, as browsers and strangers meet it."""

import asyncio
import contextlib
import os
import re
import signal
import socket
import struct
from urllib.parse import urlsplit

import aiohttp
import numpy as np
import pytest
from flat_pictures import PAGE, PICTURE_OCTETS, flat, newest_level, repeated
from mcap.reader import make_reader
from page_client import Visitor, decoded, hand, unit_of, visit
from running_part import CLOCK
from running_session import RunningSession, alive, assert_sound, eventually

from kontur_av.media import CaptureStamp, VideoFrame

SETUP = "spacejustin"
SELECT = {"application": "camera", "name": "select", "arguments": ["static"]}
#: Channels of which each second of a recording has messages.
ALWAYS = {"/uplink_video/received", "/downlink_video/sent", "/haptic/up/received"}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    with RunningSession(SETUP, "--page", "8310", directory=tmp_path_factory.mktemp("pages")) as one:
        one.wait_for_flow()
        yield one
        code, report = one.interrupt()
        one.assert_nothing_left()
        assert code == 0, one.errors()
        assert_sound(report)
        processes = report["processes"]
        assert processes["page_space"]["restarts"] == 0
        counts = processes["iss_camera"]["counts"]
        assert counts["from_page"] < counts["captured"]
        assert "from_page" in processes["camera_left"]["counts"]


def connects(url):
    """Whether something listens where the address says."""
    where = urlsplit(url)
    with socket.socket() as tcp:
        return tcp.connect_ex((where.hostname, where.port)) == 0


def stream_of(page, via):
    return next(each["index"] for each in page.hello["streams"] if each["via"] == via)


# First those with sessions of their own: from the next one on, the module's session runs.


def test_pages_get_streams_of_hevc_as_h264(tmp_path):
    path = tmp_path / "hevc.toml"
    path.write_text(
        'cameras = ["static"]\n[uplink_video]\ncap_kbps = 85\nsize = "320x240"\ncodec = "h265"\n'
        '[downlink_video]\ncap_kbps = 200\nsize = "320x240"\ncodec = "h265"\n'
    )

    async def deeds(visitor):
        async with visitor.page() as page:
            ways = {each["via"] for each in page.hello["streams"]}
            begun = {stream_of(page, via): [] for via in ways}
            while any(sum(not unit.replayed for unit in units) < 32 for units in begun.values()):
                unit = unit_of(await page.next())
                if unit is not None and unit.stream in begun:
                    begun[unit.stream].append(unit)
        for units in begun.values():
            assert units[0].key
            assert units[-1].sequence in decoded(units)

    with RunningSession(str(path), "--page", "8320", directory=tmp_path) as one:
        one.wait_for_flow()
        for seat in ("ground", "space"):
            visit(one.pages()[seat], deeds)
        # A seat that was restarted has no decoder that runs: it gets a key picture of each stream.
        killed = one.pids()["page_ground"]
        os.kill(killed, signal.SIGKILL)
        eventually(lambda: not alive(killed), "the end of the seat")
        visit(one.pages()["ground"], deeds)
        code, report = one.interrupt()
        one.assert_nothing_left()
        assert code == 0
        assert report["processes"]["page_space"]["restarts"] == 0


def test_over_tls_the_page_process_comes_back_with_a_picture_at_the_same_address(tmp_path):
    with RunningSession("taskboard", "--page", "0.0.0.0:8330", directory=tmp_path) as session:
        session.wait_for_flow()
        pages = session.pages()
        url = pages["space"]
        out = (tmp_path / "out.txt").read_text()
        assert pages["pages"] in out and f"token={pages['viewer_token']}" in out
        printed = re.search("(?:[0-9A-F]{2}:){31}[0-9A-F]{2}", out)
        tls = aiohttp.Fingerprint(bytes.fromhex(printed[0].replace(":", "")))
        assert url.startswith("https://")
        with pytest.raises(aiohttp.ClientConnectorCertificateError):
            visit(url, lambda visitor: visitor.get("/"))

        async def picture(visitor):
            async with visitor.page() as page:
                stream = stream_of(page, "coded")
                units = await page.units(stream, lambda unit: not unit.replayed)
                units += await page.units(stream, lambda unit: not unit.replayed)
                return units

        async def killed(visitor):
            async with visitor.page() as page:
                pid = session.pids()["page_space"]
                os.kill(pid, signal.SIGKILL)
                await page.close_code()

        assert decoded(visit(url, picture, tls=tls))
        visit(url, killed, tls=tls)

        def again():
            try:
                return visit(url, picture, tls=tls)
            except (aiohttp.ClientError, OSError):
                return None

        units = eventually(again, "the page process")
        assert units[0].key
        assert units[-1].sequence in decoded(units)
        session.wait_for_flow()
        assert connects(pages["space"]) and connects(pages["ground"])
        code, report = session.interrupt()
        assert not connects(pages["space"])
        session.assert_nothing_left()
    assert code == 0
    assert_sound(report)
    restarts = {name: entry["restarts"] for name, entry in report["processes"].items()}
    assert {name: count for name, count in restarts.items() if count} == {"page_space": 1}


def test_strangers_are_refused(session):
    url = session.pages()["space"]

    async def deeds(visitor):
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

    visit(url, deeds)


def test_idle_connections_keep_nobody_out(session):
    url = session.pages()["space"]
    idle = []
    try:
        idle.extend(socket.create_connection(("127.0.0.1", 8310)) for _ in range(700))

        async def deeds(visitor):
            async with visitor.page() as page:
                await page.text("state")
                assert (await visitor.get(f"/space?token={visitor.token}"))[0] == 200

        visit(url, deeds)
    finally:
        for one in idle:
            one.close()


HANDSHAKES = {
    "no upgrade": {},
    "another version": {"Sec-WebSocket-Version": "99", "Sec-WebSocket-Key": "A" * 22 + "=="},
    "a bad key": {"Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "bad"},
    "no key": {"Sec-WebSocket-Version": "13"},
}


@pytest.mark.parametrize("what", HANDSHAKES)
@pytest.mark.parametrize("path", ["ws", "media"])
def test_a_bad_handshake_ends_its_connection_only(session, what, path):
    async def deeds(visitor):
        upgrade = {} if what == "no upgrade" else {"Upgrade": "websocket", "Connection": "Upgrade"}
        async with visitor.page() as good:
            for _ in range(5):
                status, _ = await visitor.get(
                    f"/{visitor.token}/{path}",
                    Origin="http://127.0.0.1:8310",
                    **upgrade,
                    **HANDSHAKES[what],
                )
                assert status == 400
            await good.text("state")

    visit(session.pages()["space"], deeds)


def test_viewers_keep_no_operator_out(session):
    pages = session.pages()

    async def deeds(visitor):
        viewer = Visitor(visitor.client, visitor.url.replace(visitor.token, pages["viewer_token"]))
        async with contextlib.AsyncExitStack() as stack:
            watching = 0
            for _ in range(20):
                try:
                    await stack.enter_async_context(viewer.page())
                    watching += 1
                except aiohttp.WSServerHandshakeError as error:
                    assert error.status == 503
            assert 1 < watching < 20
            async with visitor.page() as page:
                await page.text("state")

    visit(pages["space"], deeds)


def test_garbage_closes_the_socket_that_sent_it_only(session):
    async def deeds(visitor):
        async with visitor.page() as good:
            for garbage in (b"", b"\x82", bytes(24), os.urandom(2000), "{", "[" * 4000):
                async with visitor.page() as bad:
                    await bad.ws.send_str(garbage) if isinstance(
                        garbage, str
                    ) else await bad.ws.send_bytes(garbage)
                    assert await bad.close_code() == 1008
            async with visitor.page() as bad:
                await bad.ws.send_bytes(bytes(5000))
                assert await bad.close_code() == 1009
            async with visitor.page("media") as bad:
                await bad.ws.send_bytes(b"\x83" + bytes(100))
                assert await bad.close_code() == 1008
            for _ in range(3):
                await good.text("state")

    visit(session.pages()["space"], deeds)


def test_a_viewer_moves_nothing_and_the_holder_lets_go_with_its_socket(session):
    pages = session.pages()
    space, viewer = pages["space"], pages["viewer_token"]
    watching = space.partition("token=")[0] + f"token={viewer}"

    async def watch(visitor):
        async with visitor.page() as page:
            assert page.hello["role"] == "viewer"
            await page.ws.send_bytes(hand(1))
            for do, fields in (("hand", {"action": "take"}), ("command", SELECT)):
                answer = await page.ask(do, **fields)
                assert (answer["ok"], answer["error"]) == (False, "a viewer may watch only")
            assert (await page.text("state"))["hand"]["holder"] is None

    async def hold(visitor):
        async with visitor.page() as other:
            async with visitor.page() as page:
                assert (await page.ask("hand", action="take"))["ok"]
                for sequence in range(1, 50):
                    await page.ws.send_bytes(hand(sequence, x=0.1))
                while (await other.text("state"))["hand"]["holder"] != page.hello["page"]:
                    pass
            while (await other.text("state"))["hand"]["holder"] is not None:
                pass

    visit(watching, watch)
    visit(space, hold)


def test_who_joins_in_the_middle_has_the_same_picture(session):
    async def deeds(visitor):
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
        for sequence in range(last - 30, last + 1):
            np.testing.assert_array_equal(one[sequence], other[sequence])

    visit(session.pages()["space"], deeds)


def test_pages_that_do_not_read_delay_no_other_and_one_that_reads_again_has_a_picture(session):
    async def deeds(visitor):
        stalled = socket.socket()
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        host, _, port = visitor.origin.partition("//")[2].partition(":")
        stalled.connect((host, int(port)))
        stalled.sendall(
            f"GET /{visitor.token}/ws HTTP/1.1\r\nHost: {host}:{port}\r\n"
            f"Origin: {visitor.origin}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
            "".encode()
        )
        async with visitor.page() as slow, visitor.page() as good:
            stream = stream_of(good, "sent")
            slow.ws._response.connection.transport.pause_reading()
            begin = (await good.units(stream, lambda unit: not unit.replayed))[-1].sequence
            units = await good.units(stream, lambda unit: unit.sequence >= begin + 200)
            assert [unit.sequence for unit in units] == [*range(begin + 1, begin + 201)]
            slow.ws._response.connection.transport.resume_reading()
            found = await slow.units(stream, lambda unit: unit.sequence >= begin + 230)
            live = await good.units(stream, lambda unit: unit.sequence >= begin + 230)
            assert found[-1].sequence == live[-1].sequence
            assert found[-1].sequence in decoded(found)
        stalled.close()

    visit(session.pages()["ground"], deeds)


def test_ground_control_records_and_a_viewer_does_not(session):
    async def deeds(visitor):
        async def told(page, wanted):
            while wanted((await page.text("figures"))["figures"].get("recorder.file")) is None:
                pass

        async with visitor.page() as page:
            assert (await page.ask("record", action="start"))["ok"]
            await told(page, lambda file: file)
            again = await page.ask("record", action="start")
            assert not again["ok"] and ".mcap" in again["error"]
            await asyncio.sleep(1)
            assert (await page.ask("record", action="stop"))["ok"]
            await told(page, lambda file: True if file is None else None)
            assert "not being recorded" in (await page.ask("record", action="stop"))["error"]

    pages = session.pages()
    visit(pages["ground"], deeds)
    (path,) = session.directory.glob(f"{session.session}-*.mcap")
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    counted = summary.statistics.channel_message_counts
    assert {each.topic for each in summary.channels.values() if counted.get(each.id)} >= ALWAYS

    async def watch(visitor):
        async with visitor.page() as page:
            assert "watch only" in (await page.ask("record", action="start"))["error"]

    ground, viewer = pages["ground"].partition("token=")[0], pages["viewer_token"]
    visit(f"{ground}token={viewer}", watch)


def test_ground_sees_what_a_page_in_space_films(session, monkeypatch):
    with session.bus(monkeypatch) as bus:
        ground = bus.reader("displayed/downlink_video")
        page = bus.writer(PAGE, max_octets=PICTURE_OCTETS)

        def give(number):
            stamp = CaptureStamp(CLOCK.now_ns(), number, "page_space")
            page.publish_video(VideoFrame(flat(200), stamp))

        def sees(flatness):
            level = newest_level(ground)
            return level is not None and (abs(level - 200) < 6) is flatness

        eventually(lambda: sees(False), "the cabin")
        with repeated(give):
            eventually(lambda: sees(True), "the page's picture on the ground")
        eventually(lambda: sees(False), "the cabin again")


def test_own_sound_is_taken_while_the_page_gives_it(session):
    async def deeds(visitor):
        async with visitor.page("media") as media, visitor.page() as page:
            sound = next(each for each in page.hello["inputs"] if each["kind"] == "audio")
            index, name = sound["index"], sound["name"]
            assert (await media.ask("input", name=name, on=True))["ok"]
            async with visitor.page("media") as other:
                assert not (await other.ask("input", name=name, on=True))["ok"]
            for number in range(25):
                header = struct.pack("<BBHId", 0x84, index, 960, number, 1000.0 + 20 * number)
                await media.ws.send_bytes(header + bytes(1920))
                await asyncio.sleep(0.02)
            while (await page.text("state"))["inputs"][name] is None:
                pass
            await media.ws.close()
            while (await page.text("state"))["inputs"][name] is not None:
                pass

    visit(session.pages()["ground"], deeds)
