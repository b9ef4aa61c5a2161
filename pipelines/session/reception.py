"""The common part of receiving processes: sockets and the kept sender report."""

import select
from typing import Protocol

from kontur_av.clock import NS_PER_S
from kontur_av.topics.session_files import remember, session_root
from pipelines.session.datagrams import receive
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.setup.table import VideoStream, VoiceStream


class Receiving(Protocol):
    """A receiver of a stream's datagrams."""

    def handle_packet(self, datagram: bytes, now_ns: int) -> None: ...

    def handle_report(self, datagram: bytes, now_ns: int) -> bool: ...


class Incoming:
    """A stream's sockets, and its receiver fed from them.

    The newest sender report is kept in the session's directory. Without it, a restarted receiver
    could not date its pictures, and would show none until the next report.
    """

    def __init__(
        self, context: Context, stream: VideoStream | VoiceStream, receiver: Receiving
    ) -> None:
        topology = context.topology
        self._clock = context.clock
        self._receiver = receiver
        self._rtp = context.listen_media(topology.exit_port(stream.name))
        self._rtcp = context.listen_media(topology.exit_port(topology.media(stream.name).rtcp))
        self._memory = session_root(context.session) / f"{stream.name}.report"
        if self._memory.exists():
            receiver.handle_report(self._memory.read_bytes(), self._clock.now_ns())

    def wait(self, due_ns: int | None) -> None:
        """Wait for datagrams, until `due_ns` at the latest, and pass them to the receiver."""
        wait_ns = PATIENCE_NS
        if due_ns is not None:
            wait_ns = min(PATIENCE_NS, max(0, due_ns - self._clock.now_ns()))
        ready = select.select((self._rtp, self._rtcp), (), (), wait_ns / NS_PER_S)[0]
        # Each datagram has its own stamp: one that comes during this loop must not seem to arrive
        # before it was sent. Reports are first, because the first of them dates the first picture.
        if self._rtcp in ready:
            while (datagram := receive(self._rtcp)) is not None:
                if self._receiver.handle_report(datagram, self._clock.now_ns()):
                    remember(self._memory, datagram)
        if self._rtp in ready:
            while (datagram := receive(self._rtp)) is not None:
                self._receiver.handle_packet(datagram, self._clock.now_ns())
