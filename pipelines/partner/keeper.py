"""Keeps one connection to a media server, by WHIP or WHEP, for as long as it is wanted. A shell."""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from kontur_av.clock import Clock
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.partner.attempts import Attempts, Doing
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import RtcPeer
from pipelines.partner.whip import WhipClient

_LOOK_S = 0.25


class Keeper:
    """Connects to a server, restarts ICE when nothing comes any more, and connects again.

    url, token: as of `WhipClient`. make_peer: called with the ICE servers of each connection.
    servers: called for our own ICE servers; without any, the server is asked for some.
    told: called with one line at each change.
    """

    def __init__(
        self,
        url: str,
        *,
        token: str,
        make_peer: Callable[[IceServers], RtcPeer],
        servers: Callable[[], IceServers],
        clock: Clock,
        told: Callable[[str], None] = lambda _: None,
    ) -> None:
        # A wrong address is refused here and now.
        WhipClient(url, token=token)
        self._url, self._token = url, token
        self._make_peer, self._servers = make_peer, servers
        self._clock, self._told = clock, told
        self.attempts = Attempts()
        #: The present connection; None while there is none.
        self.peer: RtcPeer | None = None
        #: Why the last connection ended.
        self.fault = ""
        self._stopping = False

    def stop(self) -> None:
        """Let `run` end soon."""
        self._stopping = True

    async def run(self) -> None:
        """Keep the connection until `stop`.

        Raises ConfigError for what trying again does not mend, unless a connection stood before.
        """
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
                    self.peer = None
            self.attempts.handle_ended(self._clock.now_ns())
            if not self._stopping:
                self._told(f"no connection: {self.fault or 'it has ended'}")

    async def _connection(self) -> None:
        async with WhipClient(self._url, token=self._token) as client:
            servers = self._servers()
            if not servers.servers:
                servers = IceServers(
                    servers=await client.ice_servers(), relay_only=servers.relay_only
                )
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

    async def _look(self, client: WhipClient, peer: RtcPeer) -> None:
        now_ns = self._clock.now_ns()
        if peer.connected and self.attempts.doing is Doing.CONNECTING:
            self.attempts.handle_connected(now_ns)
            route = peer.route
            way = "" if route is None else f" by {route.local} to {route.remote}"
            self._told(f"connected{way}")
        if self.attempts.is_hopeless(now_ns):
            self.fault = "nothing came for seconds, also after a restart of ICE"
            await peer.close()
        elif self.attempts.poll_restart(silent=peer.is_silent, now_ns=now_ns):
            self._told("nothing comes any more: ICE begins anew")
            with suppress(ConnectionError, ProtocolError, ConfigError, TimeoutError):
                async with asyncio.timeout(5):
                    local = await peer.restart()
                    await peer.finish_restart(await client.restart(local))
