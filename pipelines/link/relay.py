"""A relay between two ends that does to their datagrams what a network does. A shell."""

import select
from collections.abc import Callable
from contextlib import suppress
from socket import AF_INET6

from kontur_av.clock import NS_PER_S
from kontur_av.hosts import host_port
from pipelines.session.datagrams import LOOPBACK, Address, family_of, listen
from telepresence.link.radio.network import NetworkPath

_MOST_OCTETS = 2048
#: The longest sleep, so that a request to stop is seen.
_LOOK_NS = 50_000_000


class PathRelay:
    """Stands for the listening end: the calling end calls `address` in its place.

    target: the listening end. out, back: what happens to datagrams to it and from it. front: where
    it is called. Raises OSError for an address that is busy or not here.
    """

    def __init__(
        self,
        target: Address,
        out: NetworkPath,
        back: NetworkPath,
        clock_ns: Callable[[], int],
        *,
        front: Address = (LOOPBACK, 0),
    ) -> None:
        self._front = listen(front)
        self._rear = listen(("::" if family_of(target[0]) == AF_INET6 else "0.0.0.0", 0))
        self.address = host_port(self._front.getsockname())
        self._out, self._back, self._clock_ns = out, back, clock_ns
        self._target, self._caller = target, None

    def run(self, stopping: Callable[[], bool]) -> None:
        """Carry datagrams until `stopping`; then close the sockets."""
        while not stopping():
            due = (way.poll_timeout() for way in (self._out, self._back))
            now_ns = self._clock_ns()
            wait_ns = min((at - now_ns for at in due if at is not None), default=_LOOK_NS)
            wait_s = min(max(wait_ns, 0), _LOOK_NS) / NS_PER_S
            ready = select.select((self._front, self._rear), (), (), wait_s)[0]
            # What a network cannot carry on is lost.
            with suppress(OSError):
                self._carry(self._front in ready, self._rear in ready)
        self._front.close()
        self._rear.close()

    def _carry(self, called: bool, answered: bool) -> None:
        now_ns = self._clock_ns()
        if called:
            datagram, self._caller = self._front.recvfrom(_MOST_OCTETS)
            self._out.handle_datagram(datagram, now_ns)
        if answered:
            self._back.handle_datagram(self._rear.recv(_MOST_OCTETS), now_ns)
        while (outgoing := self._out.poll_transmit(now_ns)) is not None:
            self._rear.sendto(outgoing, self._target)
        while self._caller and (incoming := self._back.poll_transmit(now_ns)) is not None:
            self._front.sendto(incoming, self._caller)
