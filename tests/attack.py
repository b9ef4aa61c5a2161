"""Attack a live session from outside while an operator works, and tell what the operator sees.

    python tests/attack.py --minutes 10 --seed 1

Not part of CI. Attackers without a token, with a viewer's and with a partner's token try what they
can, in a process of their own: idle and slow connections, bad handshakes, garbage, requests beyond
their role, false offers and candidates. An operator at a page watches the uplink's picture and
moves the robot: without attackers, beside a process that only computes, and beside attackers.

Exit code 1 if a process restarted, a page of the operator was closed, the robot needed a new press,
or the report has a failure.
"""

import argparse
import asyncio
import contextlib
import json
import multiprocessing
import os
import random
import socket
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi, sin
from pathlib import Path

import aiohttp
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "helpers")]

from page_client import Visitor, hand, unit_of  # noqa: E402
from partners import OPUS, kept, sending  # noqa: E402
from running_session import RunningSession  # noqa: E402

from kontur_av.clock import MonotonicClock  # noqa: E402
from kontur_av.media import CaptureStamp  # noqa: E402
from pipelines.session.setup.table import PORTS  # noqa: E402

PAGE, RTC = 8350, 8360
TOKEN = "word-of-the-partner"
ATTACKS = (
    *("idle", "slow", "nonsense", "guesses", "crowd", "handshakes", "beyond_its_role", "flood"),
    *("offers", "trickles", "partner", "datagrams"),
)
DOS = ("hand", "command", "record", "stop", "input", "owner", "task", "joystick", "chat", "trainer")
#: An offer of a browser, as far as attackers need one.
OFFER = (
    "v=0|o=- 1 2 IN IP4 127.0.0.1|s=-|t=0 0|a=group:BUNDLE 0|"
    "m=video 9 UDP/TLS/RTP/SAVPF 102|c=IN IP4 0.0.0.0|a=ice-ufrag:peer|"
    "a=ice-pwd:peerpeerpeerpeerpeerpeer|a=fingerprint:sha-256 " + ":".join(["CD"] * 32) + "|"
    "a=setup:actpass|a=mid:0|a=sendonly|a=rtcp-mux|a=rtpmap:102 H264/90000|a=ssrc:77 cname:x|"
    "a=fmtp:102 packetization-mode=1;profile-level-id=42e01f;level-asymmetry-allowed=1"
).replace("|", "\r\n")
CANDIDATES = (
    "1 1 udp 2130706431 127.0.0.1 {port} typ host",
    "1 1 udp 2130706431 127.0.0.1 70000 typ host",
    "1 1 udp 2130706431 10.0.0.1 -1 typ host",
    "1 1 tcp 1 ::1 {port} typ host tcptype active",
    "x" * 2000,
    "1 1 udp 99999999999999999999 0.0.0.0 0 typ relay raddr 0.0.0.0 rport 0",
)


@dataclass
class Seen:
    """What the operator saw. Instants in s."""

    #: Arrivals of the uplink's access units.
    units: list[float] = field(default_factory=list)
    closed: int = 0
    texts: int = 0
    waited: int = 0
    #: Round trips of a request to the page's server.
    answers: list[float] = field(default_factory=list)


async def operate(url: str, seen: Seen, ends_s: float) -> None:
    """Watch and steer at the operator's page until `ends_s`."""
    async with aiohttp.ClientSession() as client:
        visitor = Visitor(client, url)
        while time.monotonic() < ends_s:
            with contextlib.suppress(aiohttp.ClientError, OSError):
                async with visitor.page() as page:
                    (stream,) = (
                        each["index"] for each in page.hello["streams"] if each["via"] == "coded"
                    )
                    await page.ask("hand", action="take")
                    steering = asyncio.create_task(steer(page.ws))
                    try:
                        while time.monotonic() < ends_s:
                            message = await page.next()
                            if message is None:
                                seen.closed += 1
                                break
                            look(message, stream, seen)
                    finally:
                        steering.cancel()


async def steer(ws: aiohttp.ClientWebSocketResponse) -> None:
    """Move the hand to and fro; let go for a moment every 20 s."""
    for sequence in range(1, 1 << 31):
        pressed = sequence % 2000 > 60
        place = 0.3 * sin(2 * pi * 0.004 * sequence)
        with contextlib.suppress(ConnectionError):
            await ws.send_bytes(hand(sequence, dead_man=pressed, x=place))
        await asyncio.sleep(0.01)


def look(message: bytes | str, stream: int, seen: Seen) -> None:
    """Take a message of the server."""
    if isinstance(message, str):
        seen.texts += 1
        text = json.loads(message)
        joystick = text.get("joystick") if text["kind"] == "state" else None
        if joystick and joystick.get("robot_waits"):
            seen.waited += 1
        return
    unit = unit_of(message)
    if unit is not None and unit.stream == stream and not unit.replayed:
        seen.units.append(time.monotonic())


class Attackers:
    """They share one event loop, in a process of their own."""

    def __init__(self, pages: dict[str, str], base_port: int, seed: int) -> None:
        self.pages, self.base_port = pages, base_port
        self.random = random.Random(seed)
        self.tried: Counter[str] = Counter()
        self.clock = MonotonicClock()

    async def run(self, seconds: float, only: Sequence[str]) -> None:
        deeds = (
            self.control, self.idle, self.slow, self.nonsense, self.guesses, self.datagrams,
            self.crowd, self.handshakes, self.beyond_its_role, self.flood,
            self.offers, self.trickles, self.partner,
        )  # fmt: skip
        deeds = tuple(each for each in deeds if each.__name__ in only)
        ends_s = time.monotonic() + seconds

        async def again(deed) -> None:
            while time.monotonic() < ends_s:
                try:
                    async with asyncio.timeout(8):
                        await deed()
                except Exception as error:
                    # Whatever the session answers; that an attack goes on is what counts.
                    self.tried[f"{deed.__name__}: {type(error).__name__}"] += 1
                self.tried[deed.__name__] += 1
                await asyncio.sleep(self.random.uniform(0.02, 0.3))

        await asyncio.gather(*map(again, deeds))

    def port(self) -> int:
        return self.random.choice((PAGE, PAGE + 1, RTC))

    async def control(self) -> None:
        """No attack: as much computing as one, to compare with. By `--only control`."""
        sum(range(10_000_000))

    # Without a token.

    async def idle(self) -> None:
        """Connections that say nothing."""
        writers = []
        try:
            while len(writers) < 400:
                writers.append((await asyncio.open_connection("127.0.0.1", self.port()))[1])
            await asyncio.sleep(self.random.uniform(0, 4))
        finally:
            for writer in writers:
                writer.close()

    async def slow(self) -> None:
        """A header, an octet at a time."""
        _, writer = await asyncio.open_connection("127.0.0.1", self.port())
        try:
            for octet in b"GET /space?token=x HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"y" * 40:
                writer.write(bytes([octet]))
                await writer.drain()
                await asyncio.sleep(0.1)
        finally:
            writer.close()

    async def nonsense(self) -> None:
        """Octets that are no HTTP, and HTTP that is too long."""
        what = self.random.choice((
            self.random.randbytes(3000),
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
            b"\x16\x03\x01" + self.random.randbytes(500),
            b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 5000,
            b"GET /" + b"a" * 60000 + b" HTTP/1.1\r\n\r\n",
            b"POST /whip HTTP/1.1\r\nHost: x\r\nContent-Length: 99999999999\r\n\r\n",
            b"POST /whip HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFF\r\n",
        ))  # fmt: skip
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port())
        try:
            writer.write(what)
            await writer.drain()
            await reader.read(1000)
        finally:
            writer.close()

    async def guesses(self) -> None:
        """Requests with a guessed token."""
        async with aiohttp.ClientSession() as client:
            for _ in range(20):
                path = self.random.choice(
                    ("/space?token=a", "/ground", "/a/ws", "/a/media", "/../etc/passwd", "/whip")
                )
                method = self.random.choice(("GET", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"))
                url = f"http://127.0.0.1:{self.port()}{path}"
                headers = {"Authorization": "Bearer guess"}
                async with client.request(method, url, data=b"x", headers=headers):
                    pass

    async def datagrams(self) -> None:
        """Garbage, and what looks like RTP, RTCP, samples and frames, on every UDP port."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            for _ in range(200):
                octets = self.random.randbytes(self.random.choice((1, 12, 16, 32, 200, 500, 1400)))
                if self.random.random() < 0.5:
                    kind = self.random.choice((96, 97, 200 - 128, 201 - 128, 206 - 128))
                    octets = struct.pack("!BBH", 0x80, 128 | kind, 9) + octets
                port = self.base_port + self.random.randrange(PORTS)
                with contextlib.suppress(OSError):
                    udp.sendto(octets, ("127.0.0.1", port))
            await asyncio.sleep(0.05)

    # With a viewer's token.

    def viewer(self, client: aiohttp.ClientSession) -> Visitor:
        url = self.pages[self.random.choice(("space", "ground"))]
        return Visitor(client, f"{url.partition('token=')[0]}token={self.pages['viewer_token']}")

    async def crowd(self) -> None:
        """Many viewers, of whom some never read."""
        async with aiohttp.ClientSession() as client, contextlib.AsyncExitStack() as stack:
            for _ in range(20):
                with contextlib.suppress(aiohttp.WSServerHandshakeError):
                    page = await stack.enter_async_context(self.viewer(client).page())
                    if self.random.random() < 0.5:
                        page.ws._response.connection.transport.pause_reading()
            await asyncio.sleep(self.random.uniform(0, 3))

    async def handshakes(self) -> None:
        """Handshakes that are none."""
        async with aiohttp.ClientSession() as client:
            viewer = self.viewer(client)
            for _ in range(10):
                headers = {"Origin": viewer.origin}
                if self.random.random() < 0.7:
                    headers |= {"Upgrade": "websocket", "Connection": "Upgrade"}
                headers["Sec-WebSocket-Version"] = self.random.choice(("13", "99", "x", ""))
                headers["Sec-WebSocket-Key"] = self.random.choice(("bad", "A" * 22 + "==", ""))
                await viewer.get(
                    f"/{viewer.token}/{self.random.choice(('ws', 'media'))}", **headers
                )

    async def beyond_its_role(self) -> None:
        """Orders and a hand of a page that may only watch."""
        async with aiohttp.ClientSession() as client, self.viewer(client).page() as page:
            for number in range(30):
                await page.ws.send_bytes(hand(number, x=self.random.uniform(-1, 1)))
                request = {"request": number, "do": self.random.choice(DOS)}
                request["action"] = self.random.choice(("take", "start", "stop", "release", "x"))
                request["name"] = self.random.choice(("select", "power_off", {"a": []}, 5, None))
                await page.ws.send_str(json.dumps(request))

    async def flood(self) -> None:
        """Garbage on a page's sockets."""
        async with aiohttp.ClientSession() as client:
            path = self.random.choice(("ws", "media"))
            async with self.viewer(client).page(path) as page:
                with contextlib.suppress(ConnectionError):
                    for _ in range(200):
                        if self.random.random() < 0.5:
                            await page.ws.send_bytes(self.random.randbytes(100))
                        else:
                            await page.ws.send_str('{"request": ' + "[" * 200)

    # With a partner's token.

    def mutated(self) -> str:
        lines = OFFER.split("\r\n")
        for _ in range(self.random.randrange(4)):
            at = self.random.randrange(len(lines))
            lines[at] = self.random.choice(
                (lines[at][: self.random.randrange(8)], lines[at] * 3, "", "a=x" * 500, "m=audio")
            )
        candidate = self.random.choice(CANDIDATES).format(port=self.base_port + 2)
        return "\r\n".join([*lines, f"a=candidate:{candidate}", ""])

    async def offers(self) -> None:
        """Offers with false lines and candidates."""
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/sdp"}
        async with aiohttp.ClientSession() as client:
            path = self.random.choice(("/whip", "/whep/uplink", "/whep/downlink", "/whep/x"))
            url = f"http://127.0.0.1:{RTC}{path}"
            async with client.post(url, data=self.mutated(), headers=headers) as answer:
                self.tried[f"offer {answer.status}"] += 1
                where = answer.headers.get("Location")
            if where:
                async with client.delete(f"http://127.0.0.1:{RTC}{where}", headers=headers):
                    pass

    async def trickles(self) -> None:
        """Candidates for a connection, false ones among them; then nothing more."""
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/sdp"}
        async with aiohttp.ClientSession() as client:
            url = f"http://127.0.0.1:{RTC}/whip"
            async with client.post(url, data=OFFER + "\r\n", headers=headers) as answer:
                where = answer.headers.get("Location")
            headers["Content-Type"] = "application/trickle-ice-sdpfrag"
            for _ in range(10 if where else 0):
                candidate = self.random.choice(CANDIDATES).format(port=self.base_port + 3)
                fragment = f"a=ice-ufrag:peer\r\na=mid:0\r\na=candidate:{candidate}\r\n"
                url = f"http://127.0.0.1:{RTC}{where}"
                async with client.patch(url, data=fragment, headers=headers):
                    pass

    async def partner(self) -> None:
        """A connection that stands, sends garbage inside, and vanishes."""
        async with kept(f"http://127.0.0.1:{RTC}/whip", sending, TOKEN) as keeper:
            peer = keeper.peer
            for number in range(60):
                now_ns = self.clock.now_ns()
                peer.send_opus(OPUS, CaptureStamp(now_ns, number, "voice"))
                await peer._transport.send(self.random.randbytes(self.random.randrange(1, 300)))
                await peer._transport.send(b"\x80\xc9" + self.random.randbytes(20))
                await peer._transport.send(b"\x80\x66" + self.random.randbytes(30))
                await asyncio.sleep(0.01)


def attack(pages, base_port: int, seed: int, seconds: float, only: Sequence[str], out) -> None:
    """Attack from this process for so long; put what was tried into `out`.

    It takes what the session leaves of the processors, as if it were on another machine.
    """
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    attackers = Attackers(pages, base_port, seed)
    asyncio.run(attackers.run(seconds, only))
    out.put(dict(attackers.tried))


def gaps(seen: Seen) -> str:
    """Return the figures of a phase, in words."""
    between = np.diff(seen.units) * 1e3
    p50, p99 = np.percentile(between, (50, 99))
    return (
        f"{len(seen.units) / (seen.units[-1] - seen.units[0]):.1f} pictures/s, apart p50 {p50:.0f} "
        f"p99 {p99:.0f} max {between.max():.0f} ms; closed {seen.closed}, new press needed "
        f"{seen.waited} times, {seen.texts} texts"
    )


def main() -> int:
    """Run the session, without attackers and beside them; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[], help="these attacks alone, by name")
    arguments = parser.parse_args()
    seconds = 60 * arguments.minutes
    with tempfile.TemporaryDirectory() as directory:
        token = Path(directory) / "token"
        token.write_text(TOKEN)
        options = ("--page", str(PAGE), "--joystick", "page")
        options += ("--rtc", str(RTC), "--rtc-token-file", str(token))
        with RunningSession("spacejustin", *options, directory=directory) as session:
            session.wait_for_flow()
            pages = session.pages()
            before, beside = Seen(), Seen()
            quiet_s = min(60.0, seconds)
            asyncio.run(operate(pages["space"], before, time.monotonic() + quiet_s))
            print("without attackers:", gaps(before), flush=True)
            context = multiprocessing.get_context("spawn")

            def operate_beside(
                what: str, only: Sequence[str], seconds: float, seen: Seen
            ) -> dict[str, int]:
                out = context.Queue()
                attackers = context.Process(
                    target=attack,
                    args=(pages, session.base_port, arguments.seed, seconds, only, out),
                )
                attackers.start()
                asyncio.run(operate(pages["space"], seen, time.monotonic() + seconds))
                print(f"beside {what}:", gaps(seen), flush=True)
                tried = out.get(timeout=600)
                attackers.join()
                return tried

            control = Seen()
            operate_beside("as much computing", ["control"], quiet_s, control)
            attacks = arguments.only or ATTACKS
            tried = operate_beside("attackers", attacks, seconds, beside)
            code, report = session.interrupt()
            errors = session.errors()
    restarts = {name: each["restarts"] for name, each in report["processes"].items()}
    restarted = {name: count for name, count in restarts.items() if count}
    print("tried:", tried)
    metrics = {name: each for name, each in report["processes"].items() if "page" in name}
    print("pages:", metrics)
    print("partner:", report.get("rtc"))
    print(f"exit code {code}, restarts {restarted}, failures {report['failures']}")
    print("warnings:", *report["warnings"], sep="\n  ")
    print("errors:", errors)
    bad = restarted or report["failures"] or beside.closed or beside.waited > before.waited
    return 1 if bad or code else 0


if __name__ == "__main__":
    sys.exit(main())
