"""WHIP (RFC 9725) and WHEP (draft-ietf-wish-whep) towards a media server. A shell.

Both are one exchange of HTTP: an offer is posted, the answer comes back with the address of the
session, at which ICE is restarted and the session is deleted. `Keeper` keeps one connection, and
`Far` does so in a process of its own for a joystick or robot: their loop of 1 kHz and an event loop
would wait for each other in one interpreter. Both processes hand each other samples by a pair of
Unix sockets, which nobody else reaches.
"""

import asyncio
import multiprocessing
import signal
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from typing import Generic, Self, TypeVar
from urllib.parse import urljoin, urlsplit

import aiohttp
from multidict import CIMultiDictProxy

from kontur_av.clock import Clock, MonotonicClock
from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.partner.decisions import Attempts, Doing
from pipelines.partner.description import (
    MOST_SDP_OCTETS,
    Transport,
    read_candidates,
    text_of,
    write_candidates,
)
from pipelines.partner.ice_servers import IceServer, IceServers, servers_of_links
from pipelines.partner.peer import RtcPeer
from pipelines.partner.samples import SamplePeer
from pipelines.session.command_process import end_with_parent, say
from pipelines.session.datagrams import Outlet, newest_sample

_SDP, _FRAGMENT = "application/sdp", "application/trickle-ice-sdpfrag"
_TIMEOUT = aiohttp.ClientTimeout(total=10, connect=5)
_MOST_REDIRECTS = 3
#: A server may refuse for now: too slow, in use, too early, too often.
_FOR_NOW = (408, 409, 423, 425, 429)
_MEANINGS = {401: "the token is not taken", 403: "this token may not", 404: "nothing is there"}
#: Of what a server says with a refusal.
_MOST_WORDS = 200


class WhipClient:
    """One session at a media server. A context manager, which deletes the session in the end.

    url: the endpoint, http or https. It may send us elsewhere.
    token: the bearer token; "" for none. Another origin than that of `url` does not get it, unless
        it is one of `token_origins`.
    Raises ConfigError for a malformed url.
    """

    def __init__(self, url: str, *, token: str = "", token_origins: Sequence[str] = ()) -> None:
        self._url, self._token = url, token
        self._origins = {_origin(origin) for origin in (url, *token_origins)}
        self._session: aiohttp.ClientSession | None = None
        self._resource: str | None = None
        #: Where the newest answer came from, after redirects.
        self._answered = url
        self._etag: str | None = None

    async def __aenter__(self) -> Self:
        # A connection of its own for each request: the address may have changed since the last.
        connector = aiohttp.TCPConnector(force_close=True)
        self._session = aiohttp.ClientSession(
            connector=connector, timeout=_TIMEOUT, auto_decompress=False
        )
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._session is not None
        await self.delete()
        await self._session.close()

    async def ice_servers(self) -> tuple[IceServer, ...]:
        """Ask which STUN and TURN servers to use (RFC 9725 section 4.6); it may name none."""
        try:
            _, headers, _ = await self._ask("OPTIONS", self._url, b"", {})
        except (ConnectionError, ProtocolError, ConfigError):
            return ()
        return servers_of_links(headers.getall("Link", []))

    async def post(self, offer: str) -> str:
        """Post an offer; the answer.

        Raises ConfigError for what trying again does not fix, ConnectionError for a server that
        does not answer or refuses for now, and ProtocolError for one that answers nonsense.
        """
        headers = {"Content-Type": _SDP, "Accept": _SDP}
        status, told, answer = await self._ask("POST", self._url, offer.encode(), headers)
        # It should be 201 and application/sdp. Older servers answer otherwise.
        if status not in (200, 201, 202):
            raise ConnectionError(f"the media server answers {status}")
        if not answer.lstrip().startswith("v="):
            raise ProtocolError("the media server's answer is no session description")
        location = told.get("Location")
        self._resource = None if location is None else _joined(self._answered, location)
        self._etag = told.get("ETag")
        return answer

    async def restart(self, local: Transport) -> Transport:
        """Restart ICE (RFC 9725 section 4.3.3); the server's new addresses. Raises as `post`."""
        if self._resource is None:
            raise ConnectionError("the media server has named no session to restart")
        headers = {"Content-Type": _FRAGMENT, "If-Match": "*"}
        body = write_candidates(local, mid="0").encode()
        status, told, answer = await self._ask("PATCH", self._resource, body, headers)
        if status != 200:
            raise ConnectionError(f"the media server does not restart ICE: {status}")
        self._etag = told.get("ETag", self._etag)
        return read_candidates(answer)

    async def delete(self) -> None:
        """End the session; a server that does not answer is left alone."""
        resource, self._resource = self._resource, None
        if resource is not None:
            with suppress(ConnectionError, ProtocolError, ConfigError):
                await self._ask("DELETE", resource, b"", {})

    async def _ask(
        self, method: str, url: str, body: bytes, headers: Mapping[str, str]
    ) -> tuple[int, CIMultiDictProxy[str], str]:
        assert self._session is not None
        try:
            for _ in range(_MOST_REDIRECTS + 1):
                sent = dict(headers)
                if self._token and _origin(url) in self._origins:
                    sent["Authorization"] = f"Bearer {self._token}"
                async with self._session.request(
                    method, url, data=body or None, headers=sent, allow_redirects=False
                ) as answer:
                    if answer.status in (307, 308) and "Location" in answer.headers:
                        url = _joined(url, answer.headers["Location"])
                        continue
                    text = await _read(answer)
                    if answer.status >= 400:
                        raise _refused(f"{method} {url}", answer.status, text)
                    self._answered = url
                    return answer.status, answer.headers, text
        except (TimeoutError, aiohttp.ClientError) as error:
            said = str(error) or type(error).__name__
            raise ConnectionError(f"no answer of {urlsplit(url).netloc}: {said}") from None
        raise ProtocolError("the media server sends us round in circles")


def _joined(base: str, location: str) -> str:
    with refused("the media server's Location is no address", ValueError, raising=ProtocolError):
        return urljoin(base, location)


def _origin(url: str) -> tuple[str, str, int | None]:
    """Scheme, host and port; ConfigError if it is no address of a server."""
    try:
        parts = urlsplit(url)
        if parts.scheme in ("http", "https") and parts.hostname:
            port = parts.port or (443 if parts.scheme == "https" else 80)
            return parts.scheme, parts.hostname, port
    except ValueError:
        pass  # for example a port of letters
    raise ConfigError(f"{url!r} is no address of a media server: write https://HOST/PATH")


def _refused(asked: str, status: int, said: str) -> ConfigError | ConnectionError:
    """A refusal of a server, with what it says; ConfigError if trying again does not help."""
    words = " ".join("".join(sign if sign.isprintable() else " " for sign in said).split())
    meaning = f"{_MEANINGS[status]} " if status in _MEANINGS else ""
    line = f"{asked}: {meaning}({status})" + (f": {words[:_MOST_WORDS]}" if words else "")
    return ConfigError(line) if status < 500 and status not in _FOR_NOW else ConnectionError(line)


async def _read(answer: aiohttp.ClientResponse) -> str:
    found = bytearray()
    async for chunk in answer.content.iter_chunked(4096):
        found += chunk
        if len(found) > MOST_SDP_OCTETS:
            raise ProtocolError(f"an answer of more than {MOST_SDP_OCTETS} octets")
    return text_of(bytes(found), answer.charset)


_LOOK_S = 0.25
_Peer = TypeVar("_Peer", RtcPeer, SamplePeer)


class Keeper(Generic[_Peer]):
    """Connects to a server, restarts ICE when nothing comes any more, and connects again.

    A connection for samples ends when nothing comes, and a new one is made.

    url, token, token_origins: as of `WhipClient`.
    make_peer: called with the ICE servers of each connection.
    servers: called for our own ICE servers; without any, the server is asked for some.
    told: called with one line at each change.
    """

    def __init__(
        self,
        url: str,
        *,
        token: str,
        token_origins: Sequence[str] = (),
        make_peer: Callable[[IceServers], _Peer],
        servers: Callable[[], IceServers],
        clock: Clock,
        told: Callable[[str], None] = lambda _: None,
    ) -> None:
        # A wrong address is refused here and now.
        self._new_client = partial(WhipClient, url, token=token, token_origins=token_origins)
        self._new_client()
        self._make_peer: Callable[[IceServers], _Peer] = make_peer
        self._servers = servers
        self._clock, self._told = clock, told
        self.attempts = Attempts()
        #: The present connection; None while there is none.
        self.peer: _Peer | None = None
        #: Why the last connection ended.
        self.fault = ""
        self._stopping = False

    def stop(self) -> None:
        """Let `run` end soon."""
        self._stopping = True

    async def run(self) -> None:
        """Keep the connection until `stop`, or until another one has taken its place.

        Raises ConfigError for what trying again does not fix, unless a connection stood before.
        """
        displaced = False
        while not self._stopping:
            if not self.attempts.poll_connect(self._clock.now_ns()):
                await asyncio.sleep(_LOOK_S / 5)
                continue
            try:
                await self._connection()
            except ConfigError as error:
                if not self.attempts.stood:
                    raise
                self.fault = str(error)
            except (ConnectionError, ProtocolError) as error:
                self.fault = str(error)
            finally:
                if self.peer is not None:
                    await self.peer.close()
                    self.fault = self.peer.fault or self.fault
                    displaced = isinstance(self.peer, SamplePeer) and self.peer.displaced
                    self.peer = None
            self.attempts.handle_ended(self._clock.now_ns())
            if not self._stopping:
                self._stopping = displaced
                self._told(f"no connection: {self.fault or 'it has ended'}")

    async def _connection(self) -> None:
        async with self._new_client() as client:
            servers = self._servers()
            if not servers.servers:
                servers = replace(servers, servers=await client.ice_servers())
            peer = self.peer = self._make_peer(servers)
            offer = await peer.offer()
            await peer.accept(await client.post(offer))
            running = asyncio.create_task(peer.run())
            try:
                while not self._stopping and not running.done():
                    await self._look(client, peer)
                    await asyncio.wait([running], timeout=_LOOK_S)
            finally:
                await peer.close()
                with suppress(asyncio.CancelledError):
                    await running

    async def _look(self, client: WhipClient, peer: RtcPeer | SamplePeer) -> None:
        now_ns = self._clock.now_ns()
        route = peer.route if isinstance(peer, RtcPeer) else None
        if peer.connected and self.attempts.doing is Doing.CONNECTING:
            self.attempts.handle_connected(now_ns)
            self._told("connected" if route is None else f"connected by {route}")
        if isinstance(peer, SamplePeer):
            return
        if self.attempts.is_hopeless(now_ns):
            self.fault = "nothing came for seconds, also after a restart of ICE"
            await peer.close()
        elif self.attempts.poll_restart(silent=peer.is_silent, now_ns=now_ns):
            self._told("nothing comes any more: ICE begins anew")
            with suppress(ConnectionError, ProtocolError, ConfigError, TimeoutError):
                async with asyncio.timeout(5):
                    local = await peer.restart()
                    await peer.finish_restart(await client.restart(local))


_END_S = 3.0


class Far:
    """A session that a partner reaches by WebRTC. A context manager.

    own: on which its samples come. to_session: where samples for it go. who: comes to it.
    url: `https://HOST:PORT`. token: of the address. servers: for the way through NAT.
    Raises ConfigError for a malformed address.
    """

    def __init__(
        self, url: str, token: str, servers: Callable[[], IceServers], *, who: str
    ) -> None:
        address = _endpoint(url)
        self.own, self._beyond = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.own.setblocking(False)
        self._beyond.setblocking(False)
        self.to_session = Outlet(self.own)
        self._process = multiprocessing.get_context("fork").Process(
            target=_relay, args=(address, token, servers, self._beyond, who)
        )

    def __enter__(self) -> Self:
        self._process.start()
        self._beyond.close()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.own.close()


def _endpoint(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ConfigError(f"--rtc {url!r}: write https://HOST:PORT, as `stream --rtc` prints it")
    return f"{parts.scheme}://{parts.netloc}/haptics"


def _relay(
    url: str, token: str, servers: Callable[[], IceServers], end: socket.socket, who: str
) -> None:
    # Ctrl-C goes to both; the loop's process ends this one. So does its own end: the connection of
    # one that was killed would keep others out.
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with closing(end):
        try:
            asyncio.run(_keep(url, token, servers, end, who))
        except ConfigError as error:
            say(f"{who}: {error}")


async def _keep(
    url: str, token: str, servers: Callable[[], IceServers], end: socket.socket, who: str
) -> None:
    to_end, loop = Outlet(end), asyncio.get_running_loop()
    keeper = Keeper(
        url,
        token=token,
        make_peer=lambda found: SamplePeer(found, to_end.send),
        servers=servers,
        clock=MonotonicClock(),
        told=lambda line: say(f"{who}: {line}"),
    )
    loop.add_signal_handler(signal.SIGTERM, keeper.stop)

    def forward() -> None:
        newest, peer = newest_sample(end), keeper.peer
        # Not before it is said that the connection stands.
        if newest is not None and peer is not None and keeper.attempts.doing is Doing.CONNECTED:
            peer.send(newest)

    loop.add_reader(end, forward)
    await keeper.run()
