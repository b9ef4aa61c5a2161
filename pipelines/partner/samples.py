"""A partner's haptic samples by a data channel of WebRTC, and the robot's ports for them. A shell.

The channel neither repeats nor orders (RFC 8831: unordered, no retransmission), so a sample is late
by the network's own delay, or lost. A message is a sample in the haptic format, or the one octet
that tells the other end that this one is there, or that another has taken its place.
"""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress

from aiortc import (
    RTCConfiguration,
    RTCDataChannel,
    RTCIceTransportPolicy,
    RTCPeerConnection,
    RTCSessionDescription,
)
from aiortc.exceptions import InvalidAccessError, InvalidStateError

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.partner.description import MALFORMED, MOST_SDP_OCTETS
from pipelines.partner.ice_servers import IceServers
from pipelines.session.datagrams import OwnOutlet, listen_alone, newest_sample
from pipelines.session.process import Context
from pipelines.session.topology.streams import partner_ports
from telepresence.haptics.axes import may_be_sample

_LABEL = "haptics"
_HERE, _DISPLACED = b"\0", b"\1"
_PUBLISH_S, _SILENT_S, _CONNECT_S = 0.5, 4.0, 20.0
#: What aiortc raises for a description that it cannot use.
_UNUSABLE = (*MALFORMED, InvalidAccessError, InvalidStateError)


class SamplePeer:
    """One connection for samples, both ways.

    An offering end calls `offer` and then `accept`; an answering end calls `answer`. `run` waits
    until the connection ends; `close` ends it.

    handle: called with each sample that came, on the event loop. It must not block.
    """

    def __init__(self, servers: IceServers, handle: Callable[[bytes], None]) -> None:
        servers.check()
        relay = RTCIceTransportPolicy.RELAY if servers.relay_only else RTCIceTransportPolicy.ALL
        self._connection = RTCPeerConnection(
            RTCConfiguration(iceServers=servers.for_aiortc(), iceTransportPolicy=relay)
        )
        self._handle = handle
        self._channel: RTCDataChannel | None = None
        self._ended = asyncio.Event()
        self._heard_s = asyncio.get_running_loop().time()
        #: Whether another has taken its place: connecting again would only take it back.
        self.displaced = False
        self._connection.on("datachannel", self._take)
        self._connection.on("connectionstatechange", self._look)
        #: Samples that came and went, and those left out because the network was slower.
        self.received = self.sent = self.dropped = 0
        #: Messages that are neither sample nor greeting.
        self.garbage = 0
        #: Why it has ended; "" while it has not, or if it was closed here.
        self.fault = ""

    @property
    def connected(self) -> bool:
        return self._channel is not None and self._channel.readyState == "open"

    @property
    def heard_ns(self) -> int:
        """When something last came, on the monotonic clock."""
        return round(self._heard_s * NS_PER_S)

    async def displace(self) -> None:
        """Tell the other end that another takes its place, and close."""
        if self._channel is not None and self._channel.readyState == "open":
            self._channel.send(_DISPLACED)
            # `close` would drop what has not left yet.
            await asyncio.sleep(_PUBLISH_S)
        await self.close()

    async def offer(self) -> str:
        self._take(self._connection.createDataChannel(_LABEL, ordered=False, maxRetransmits=0))
        await self._connection.setLocalDescription(await self._connection.createOffer())
        return self._connection.localDescription.sdp

    async def accept(self, answer: str) -> None:
        """The other end has answered the offer. ProtocolError if the answer cannot be used."""
        await self._read(answer, "answer")

    async def answer(self, offer: str) -> str:
        """Return the answer to an offer. ProtocolError if the offer cannot be used."""
        await self._read(offer, "offer")
        await self._connection.setLocalDescription(await self._connection.createAnswer())
        return self._connection.localDescription.sdp

    def send(self, sample: bytes) -> None:
        """Send a sample, unless an earlier one still waits for the network."""
        channel = self._channel
        if channel is None or channel.readyState != "open" or channel.bufferedAmount:
            self.dropped += 1
            return
        channel.send(sample)
        self.sent += 1

    async def run(self) -> None:
        """Wait until the connection ends: it was closed, failed, or is silent for 4 s."""
        loop = asyncio.get_running_loop()
        began_s = self._heard_s = loop.time()
        stood = False
        while not self._ended.is_set():
            if self.connected:
                stood = True
                channel = self._channel
                if channel is not None and not channel.bufferedAmount:
                    channel.send(_HERE)
            if loop.time() - self._heard_s > (_SILENT_S if stood else _CONNECT_S):
                waited_s = loop.time() - (self._heard_s if stood else began_s)
                self.fault = f"nothing has come for {waited_s:.0f} s"
                break
            with suppress(TimeoutError):
                async with asyncio.timeout(_PUBLISH_S):
                    await self._ended.wait()
        await self.close()

    async def close(self) -> None:
        """End the connection; it may be called twice."""
        self._ended.set()
        await self._connection.close()

    async def _read(self, text: str, kind: str) -> None:
        sections = [line for line in text.splitlines() if line.startswith("m=")]
        if len(text) > MOST_SDP_OCTETS or len(sections) != 1:
            raise ProtocolError(f"an {kind} for samples has one section, the data channel's")
        if not sections[0].startswith("m=application "):
            raise ProtocolError(f"an {kind} without a data channel")
        with refused("not a session description", *_UNUSABLE, raising=ProtocolError):
            await self._connection.setRemoteDescription(RTCSessionDescription(text, kind))

    def _take(self, channel: RTCDataChannel) -> None:
        if self._channel is not None or channel.label != _LABEL:
            self.garbage += 1
            return
        self._channel = channel
        channel.on("message", self._message)
        channel.on("close", self._ended.set)

    def _message(self, data: object) -> None:
        self._heard_s = asyncio.get_running_loop().time()
        if isinstance(data, bytes) and may_be_sample(data):
            self.received += 1
            self._handle(data)
        elif data == _DISPLACED:
            self.displaced, self.fault = True, "another one has taken its place"
            self._ended.set()
        elif data != _HERE:
            self.garbage += 1

    def _look(self) -> None:
        if self._connection.connectionState in ("failed", "closed"):
            if self._connection.connectionState == "failed":
                self.fault = "no way to the other end by ICE"
            self._ended.set()


class SamplePorts:
    """Between one partner's data channel and the robot's ports of `docs/webrtc.md`.

    The port of the robot's samples is taken while a partner is there, so a joystick on this machine
    can have it otherwise.
    """

    def __init__(self, context: Context, loop: asyncio.AbstractEventLoop) -> None:
        taken, self._given = partner_ports(context.setup)
        self._loop = loop
        self._session = context.session
        self._to_robot = OwnOutlet(context.session, taken)
        self._from_robot: socket.socket | None = None

    def join(self, peer: SamplePeer) -> None:
        """The robot's samples go to this partner. ConfigError if a joystick here has them."""
        self.leave()
        own = listen_alone(self._session, self._given)
        if own is None:
            raise ConfigError("another program of a partner is there already")
        self._from_robot = own

        def forward() -> None:
            newest = newest_sample(own)
            if newest is not None:
                peer.send(newest)

        self._loop.add_reader(own, forward)

    def leave(self) -> None:
        own, self._from_robot = self._from_robot, None
        if own is not None:
            self._loop.remove_reader(own)
            own.close()

    def handle(self, sample: bytes) -> None:
        self._to_robot.send(sample)
