"""The way from a joystick to a robot across the Internet: a process of its own with the WebRTC.

The joystick's loop of 1 kHz and an event loop would wait for each other in one interpreter. Both
processes hand each other samples by a pair of Unix sockets, which nobody else reaches.
"""

import asyncio
import multiprocessing
import signal
import socket
from collections.abc import Callable
from contextlib import closing, suppress
from typing import Self
from urllib.parse import urlsplit

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.commands.rtc_running import say
from pipelines.partner.decisions import Attempts
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.samples import SamplePeer
from pipelines.partner.whip import WhipClient
from pipelines.session.datagrams import Outlet, newest_sample

_LOOK_S, _END_S = 0.1, 3.0


class Far:
    """A robot that a partner reaches by WebRTC. A context manager.

    own: on which its samples come. to_robot: where samples for it go.
    url: `https://HOST:PORT`. token: of the address. servers: for the way through NAT.
    Raises ConfigError for a malformed address.
    """

    def __init__(self, url: str, token: str, servers: Callable[[], IceServers]) -> None:
        address = _endpoint(url)
        self.own, self._beyond = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.own.setblocking(False)
        self._beyond.setblocking(False)
        self.to_robot = Outlet(self.own)
        self._process = multiprocessing.get_context("fork").Process(
            target=_relay, args=(address, token, servers, self._beyond)
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
    url: str, token: str, servers: Callable[[], IceServers], joystick: socket.socket
) -> None:
    # Ctrl-C goes to both; the joystick's process ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with closing(joystick):
        try:
            asyncio.run(_keep(url, token, servers, joystick))
        except ConfigError as error:
            say(f"joystick: {error}")


async def _keep(
    url: str, token: str, servers: Callable[[], IceServers], joystick: socket.socket
) -> None:
    """Connect, and connect again whenever the connection has ended."""
    clock, attempts, loop = MonotonicClock(), Attempts(), asyncio.get_running_loop()
    stop, present = asyncio.Event(), list[SamplePeer]()
    to_joystick = Outlet(joystick)
    loop.add_signal_handler(signal.SIGTERM, stop.set)

    def forward() -> None:
        newest = newest_sample(joystick)
        if newest is not None:
            for peer in present:
                peer.send(newest)

    loop.add_reader(joystick, forward)
    while not stop.is_set():
        if attempts.poll_connect(clock.now_ns()):
            fault = ""
            try:
                fault = await _connection(
                    url, token, servers(), to_joystick, stop, present, attempts, clock
                )
            except ConfigError:
                if not attempts.stood:
                    raise
            except (ConnectionError, ProtocolError) as error:
                fault = str(error)
            attempts.handle_ended(clock.now_ns())
            if not stop.is_set():
                say(f"joystick: no connection: {fault or 'it has ended'}")
        with suppress(TimeoutError):
            async with asyncio.timeout(_LOOK_S):
                await stop.wait()


async def _connection(
    url: str,
    token: str,
    servers: IceServers,
    to_joystick: Outlet,
    stop: asyncio.Event,
    present: list[SamplePeer],
    attempts: Attempts,
    clock: MonotonicClock,
) -> str:
    """One connection, from its offer to its end; why it has ended."""
    async with WhipClient(url, token=token) as client:
        if not servers.servers:
            named = await client.ice_servers()
            servers = IceServers(servers=named, relay_only=servers.relay_only)
        peer = SamplePeer(servers, to_joystick.send)
        try:
            await peer.accept(await client.post(await peer.offer()))
            running = asyncio.create_task(peer.run())
            while not stop.is_set() and not running.done():
                if peer.connected and not present:
                    attempts.handle_connected(clock.now_ns())
                    present.append(peer)
                    say("joystick: connected to the robot's site")
                await asyncio.wait([running], timeout=_LOOK_S)
        finally:
            present.clear()
            await peer.close()
        return peer.fault
