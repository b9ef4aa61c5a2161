"""The process that has the connections to partners across the Internet: topics on one side, WebRTC
on the other. Whatever a partner or its network does, no process of the radio link waits for it."""

import asyncio
from collections.abc import Callable
from itertools import count

from kontur_av.codecs.opus import MAX_PACKET_SAMPLES
from kontur_av.media import AccessUnit, AudioFrame, CaptureStamp, Quality
from kontur_av.streams.coded_unit import MOST_UNIT_OCTETS, CodedUnit
from kontur_av.streams.voice_receiver import VoicePlayer
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.hand.hand_topics import ARM_ORDER_TOPIC
from pipelines.media.joined_units import JoinedUnits, StreamUnit
from pipelines.partner.decisions import RTC_REQUEST_TOPIC, UplinkRequest
from pipelines.partner.description import Kind
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.partner.partner_metrics import RtcMetrics
from pipelines.partner.peer import Programme, RtcPeer
from pipelines.partner.samples import SamplePorts
from pipelines.partner.server import RtcServer
from pipelines.partner.tally import ConnectionSeen, SampleTally, Tally
from pipelines.partner.tracks import PartnerTime
from pipelines.session.process import Context
from pipelines.session.serving_loop import Feed, ServingLoop
from pipelines.session.setup.table import RtcLeg, VideoStream
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.topics import (
    RTC,
    RTC_CAMERA,
    RTC_CODED_VOICE_TOPIC,
    RTC_SPEECH,
    RTC_SPEECH_TOPIC,
    RTC_UNITS_TOPIC,
    RTC_VIDEO,
    RTC_VIDEO_TOPIC,
    RTC_VOICE,
    RTC_VOICE_TOPIC,
)
from telepresence.haptics.authority import Authority

#: The programmes, as their addresses name them.
UPLINK, DOWNLINK = "uplink", "downlink"
_DEPTH = 8
_UNITS_OCTETS = 64 << 10


def run_rtc(context: Context, *, servers: Callable[[], IceServers] = IceServers) -> None:
    """Serve partners on the socket that the launcher has bound.

    servers: called for the STUN and TURN servers of each connection.
    """

    async def serve() -> None:
        with context.open_bus() as bus:
            await _Leg(context, bus, servers).run()

    asyncio.run(serve())


class _Leg:
    """The leg: what partners watch, and what becomes of theirs."""

    def __init__(self, context: Context, bus: TopicBus, servers: Callable[[], IceServers]) -> None:
        leg = context.setup.rtc
        assert leg is not None
        self._context, self._clock = context, context.clock
        self._serving = ServingLoop(context, self._handle_time)
        loop = self._serving.loop
        self._uplink = _Uplink(context, bus, leg, loop)
        self._downlink = _Downlink(context, bus, loop)
        self._partner = _Partner(context, bus)
        self._programmes = [self._uplink.programme]
        if self._downlink.programme.sends:
            self._programmes.append(self._downlink.programme)
        arm = context.setup.partner_arm
        # Only a shared arm is the owner's to lend.
        self._orders = TopicReader(bus, ARM_ORDER_TOPIC) if arm == "shared" else None
        self._lent = self._orders is None
        self._server = RtcServer(
            context.pages[RTC],
            self._programmes,
            clock=context.clock,
            handle=self._partner.handle,
            servers=servers,
            most_bps=leg.taken_bps,
            samples=None if arm == "none" else SamplePorts(context, self._serving.loop),
            lent=lambda: self._lent,
        )
        self._hands = SampleTally()
        self._tally = Tally()

    async def run(self) -> None:
        self._context.on_flush(self._publish)
        await self._server.start()
        feeds = (*self._uplink.feeds, *self._downlink.feeds)
        for feed in feeds:
            feed.open()
        try:
            await self._serving.run()
        finally:
            for feed in feeds:
                feed.close()
            await self._server.close()

    def _handle_time(self, _: int) -> None:
        self._uplink.handle_time()
        self._downlink.handle_time()
        order = None if self._orders is None else self._orders.latest()
        if order is not None:
            self._lent = order is Authority.PARTNER
        self._count()

    def _count(self) -> None:
        self._hands.handle_peer(self._server.hand)
        self._tally.handle_connections(
            {
                peer: ConnectionSeen(
                    peer.connected,
                    peer.restarts,
                    None if peer.media is None else peer.media.metrics,
                    self._names(peer),
                )
                for peer in self._server.peers
            }
        )

    def _names(self, peer: RtcPeer) -> dict[Kind, str]:
        if peer in self._uplink.programme.peers:
            return {"video": RTC_VIDEO, "audio": RTC_SPEECH}
        if peer in self._downlink.programme.peers:
            return {"video": "downlink_video", "audio": "downlink_voice"}
        return {"video": RTC_CAMERA, "audio": RTC_VOICE}

    def _publish(self) -> None:
        self._count()
        total, server = self._tally.total, self._server
        standing = [peer for peer in server.peers if peer.connected]
        route = next((peer.route for peer in reversed(standing) if peer.route), None)
        trips = [
            one.reception.round_trip_ns
            for peer in standing
            if peer.media is not None
            for one in peer.media.metrics.sent.values()
            if one.reception is not None and one.reception.round_trip_ns is not None
        ]
        self._context.probe.publish(
            RtcMetrics(
                connections=self._tally.connections,
                ice_restarts=total.restarts,
                refused=dict(server.admission.refused),
                garbage=total.garbage + server.garbage + self._hands.garbage,
                faults=server.faults,
                samples=self._hands.totals(),
                rate_lowered=self._uplink.request.rate.lowered,
                partners=len(standing),
                rate_bps=self._uplink.request.rate.bps,
                route=None if route is None else str(route),
                round_trip_ns=trips[-1] if trips else None,
                streams=total.streams,
            )
        )


class _Uplink:
    """The selected camera and ground control's voice, coded for partners by another process."""

    def __init__(
        self, context: Context, bus: TopicBus, leg: RtcLeg, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._clock = context.clock
        sends: dict[Kind, int] = {"video": leg.video_bps}
        self.feeds = [Feed(loop, bus, RTC_VIDEO_TOPIC, self._unit, depth=_DEPTH)]
        if context.setup.uplink_voice is not None:
            sends["audio"] = leg.voice_bps
            self.feeds.append(Feed(loop, bus, RTC_SPEECH_TOPIC, self._packet, depth=_DEPTH))
        self.programme = Programme(UPLINK, sends=sends, want_key=lambda _: self._want_key())
        self.request = UplinkRequest(most_bps=leg.video_bps)
        self._requests = TopicWriter(bus, RTC_REQUEST_TOPIC, wake=True)

    def handle_time(self) -> None:
        """Follow the partners' requests, and tell the coding process, also one that began since."""
        self.request.handle_time(self.programme.requested_bps, self._clock.now_ns())
        self._publish()

    def _want_key(self) -> None:
        self.request.handle_key_wanted()
        self._publish()

    def _publish(self) -> None:
        now_ns = self._clock.now_ns()
        watched = any(peer.connected for peer in self.programme.peers)
        request = self.request.request(watched=watched)
        self._requests.publish(request, now_ns)

    def _unit(self, lease: Lease) -> None:
        unit, stamp = CodedUnit.unpack(lease.octets()), lease.stamp
        if unit.added:
            return  # their decoders are served by the coder itself
        now_ns, octets = self._clock.now_ns(), len(unit.data)
        if self.request.handle_unit(stamp.sequence, octets, key=unit.key, now_ns=now_ns):
            self._publish()
        self.programme.send_unit(AccessUnit(unit.data, stamp, unit.key))

    def _packet(self, lease: Lease) -> None:
        self.programme.send_opus(lease.octets(), lease.stamp)


class _Downlink:
    """The downlink's picture and voice, passed on as they were received.

    Nothing is asked of their sender: it must not spend the radio's octets for a partner. Who joins
    gets a key picture that the receiver codes, and the units since.
    """

    def __init__(self, context: Context, bus: TopicBus, loop: asyncio.AbstractEventLoop) -> None:
        setup, self._clock = context.setup, context.clock
        sends: dict[Kind, int] = {}
        self.feeds: list[Feed] = []
        self._pictures: Feed | None = None
        for stream in (setup.downlink_video, setup.downlink_voice):
            if stream is None:
                continue
            row = context.topology.media(stream.name)
            video = isinstance(stream, VideoStream)
            sends["video" if video else "audio"] = stream.cap_bps
            handle = self._unit if video else self._packet
            self.feeds.append(Feed(loop, bus, row.coded_topic, handle, depth=_DEPTH))
            if video:
                self._pictures = self.feeds[-1]
        self.programme = Programme(DOWNLINK, sends=sends, want_key=self._want_key)
        self._joined = JoinedUnits()
        self._waiting: set[RtcPeer] = set()

    def handle_time(self) -> None:
        self._waiting &= self.programme.peers
        asks = self._joined.poll_ask(self._clock.now_ns(), waits=bool(self._waiting))
        if asks and self._pictures is not None:
            self._pictures.rejoin()

    def _unit(self, lease: Lease) -> None:
        unit, now_ns = CodedUnit.unpack(lease.octets()), self._clock.now_ns()
        waits = bool(self._waiting & self.programme.peers)
        joined = self._joined.handle_unit(unit, lease.stamp, now_ns, waits=waits)
        if joined.anew:
            self._waiting |= self.programme.peers
        if joined.live is not None:
            for peer in self.programme.peers - self._waiting:
                peer.send_unit(_access_unit(joined.live))
        for peer in self._waiting & self.programme.peers if joined.begin else ():
            self._waiting.discard(peer)
            for each in joined.begin:
                peer.send_unit(_access_unit(each))

    def _packet(self, lease: Lease) -> None:
        if lease.stamp.capture_ns:
            self.programme.send_opus(lease.octets(), lease.stamp)

    def _want_key(self, peer: RtcPeer) -> None:
        self._waiting.add(peer)
        self.handle_time()


def _access_unit(came: StreamUnit) -> AccessUnit:
    stamp = CaptureStamp(came.captured_ns, came.stamp.sequence, DOWNLINK)
    return AccessUnit(came.data, stamp, came.unit.key)


class _Partner:
    """What a partner sends: its units go to the decoding process, its voice is played here."""

    def __init__(self, context: Context, bus: TopicBus) -> None:
        self._clock = context.clock
        self._time = PartnerTime()
        self._units = bus.writer(RTC_UNITS_TOPIC, max_octets=_UNITS_OCTETS)
        self._voice = bus.writer(RTC_VOICE_TOPIC, max_octets=MAX_PACKET_SAMPLES * 2)
        self._packets = TopicWriter(bus, RTC_CODED_VOICE_TOPIC, wake=True)
        self._player = VoicePlayer()
        self._numbers, self._sounds = count(), count()

    def handle(self, event: PictureCame | SoundCame) -> None:
        now_ns = self._clock.now_ns()
        told_ns = event.capture_ns
        capture_ns = now_ns if told_ns is None else self._time.capture_ns(told_ns, now_ns)
        if isinstance(event, PictureCame):
            self._handle_unit(event, capture_ns)
        else:
            self._handle_sound(event, capture_ns)

    def _handle_unit(self, event: PictureCame, capture_ns: int) -> None:
        unit = event.unit
        if len(unit.data) > MOST_UNIT_OCTETS:
            return
        damaged = unit.damaged or unit.lost_before > 0
        quality = Quality.DAMAGED if damaged else Quality.FRESH
        coded = CodedUnit(data=unit.data, key=unit.keyframe, damaged=damaged)
        stamp = CaptureStamp(capture_ns, next(self._numbers), RTC_CAMERA, quality, unit.timestamp)
        self._units.publish_octets(coded.pack(), stamp)

    def _handle_sound(self, event: SoundCame, capture_ns: int) -> None:
        block = event.block
        samples, decoded = self._player.play(block)
        if block.payload is not None and not block.recovered:
            self._packets.publish_read(block.payload, capture_ns, block.timestamp)
        quality = Quality.FRESH if decoded else Quality.CONCEALED
        stamp = CaptureStamp(capture_ns, next(self._sounds), RTC_VOICE, quality, block.timestamp)
        self._voice.publish_audio(AudioFrame(samples, stamp))
