"""The HTTP side of partners who come to us: WHIP and WHEP endpoints and a page. A shell.

| request | for |
|---|---|
| POST /whip | the partner's picture and voice (RFC 9725) |
| POST /whep/NAME | to watch a programme (draft-ietf-wish-whep) |
| POST /haptics | to steer, with a token of its own: a data channel for haptic samples |
| PATCH, DELETE /session/ID | to add addresses, to restart ICE, to end |
| GET /rtc?token=… | a page that does all of it |
"""

import asyncio
import secrets
import traceback
from collections.abc import Awaitable, Callable, Iterable

from aiohttp import web

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.partner.decisions import Admission, Refusal
from pipelines.partner.description import (
    MALFORMED,
    MOST_SDP_OCTETS,
    NotAcceptableError,
    clean_candidates,
    read_candidates,
    text_of,
    write_candidates,
)
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.partner.peer import Programme, RtcPeer
from pipelines.partner.samples import SamplePeer, SamplePorts
from pipelines.session.access import AccessError
from pipelines.session.page_sockets import HAND_TOKEN, PageListener
from pipelines.session.web_site import SHUTDOWN_S, WebSite, quiet_log

_SDP, _FRAGMENT = "application/sdp", "application/trickle-ice-sdpfrag"
#: In the HTML file: what can be watched, whether anything is taken.
_PROGRAMMES, _TAKES = "__PROGRAMMES__", "__TAKES__"
_SESSION = "/session/"
_HAPTICS = "/haptics"
#: A page of another origin asks first, without the token (CORS); the token alone lets anybody in.
_PREFLIGHT = "Access-Control-Request-Method"
_CROSS_ORIGIN = {
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Allow-Methods": "POST, PATCH, DELETE, OPTIONS",
    "Access-Control-Allow-Headers": "Authorization, Content-Type, If-Match",
    "Access-Control-Expose-Headers": "Location, ETag, Link, Accept-Patch",
}
#: A connection that does not come about is ended; the partner's own timeout is as long.
_TIMEOUT_S = 25.0
_CLOSE_S = 0.5


class _Session:
    """A partner's connection, with the task that drives it. left: called when it has ended."""

    def __init__(self, peer: RtcPeer | SamplePeer, left: Callable[[], None]) -> None:
        self.peer, self.left = peer, left
        self.etag = f'"{secrets.token_hex(4)}"'
        self.ufrag = ""
        self.task: asyncio.Task[None] | None = None


class RtcServer:
    """Serves partners on a bound socket.

    listener: where; its operator token is the partner's. programmes: what can be watched.
    handle: called with what the partner sends; None: nothing is taken.
    servers: called for the STUN and TURN servers of each new connection.
    most_bps: of the partner's picture.
    samples: what its joystick drives; None: nothing. Its token is among the listener's people.
    lent: whether the owner lets partners drive; see `Admission.check_hand`.
    """

    def __init__(
        self,
        listener: PageListener,
        programmes: Iterable[Programme],
        *,
        clock: MonotonicClock,
        handle: Callable[[PictureCame | SoundCame], None] | None,
        servers: Callable[[], IceServers] = IceServers,
        most_bps: int = 1_500_000,
        samples: SamplePorts | None = None,
        lent: Callable[[], bool] = lambda: True,
    ) -> None:
        self._samples, self._lent = samples, lent
        self._clock, self._handle = clock, handle
        self._servers, self._most_bps = servers, most_bps
        self.programmes = {programme.name: programme for programme in programmes}
        self.admission = Admission(
            token=listener.operator_token, hand_token=listener.people.get(HAND_TOKEN, "")
        )
        self._site = WebSite(listener, seat="rtc")
        self._sessions: dict[str, _Session] = {}
        self._runner: web.AppRunner | None = None
        #: The connection by which the partner sends; None while there is none.
        self.partner: RtcPeer | None = None
        #: The connection by which it steers; None while there is none.
        self.hand: SamplePeer | None = None
        #: Connections that were made; offers and fragments that could not be used.
        self.made = self.garbage = 0
        #: Connections and requests that ended in an error of this software or of a library.
        self.faults = 0

    @property
    def peers(self) -> list[RtcPeer]:
        """All connections, also those that are being made."""
        peers = (session.peer for session in self._sessions.values())
        return [peer for peer in peers if isinstance(peer, RtcPeer)]

    async def start(self) -> None:
        application = web.Application(client_max_size=MOST_SDP_OCTETS)
        # One handler: the address tells an unknown sender nothing before the token is known.
        application.router.add_route("*", "/{path:.*}", self._answer)
        self._runner = web.AppRunner(
            application,
            access_log=None,
            logger=quiet_log("pipelines.partner.http"),
            shutdown_timeout=SHUTDOWN_S,
        )
        await self._site.start(self._runner)

    async def close(self) -> None:
        """End all connections, and serve no more."""
        await asyncio.gather(*(self._end(name) for name in list(self._sessions)))
        self._site.close()
        if self._runner is not None:
            await self._runner.cleanup()

    async def _answer(self, request: web.Request) -> web.StreamResponse:
        path = request.raw_path.partition("?")[0]
        try:
            if path in ("/whip", _HAPTICS) or path.startswith(("/whep/", _SESSION)):
                if request.method == "OPTIONS" and _PREFLIGHT in request.headers:
                    return web.Response(status=204, headers=_CROSS_ORIGIN)
                answer = await self._signal(request, path)
                answer.headers.update(_CROSS_ORIGIN)
                return answer
            words = {
                _PROGRAMMES: " ".join(self.programmes),
                _TAKES: "false" if self._handle is None else "true",
            }
            return self._site.file(request, self._site.find(request), words)
        except AccessError as error:
            return self._site.refuse(error)
        except ProtocolError as error:
            self.garbage += 1
            return web.Response(status=400, text=f"{error}\n")
        except (web.HTTPException, ConnectionError, asyncio.CancelledError):
            raise
        except Exception:
            # Whatever one partner caused ends its request alone; the error stream has it.
            self.faults += 1
            traceback.print_exc()
            return web.Response(status=500)

    async def _signal(self, request: web.Request, path: str) -> web.Response:
        now_ns = self._clock.now_ns()
        steers = None if path.startswith(_SESSION) else path == _HAPTICS
        refusal = self.admission.check(request.headers.get("Authorization"), now_ns, steers=steers)
        if refusal is not None:
            return _refused(refusal)
        self._site.handle_known(request)
        if path.startswith(_SESSION):
            return await self._change(request, path.removeprefix(_SESSION))
        programme = self.programmes.get(path.removeprefix("/whep/"))
        wanted = {"/whip": self._handle, _HAPTICS: self._samples}.get(path, programme)
        if wanted is None:
            return web.Response(status=404)
        if request.method == "OPTIONS":
            answer = web.Response(status=204, headers={"Accept-Post": _SDP})
            for link in self._servers().link_headers():
                answer.headers.add("Link", link)
            return answer
        if request.method != "POST":
            return web.Response(status=405, headers={"Allow": "POST, OPTIONS"})
        if request.content_type != _SDP:
            return web.Response(status=415, headers={"Accept-Post": _SDP})
        text = text_of(await request.read(), request.charset)
        offer = clean_candidates(text, loopback=_is_here(request))
        viewers = None if programme is None else len(programme.peers)
        refusal = self.admission.check_offer(viewers=viewers, now_ns=now_ns)
        if refusal is not None:
            return _refused(refusal)
        if path == _HAPTICS and self._samples is not None:
            heard_ns = None if self.hand is None else self.hand.heard_ns
            refusal = self.admission.check_hand(heard_ns=heard_ns, lent=self._lent(), now_ns=now_ns)
            if refusal is not None:
                return _refused(refusal)
            return await self._begin_hand(offer, self._samples)
        return await self._begin(offer, programme)

    async def _begin(self, offer: str, programme: Programme | None) -> web.Response:
        """Take the partner's media, or send it a programme."""
        peer: RtcPeer = RtcPeer(
            clock=self._clock,
            sends={} if programme is None else programme.sends,
            receives=("audio", "video") if programme is None else (),
            handle=self._handle or (lambda _: None),
            want_key=lambda: None if programme is None else programme.want_key(peer),
            servers=self._servers(),
            most_bps=self._most_bps,
            offers=False,
        )

        async def join() -> None:
            if programme is not None:
                programme.peers.add(peer)
                return
            old, self.partner = self.partner, peer
            if old is not None:
                await old.close()

        def leave() -> None:
            if programme is not None:
                programme.peers.discard(peer)
            if self.partner is peer:
                self.partner = None

        response = await self._answer_offer(_Session(peer, leave), offer, join)
        if response.status == 201:
            for link in self._servers().link_headers():
                response.headers.add("Link", link)
        return response

    async def _begin_hand(self, offer: str, samples: SamplePorts) -> web.Response:
        """Take the partner's joystick in the place of an earlier one."""
        peer = SamplePeer(self._servers(), samples.handle)

        async def join() -> None:
            for name, other in list(self._sessions.items()):
                if isinstance(other.peer, SamplePeer):
                    await other.peer.displace()
                    await self._end(name)
            samples.join(peer)
            self.hand = peer

        def leave() -> None:
            if self.hand is peer:
                self.hand = None
                samples.leave()

        return await self._answer_offer(_Session(peer, leave), offer, join)

    async def _answer_offer(
        self, session: _Session, offer: str, join: Callable[[], Awaitable[None]]
    ) -> web.Response:
        """Answer an offer; drive the session that comes of it. join: what is done before."""
        try:
            answer = await session.peer.answer(offer)
            await join()
        except (ProtocolError, ConfigError) as error:
            await session.peer.close()
            self.garbage += isinstance(error, ProtocolError)
            status = 400 if isinstance(error, ProtocolError) else 503
            status = 406 if isinstance(error, NotAcceptableError) else status
            return web.Response(status=status, text=f"{error}\n")
        name = secrets.token_urlsafe(16)
        headers = {"Location": _SESSION + name}
        if isinstance(session.peer, RtcPeer):
            session.ufrag = session.peer.peer_ufrag
            headers["ETag"] = session.etag
        session.task = asyncio.create_task(self._drive(name, session))
        self._sessions[name] = session
        self.made += 1
        return web.Response(status=201, text=answer, content_type=_SDP, headers=headers)

    async def _drive(self, name: str, session: _Session) -> None:
        try:
            await session.peer.run()
        except (OSError, *MALFORMED):
            # Of a peer's value, by a library: the connection ends, and its partner sees that.
            self.faults += 1
            traceback.print_exc()
        finally:
            self._sessions.pop(name, None)
            session.left()
            await session.peer.close()

    async def _end(self, name: str) -> None:
        session = self._sessions.pop(name, None)
        if session is not None:
            await session.peer.close()
            if session.task is not None:
                await asyncio.wait([session.task], timeout=_CLOSE_S)

    async def _change(self, request: web.Request, name: str) -> web.Response:
        session = self._sessions.get(name)
        if session is None:
            return web.Response(status=404)
        if request.method == "DELETE":
            await self._end(name)
            return web.Response(status=200)
        peer = session.peer
        if not isinstance(peer, RtcPeer):
            return web.Response(status=404)
        if request.method != "PATCH":
            return web.Response(status=405, headers={"Allow": "PATCH, DELETE"})
        if request.content_type != _FRAGMENT:
            return web.Response(status=415, headers={"Accept-Patch": _FRAGMENT})
        match = request.headers.get("If-Match")
        text = text_of(await request.read(), request.charset)
        told = read_candidates(clean_candidates(text, loopback=_is_here(request)))
        if told.ufrag == session.ufrag:
            if match is not None and match not in ("*", session.etag):
                return web.Response(status=412)
            await peer.add_candidates(told)
            return web.Response(status=204)
        # Other credentials: a restart of ICE, which must hold for any state of the session.
        if match != "*":
            return web.Response(status=428 if match is None else 412)
        local = await peer.restart(told)
        session.ufrag = told.ufrag
        session.etag = f'"{secrets.token_hex(4)}"'
        return web.Response(
            status=200,
            text=write_candidates(local, mid="0"),
            content_type=_FRAGMENT,
            headers={"ETag": session.etag},
        )


def _is_here(request: web.Request) -> bool:
    """Whether the partner's program runs on this machine, so that loopback is its own."""
    return request.remote is not None and request.remote in ("127.0.0.1", "::1")


def _refused(refusal: Refusal) -> web.Response:
    headers = {"WWW-Authenticate": "Bearer"} if refusal.status == 401 else {}
    if refusal.status in (429, 503):
        headers["Retry-After"] = "2"
    return web.Response(status=refusal.status, text=f"{refusal.words}\n", headers=headers)
