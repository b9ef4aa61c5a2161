"""The way of a joystick or robot to a session across the Internet: a process with the WebRTC.

Their loop of 1 kHz and an event loop would wait for each other in one interpreter. Both
processes hand each other samples by a pair of Unix sockets, which nobody else reaches.
"""

import asyncio
import multiprocessing
import signal
import socket
from collections.abc import Callable
from contextlib import closing
from typing import Self
from urllib.parse import urlsplit

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.partner.decisions import Doing
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.samples import SamplePeer
from pipelines.partner.whip import Keeper
from pipelines.session.datagrams import Outlet, newest_sample
from pipelines.session.output import say

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
    # Ctrl-C goes to both; the loop's process ends this one.
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
