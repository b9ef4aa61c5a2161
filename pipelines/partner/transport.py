"""The way to a partner: ICE, DTLS and SRTP, by aioice and aiortc. A shell.

`RTCPeerConnection` of aiortc decodes each picture in a thread and waits for more before it does; it
takes no packets. So this module joins the parts below it: the ICE of aioice, and the DTLS transport
of aiortc, which is handed our own path and hands over decrypted packets. It can begin ICE anew
under the same keys, which `RTCPeerConnection` cannot.
"""

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

from aioice import Candidate, Connection, TransportPolicy
from aiortc import (
    RTCCertificate,
    RTCDtlsFingerprint,
    RTCDtlsParameters,
    RTCDtlsTransport,
    RTCIceCandidate,
    RTCIceTransport,
)
from aiortc.rtcicetransport import candidate_from_aioice, candidate_to_aioice, connection_kwargs
from OpenSSL import SSL

from kontur_av.errors import ConfigError
from pipelines.partner.description import Transport
from pipelines.partner.ice_servers import IceServers

_log = logging.getLogger(__name__)
#: The most decrypted datagrams that wait for the event loop; the oldest is dropped.
_MOST_WAITING = 512
#: The longest that gathering of candidates may take: a server may be silent.
_GATHER_S = 5.0
_CONNECT_S = 20.0
#: Those that WebRTC recommends (RFC 8827 section 6.5), for keys of both kinds.
_SUITES = b":".join(
    b"ECDHE-%s-%s" % (key, cipher)
    for cipher in (b"AES128-GCM-SHA256", b"CHACHA20-POLY1305", b"AES128-SHA", b"AES256-SHA")
    for key in (b"ECDSA", b"RSA")
)
#: A relay that is out of reach is told about the end for half a minute, which nobody waits for.
_END_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """The pair of candidates in use. local, remote: "host", "srflx", "prflx" or "relay"."""

    local: str
    remote: str
    remote_port: int

    def __str__(self) -> str:
        return f"{self.local} to {self.remote}"


class _Path:
    """What aiortc's DTLS transport sends on and receives from, over changing ICE connections."""

    def __init__(self) -> None:
        self._connection: Connection | None = None
        self._pump: asyncio.Task[None] | None = None
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue()
        self._closed = False
        self.dropped = 0
        #: Whether the partner no longer agrees to receive by the present way (RFC 7675).
        self.lost = False

    @property
    def role(self) -> str:
        controlling = self._connection is not None and self._connection.ice_controlling
        return "controlling" if controlling else "controlled"

    def use(self, connection: Connection) -> None:
        """Send by this connection from now on, and receive from it, too.

        ConnectionError if the path was closed meanwhile.
        """
        if self._closed:
            raise ConnectionError("the path is closed")
        self._connection, self.lost = connection, False
        if self._pump is not None:
            self._pump.cancel()
        self._pump = asyncio.ensure_future(self._receive(connection))

    def close(self) -> None:
        self._closed = True
        if self._pump is not None:
            self._pump.cancel()
        self._waiting.put_nowait(None)

    async def _receive(self, connection: Connection) -> None:
        try:
            while True:
                data = await connection.recv()
                if self._waiting.qsize() >= _MOST_WAITING:
                    self._waiting.get_nowait()
                    self.dropped += 1
                # aiortc reads the first octet unchecked.
                if data:
                    self._waiting.put_nowait(data)
        except asyncio.CancelledError:
            raise
        except Exception as error:
            # Another connection may take its place; its owner decides that. aioice raises more
            # than ConnectionError for what a peer sends.
            if not isinstance(error, ConnectionError):
                _log.warning("the way to a partner ended: %r", error)
            self.lost = True

    async def _recv(self) -> bytes:
        data = await self._waiting.get()
        if data is None:
            raise ConnectionError("the path is closed")
        return data

    async def _send(self, data: bytes) -> None:
        if self._closed:
            raise ConnectionError("the path is closed")
        if self._connection is not None:
            try:
                await self._connection.send(data)
            except (ConnectionError, OSError):
                # A way that is broken for a while is loss.
                self.dropped += 1


class _Certificate(RTCCertificate):
    """aiortc's, for partners with a key of RSA, too, such as GStreamer's webrtcbin.

    aiortc offers suites for keys of ECDSA only, so a DTLS server with another one shares none.
    """

    def _create_ssl_context(self, srtp_profiles: list[Any]) -> SSL.Context:
        context = super()._create_ssl_context(srtp_profiles)
        context.set_cipher_list(_SUITES)
        return context


class _Dtls(RTCDtlsTransport):
    """aiortc's transport, which hands over packets in the place of routing them."""

    def __init__(
        self,
        path: _Path,
        certificate: RTCCertificate,
        handle_rtp: Callable[[bytes], None],
        handle_rtcp: Callable[[bytes], None],
    ) -> None:
        super().__init__(cast(RTCIceTransport, path), [certificate])
        self._take_rtp, self._take_rtcp = handle_rtp, handle_rtcp

    async def _handle_rtp_data(self, data: bytes, arrival_time_ms: int) -> None:
        self._take_rtp(data)

    async def _handle_rtcp_data(self, data: bytes) -> None:
        self._take_rtcp(data)

    async def send_packet(self, data: bytes) -> None:
        """Encrypt and send an RTP or RTCP packet; ConnectionError while there is no way."""
        await self._send_rtp(data)


class RtcTransport:
    """One encrypted way to a partner, which may change its addresses.

    1. `gather` and tell the partner the `local` part. 2. `connect` with the partner's. 3. `send`.

    controlling: this end decides between ways (RFC 8445): the end that offers.
    handle_rtp, handle_rtcp: called with each decrypted packet.
    """

    def __init__(
        self,
        *,
        controlling: bool,
        servers: IceServers,
        handle_rtp: Callable[[bytes], None],
        handle_rtcp: Callable[[bytes], None],
    ) -> None:
        servers.check()
        self._controlling, self._servers = controlling, servers
        self._certificate = _Certificate.generateCertificate()
        self._path = _Path()
        self._dtls = _Dtls(self._path, self._certificate, handle_rtp, handle_rtcp)
        self._connection = self._new_connection()
        self._next: Connection | None = None
        self._route: Route | None = None
        self.restarts = 0

    @property
    def state(self) -> str:
        """Of DTLS: "new", "connecting", "connected", "closed" or "failed"."""
        return self._dtls.state

    @property
    def lost(self) -> bool:
        """Whether the way to the partner is gone, until a restart finds another one."""
        return self._path.lost

    @property
    def route(self) -> Route | None:
        """The pair of candidates in use, or last in use; None before the first."""
        # aioice names the pair only here.
        pair: Any = getattr(self._connection, "_nominated", {}).get(1)
        if pair is not None:
            local, remote = pair.local_candidate.type, pair.remote_candidate
            self._route = Route(local=local, remote=remote.type, remote_port=remote.port)
        return self._route

    async def gather(self) -> Transport:
        """Gather addresses of this end; what to tell the partner.

        ConfigError if there is none: with `relay_only` and a server that refuses.
        """
        return await self._gather(self._connection)

    async def connect(self, peer: Transport, *, role: str) -> None:
        """Find a way to the partner, and agree on keys. role: "client" or "server" in DTLS.

        Raises ConnectionError if it fails.
        """
        await self._find_way(self._connection, peer)
        self._path.use(self._connection)
        self._dtls._set_role(role)
        parameters = RTCDtlsParameters(
            fingerprints=[
                RTCDtlsFingerprint(algorithm=algorithm, value=value)
                for algorithm, value in peer.fingerprints
            ]
        )
        try:
            await asyncio.wait_for(self._dtls.start(parameters), _CONNECT_S)
        except TimeoutError:
            raise ConnectionError("no DTLS handshake with the partner") from None
        if self.state != "connected":
            raise ConnectionError("the DTLS handshake with the partner failed")

    async def begin_restart(self) -> Transport:
        """Gather addresses anew; what to tell the partner (RFC 8445 section 9)."""
        await self._drop_next()
        self._next = self._new_connection()
        return await self._gather(self._next)

    async def finish_restart(self, peer: Transport) -> None:
        """Go over to the new addresses. Raises ConnectionError if they fail; the old ones stay."""
        connection, self._next = self._next, None
        if connection is None:
            raise ConnectionError("no restart of ICE has begun")
        try:
            await self._find_way(connection, peer)
            self._path.use(connection)
        except ConnectionError:
            await _end(connection)
            raise
        old, self._connection = self._connection, connection
        self.restarts += 1
        await _end(old)

    async def add_candidates(self, candidates: tuple[RTCIceCandidate, ...], *, last: bool) -> None:
        await _add(self._next or self._connection, candidates, last=last)

    async def send(self, packet: bytes) -> bool:
        """Encrypt and send a packet of RTP or RTCP; False if there is no way to the partner."""
        try:
            await self._dtls.send_packet(packet)
        except ConnectionError:
            return False
        return True

    async def close(self) -> None:
        try:
            await self._dtls.stop()
        finally:
            self._path.close()
        await self._drop_next()
        await _end(self._connection)

    def _new_connection(self) -> Connection:
        relay = self._servers.relay_only
        return Connection(
            ice_controlling=self._controlling,
            transport_policy=TransportPolicy.RELAY if relay else TransportPolicy.ALL,
            **connection_kwargs(self._servers.for_aiortc()),
        )

    async def _gather(self, connection: Connection) -> Transport:
        try:
            await asyncio.wait_for(connection.gather_candidates(), _GATHER_S)
        except TimeoutError:
            _log.warning("gathering of ICE candidates takes more than %g s", _GATHER_S)
        candidates = tuple(candidate_from_aioice(one) for one in connection.local_candidates)
        if not candidates:
            raise ConfigError(
                "no address for WebRTC: look at --ice-server and its credentials, or leave out "
                "--ice-relay-only"
                if self._servers.relay_only
                else "no address for WebRTC: this host has loopback only; connect it to a network"
            )
        return Transport(
            ufrag=connection.local_username,
            password=connection.local_password,
            candidates=candidates,
            fingerprints=tuple(
                (one.algorithm, one.value) for one in self._certificate.getFingerprints()
            ),
        )

    async def _find_way(self, connection: Connection, peer: Transport) -> None:
        connection.remote_is_lite = peer.lite
        connection.remote_username, connection.remote_password = peer.ufrag, peer.password
        await _add(connection, peer.candidates, last=peer.complete)
        try:
            await asyncio.wait_for(connection.connect(), _CONNECT_S)
        except TimeoutError:
            raise ConnectionError("no way to the partner by ICE") from None

    async def _drop_next(self) -> None:
        if self._next is not None:
            connection, self._next = self._next, None
            await _end(connection)


async def _end(connection: Connection) -> None:
    """Close a connection; what is told to its relay goes on meanwhile."""
    with suppress(TimeoutError):
        await asyncio.wait_for(connection.close(), _END_S)


async def _add(
    connection: Connection, candidates: tuple[RTCIceCandidate, ...], *, last: bool
) -> None:
    told: list[Candidate | None] = [
        candidate_to_aioice(one)
        for one in candidates
        # aioice takes UDP only; a browser also tells its TCP ports.
        if one.component == 1 and one.protocol.lower() == "udp"
    ]
    if last:
        told.append(None)
    for candidate in told:
        # It may come after the last one.
        with suppress(ValueError):
            await connection.add_remote_candidate(candidate)
