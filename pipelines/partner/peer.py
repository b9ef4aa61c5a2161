"""A partner's connection on an event loop, and what partners may watch by it. A shell.

How the descriptions travel (WHIP, WHEP, a media server's own way) is the caller's.
"""

import asyncio
import secrets
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ProtocolError
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.report import Latency
from pipelines.partner.description import (
    Kind,
    MediaLine,
    NotAcceptableError,
    Offer,
    Transport,
    common_line,
    common_lines,
    read_description,
    wanted_line,
    write_description,
)
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.media import PictureCame, RtcMedia, SoundCame
from pipelines.partner.tally import TrackMetrics
from pipelines.partner.transport import Route, RtcTransport
from pipelines.session.session_metrics import Report

Event = PictureCame | SoundCame


class RtcPeer:
    """One connection to a partner.

    An offering end calls `offer` and then `accept`; an answering end calls `answer`. Both send with
    `send_unit` and `send_opus` from then on; what is sent before the connection stands is dropped.
    `run` drives it until it ends; `close` ends it.

    sends: by kind, the usual bit/s of what this end sends. receives: kinds that it takes.
    handle: called with each event, on the event loop. It must not block.
    want_key: called when the partner needs a key picture, as it does at first.
    most_bps: of the partner's picture.
    """

    def __init__(
        self,
        *,
        clock: MonotonicClock,
        sends: dict[Kind, int],
        receives: Sequence[Kind] = (),
        handle: Callable[[Event], None] = lambda _: None,
        want_key: Callable[[], None] = lambda: None,
        servers: IceServers | None = None,
        most_bps: int = 1_500_000,
        offers: bool = True,
    ) -> None:
        self._clock, self._sends, self._receives = clock, dict(sends), tuple(receives)
        self._handle, self._want_key, self._most_bps = handle, want_key, most_bps
        self._session = secrets.randbits(62)
        self._cname, self._stream = secrets.token_hex(8), secrets.token_hex(8)
        self._ssrcs: dict[Kind, int] = {
            kind: secrets.randbits(31) + 1 for kind in ("audio", "video")
        }
        self._transport = RtcTransport(
            controlling=offers,
            servers=servers or IceServers(),
            handle_rtp=self._handle_rtp,
            handle_rtcp=self._handle_rtcp,
        )
        self._local: Transport | None = None
        self._offered: list[MediaLine] = []
        self._wake = asyncio.Event()
        self._restarting: asyncio.Future[None] | None = None
        self._connecting: tuple[Transport, str] | None = None
        self.media: RtcMedia | None = None
        self.connected = False
        self.closed = False
        #: Why it has ended; "" while it has not, or if it was closed here.
        self.fault = ""

    @property
    def route(self) -> Route | None:
        """The pair of addresses in use; None while there is none."""
        return self._transport.route

    @property
    def restarts(self) -> int:
        return self._transport.restarts

    @property
    def peer_ufrag(self) -> str:
        """ICE's user name of the partner; "" before the descriptions were exchanged."""
        return "" if self._connecting is None else self._connecting[0].ufrag

    @property
    def is_silent(self) -> bool:
        """Whether nothing has come from the partner for seconds, or there is no way to it."""
        silent = self.media is not None and self.media.is_silent(self._clock.now_ns())
        return silent or self._transport.lost

    async def offer(self) -> str:
        self._local = await self._transport.gather()
        kinds: list[Kind] = [
            kind for kind in ("audio", "video") if kind in self._sends or kind in self._receives
        ]
        self._offered = [
            wanted_line(
                kind,
                mid=str(number),
                ssrc=self._ssrcs[kind],
                sends=kind in self._sends,
                receives=kind in self._receives,
            )
            for number, kind in enumerate(kinds)
        ]
        return self._write(self._offered, replace(self._local, role="auto"))

    async def accept(self, answer: str) -> None:
        """The partner has answered the offer. ProtocolError if the answer cannot be used."""
        said = read_description(answer, answers=True, ssrcs=self._ssrcs)
        lines = []
        for line in said.lines:
            wanted = next((one for one in self._offered if one.mid == line.mid), None)
            if wanted is None or wanted.kind != line.kind:
                words = f"an answer with the section {line.mid!r}, which was not offered"
                raise ProtocolError(words)
            common = common_line(line, sends=wanted.sends, receives=wanted.receives)
            lines += [] if common is None else [common]
        self._begin(lines, said.transport)

    async def answer(self, offer: str) -> str:
        """Return the answer to a partner's offer. ProtocolError if the offer cannot be used."""
        said = read_description(offer, answers=False, ssrcs=self._ssrcs)
        lines = common_lines(said.lines, sends=self._sends, receives=self._receives)
        if not lines:
            raise NotAcceptableError("an offer of nothing that is wanted here")
        self._local = await self._transport.gather()
        role = self._begin(lines, said.transport)
        return self._write(lines, replace(self._local, role=role), answers=said)

    async def restart(self, peer: Transport | None = None) -> Transport:
        """Gather new addresses, for a restart of ICE; what to tell the partner.

        peer: the partner's new ones, if it began; else call `finish_restart` with them.
        """
        local = await self._transport.begin_restart()
        self._local = local
        if peer is not None:
            self._restarting = asyncio.ensure_future(self._finish_quietly(peer))
        return local

    async def finish_restart(self, peer: Transport) -> None:
        """The partner's new addresses. ConnectionError if no way is found; the old way stays."""
        await self._transport.finish_restart(peer)

    async def add_candidates(self, told: Transport) -> None:
        await self._transport.add_candidates(told.candidates, last=told.complete)

    def send_unit(self, unit: AccessUnit) -> None:
        if self.media is not None and self.connected:
            self.media.send_unit(unit, self._clock.now_ns())
            self._wake.set()

    def send_opus(self, opus: bytes, stamp: CaptureStamp) -> None:
        if self.media is not None and self.connected:
            self.media.send_opus(opus, stamp, self._clock.now_ns())
            self._wake.set()

    async def run(self) -> None:
        """Connect, and send and receive until the connection ends. It raises nothing of a peer."""
        if self._connecting is None or self.media is None:
            raise ValueError("no descriptions were exchanged")
        try:
            await self._transport.connect(self._connecting[0], role=self._connecting[1])
        except ConnectionError as error:
            self.fault = str(error)
            await self.close()
            return
        self.connected = True
        while not self.closed and self._transport.state == "connected":
            await self._step(self.media)
        self.connected = False
        await self.close()

    async def close(self) -> None:
        """End the connection; it may be called twice."""
        if self.closed:
            return
        self.closed = True
        self._wake.set()
        if self.connected and self.media is not None:
            for said in self.media.goodbye(self._clock.now_ns()):
                await self._transport.send(said)
        await self._transport.close()

    async def _step(self, media: RtcMedia) -> None:
        now_ns = self._clock.now_ns()
        media.handle_timeout(now_ns)
        while (event := media.next_event()) is not None:
            self._handle(event)
        if media.take_key_request(now_ns):
            self._want_key()
        while (datagram := media.poll_transmit(self._clock.now_ns())) is not None:
            await self._transport.send(datagram)
        wait_s = (media.poll_timeout(now_ns) - self._clock.now_ns()) / NS_PER_S
        self._wake.clear()
        if wait_s > 0:
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()
        else:
            # The loop's other work goes on.
            await asyncio.sleep(0)

    def _begin(self, lines: list[MediaLine], peer: Transport) -> str:
        """Make the media; return this end's role in the DTLS handshake."""
        # The partner's choice if it made one; else it waits and this end begins.
        role = "server" if peer.role == "client" else "client"
        self._connecting = peer, role
        self.media = RtcMedia(
            lines,
            randbits=secrets.randbits,
            bps=self._sends,
            most_bps=self._most_bps,
            cname=self._cname,
            wall_offset_ns=self._clock.wall_offset_ns,
        )
        return role

    def _write(self, lines: list[MediaLine], local: Transport, answers: Offer | None = None) -> str:
        return write_description(
            lines,
            local,
            session=self._session,
            cname=self._cname,
            stream=self._stream,
            answers=answers,
        )

    async def _finish_quietly(self, peer: Transport) -> None:
        # The partner begins anew if it wants to.
        with suppress(ConnectionError):
            await self._transport.finish_restart(peer)

    def _handle_rtp(self, packet: bytes) -> None:
        if self.media is not None:
            self.media.handle_rtp(packet, self._clock.now_ns())
            self._wake.set()

    def _handle_rtcp(self, datagram: bytes) -> None:
        if self.media is not None:
            self.media.handle_rtcp(datagram, self._clock.now_ns())
            self._wake.set()


class Programme:
    """A picture with its voice, sent to each of its peers.

    name: in its address. sends: by kind, the usual bit/s.
    want_key: called with a peer that needs a key picture.
    """

    def __init__(
        self, name: str, *, sends: dict[Kind, int], want_key: Callable[[RtcPeer], None]
    ) -> None:
        self.name, self.sends, self.want_key = name, sends, want_key
        self.peers: set[RtcPeer] = set()

    def send_unit(self, unit: AccessUnit) -> None:
        for peer in self.peers:
            peer.send_unit(unit)

    def send_opus(self, opus: bytes, stamp: CaptureStamp) -> None:
        for peer in self.peers:
            peer.send_opus(opus, stamp)

    @property
    def requested_bps(self) -> int | None:
        """The lowest rate that a peer says it can take; None if none says any."""
        requests = [peer.media.requested_bps for peer in self.peers if peer.media is not None]
        return min((request for request in requests if request is not None), default=None)


class ReceivedKind(Report, frozen=True, kw_only=True):
    """A picture or a voice that came: how much was decoded, and how old it was then."""

    decoded: int
    latency_ms: Latency | None


class RtcStream(Report, frozen=True, kw_only=True):
    """One stream of a connection; what the other end tells stands under `remote_`."""

    packets: int
    octets: int
    lost: int
    round_trip_ms: float | None = None
    keys_asked: int = 0
    nacks: int = 0
    repeated: int = 0
    dropped: int = 0
    rate_told_bps: int | None = None


class RtcConnection(Report, frozen=True, kw_only=True):
    """A connection; `route` is how its addresses were found: host, srflx, prflx or relay."""

    route: str | None
    ice_restarts: int
    sent: dict[str, RtcStream]
    received: dict[str, RtcStream]
    garbage: int


class RtcCommandReport(Report, frozen=True, kw_only=True):
    """The report of a command that speaks WebRTC; `failed` says what went wrong."""

    seconds: float
    connections: int
    ice_restarts: int
    last: RtcConnection | None
    pictures: ReceivedKind | None = None
    voice: ReceivedKind | None = None
    coded: dict[str, int]
    rate_bps: int | None = None
    cpu_s: float
    failed: list[str]


def connection_report(peer: RtcPeer) -> RtcConnection | None:
    """Return the figures of a connection; None before its descriptions were exchanged."""
    if peer.media is None:
        return None
    route, metrics = peer.route, peer.media.metrics
    return RtcConnection(
        route=None if route is None else str(route),
        ice_restarts=peer.restarts,
        sent=_streams(metrics.sent),
        received=_streams(metrics.received),
        garbage=metrics.garbage,
    )


def _streams(metrics: dict[Kind, TrackMetrics]) -> dict[str, RtcStream]:
    found = {}
    for kind, one in metrics.items():
        trip_ns = None if one.reception is None else one.reception.round_trip_ns
        found[str(kind)] = RtcStream(
            packets=one.packets,
            octets=one.octets,
            lost=one.lost,
            round_trip_ms=None if trip_ns is None else trip_ns / NS_PER_MS,
            keys_asked=one.keys_asked,
            nacks=one.asked,
            repeated=one.repeated,
            dropped=one.dropped,
            rate_told_bps=one.requested_bps,
        )
    return found
