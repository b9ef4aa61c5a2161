"""UDP sockets of a stream's two ends: RTP on one port, RTCP on the next (RFC 3550 section 11)."""

import ipaddress
import select
import socket
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.rtp.rtcp import is_rtcp
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_receiver import VoiceReceiver
from kontur_av.streams.voice_sender import VoiceSender

_FEEDBACK_OCTETS = 1500
_RECEIVE_BUFFER_OCTETS = 1 << 20
#: MCAST_JOIN_GROUP and MCAST_JOIN_SOURCE_GROUP of Linux (RFC 3678), which Python does not name.
_JOIN, _JOIN_SOURCE = 42, 46

_Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class UdpSender:
    """Sends a stream to an IP address, and receives feedback. `close` it at the end.

    host: an IP address. port: of RTP; RTCP goes to the next one. Receivers send feedback to the
    address from which reports come.
    """

    def __init__(self, host: str, port: int) -> None:
        self._udp = socket.socket(
            socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM
        )
        self._to_rtp, self._to_rtcp = (host, port), (host, port + 1)
        #: Datagrams that the system refused.
        self.failed = 0

    def exchange(self, sender: VideoSender | VoiceSender, clock: Clock) -> None:
        """Pass feedback to `sender`, and send the packets that may leave now."""
        # An ICMP error of an earlier datagram is no feedback.
        with suppress(BlockingIOError, ConnectionError):
            while True:
                datagram = self._udp.recv(_FEEDBACK_OCTETS, socket.MSG_DONTWAIT)
                if isinstance(sender, VideoSender):
                    sender.handle_feedback(datagram, clock.now_ns())
        while (packet := sender.poll_transmit(clock.now_ns())) is not None:
            self._send(packet, self._to_rtp)
        report = sender.poll_report(clock.now_ns())
        if report is not None:
            self._send(report, self._to_rtcp)

    def say_goodbye(self, sender: VideoSender | VoiceSender, clock: Clock) -> None:
        """Tell the receiver that the stream has ended."""
        goodbye = sender.goodbye(clock.now_ns())
        if goodbye is not None:
            self._send(goodbye, self._to_rtcp)

    def close(self) -> None:
        """Close the socket."""
        self._udp.close()

    def _send(self, datagram: bytes, to: tuple[str, int]) -> None:
        try:
            self._udp.sendto(datagram, to)
        except OSError:
            # A network that goes down for a while is loss, and must not end the sender.
            self.failed += 1


class UdpReceiver:
    """Receives a stream, and sends feedback. `close` it at the end.

    host: the IP address to which the stream is sent, as in the SDP. A loopback address is bound
        alone; a multicast group is joined, also by several receivers; any other address binds all.
    port: of RTP. Reports that come there are taken, too (RFC 5761).
    control_port: of RTCP; None: the next port. It may be that of RTP.
    sources: the only senders of a multicast group (RFC 4570); empty: any.

    Raises ConfigError if a port cannot be opened.
    """

    def __init__(
        self,
        host: str,
        port: int,
        control_port: int | None = None,
        sources: Sequence[str] = (),
    ) -> None:
        self._rtp = self._rtcp = _bound(host, port, sources)
        if control_port != port:
            reports = port + 1 if control_port is None else control_port
            try:
                self._rtcp = _bound(host, reports, sources)
            except ConfigError:
                self._rtp.close()
                raise
        #: Where the sender's reports come from, and on which socket: feedback goes there.
        self._sender: tuple[socket.socket, Any] | None = None

    @property
    def sockets(self) -> set[socket.socket]:
        """The sockets of RTP and RTCP, for a caller that also waits for others."""
        return {self._rtp, self._rtcp}

    @property
    def reported(self) -> bool:
        """Whether a report of the sender has come."""
        return self._sender is not None

    def exchange(
        self, receiver: VideoReceiver | VoiceReceiver, clock: Clock, timeout_ns: int = 0
    ) -> None:
        """Send feedback, wait for datagrams, and pass them to `receiver`.

        It returns after `timeout_ns` or at the receiver's own timeout at the latest. Drain the
        receiver's `next_event` afterwards.
        """
        self._answer(receiver, clock)
        due_ns = receiver.poll_timeout()
        if due_ns is not None:
            timeout_ns = min(timeout_ns, max(due_ns - clock.now_ns(), 0))
        if timeout_ns > 0:
            select.select(self.sockets, (), (), timeout_ns / NS_PER_S)
        # RTP first: a goodbye that waits, too, ends what waits before it.
        for udp in (self._rtp, self._rtcp):
            for datagram, source in _datagrams(udp):
                if udp is self._rtp and not is_rtcp(datagram):
                    receiver.handle_packet(datagram, clock.now_ns(), source)
                elif receiver.handle_report(datagram, clock.now_ns()):
                    self._sender = udp, source
        receiver.handle_timeout(clock.now_ns())

    def close(self) -> None:
        """Close the sockets."""
        self._rtp.close()
        self._rtcp.close()

    def _answer(self, receiver: VideoReceiver | VoiceReceiver, clock: Clock) -> None:
        # Without a report of the sender, nobody is known who would read it.
        while (feedback := receiver.poll_feedback(clock.now_ns())) is not None:
            if self._sender is not None:
                udp, source = self._sender
                with suppress(OSError):
                    udp.sendto(feedback, source)


def _bound(host: str, port: int, sources: Sequence[str]) -> socket.socket:
    address = ipaddress.ip_address(host)
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    udp = socket.socket(family, socket.SOCK_DGRAM)
    try:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_OCTETS)
        udp.setblocking(False)
        if address.is_multicast:
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if host == "::":
            # IPv4, too, whatever the system's default is.
            udp.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        # Another address in the SDP need not be one of this machine. A group of IPv6 may need an
        # interface, which the SDP does not name.
        alone = address.is_loopback or (address.is_multicast and address.version == 4)
        udp.bind((host if alone else "", port))
        if address.is_multicast:
            _join(udp, address, [ipaddress.ip_address(source) for source in sources])
    except OSError as error:
        udp.close()
        raise ConfigError(
            f"UDP port {port} cannot be opened ({error.strerror}): end the program that uses it, "
            "or choose another port in the SDP"
        ) from None
    return udp


def _join(udp: socket.socket, group: _Address, sources: Sequence[_Address]) -> None:
    """Join a group on all interfaces, since the way to its sender need not be that to the Internet.

    sources: its only senders; empty: any. Raises OSError if no interface can join.
    """
    level = socket.IPPROTO_IP if group.version == 4 else socket.IPPROTO_IPV6
    wanted = [source for source in sources if source.version == group.version]
    refused, joined = OSError("no network interface"), False
    for index, _ in socket.if_nameindex():
        head = struct.pack("@I4x", index) + _packed(group)
        for option, tail in [(_JOIN_SOURCE, _packed(one)) for one in wanted] or [(_JOIN, b"")]:
            try:
                udp.setsockopt(level, option, head + tail)
                joined = True
            except OSError as error:
                # An interface without multicast, or more of them than a socket may join on.
                refused = error
    if not joined:
        raise refused


def _packed(address: _Address) -> bytes:
    """Return the address as a sockaddr_storage."""
    if address.version == 4:
        return struct.pack("@HH4s120x", socket.AF_INET, 0, address.packed)
    return struct.pack("@HHI16s104x", socket.AF_INET6, 0, 0, address.packed)


def _datagrams(udp: socket.socket) -> Iterator[tuple[bytes, Any]]:
    """Yield waiting datagrams and their sources, at most 256, so that timeouts stay exact."""
    with suppress(BlockingIOError):
        for _ in range(256):
            yield udp.recvfrom(65_536)
