"""GStreamer's voice over the same network, live: the alternative that an expert would take."""

import os
import select
import shutil
import socket
import subprocess
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from heapq import heappop, heappush

import numpy as np

from benchmarks.voice.network import Network
from benchmarks.voice.speech import LEAD_IN_BLOCKS, Track, lags
from benchmarks.voice.virtual import Heard
from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.opus import bitrate_under_cap
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, Pcm
from kontur_av.modular import serial_difference
from kontur_av.sources.source import BLOCK_NS
from pipelines.bench.video.contenders import open_udp_ports
from pipelines.session.command_process import ended_alike

_LOOPBACK = "127.0.0.1"
_HEADER_OCTETS = 12
_PAYLOAD_TYPE = 97
#: Large enough for a block of uncompressed sound in one packet.
_MTU = 4000
#: From open ports to the first block: the pipelines still start.
_START_NS = 1500 * NS_PER_MS
#: How long the pipelines may take to open their ports; the bench then begins without late ones.
_TIMEOUT_NS = 20 * NS_PER_S
#: After the last block, until it has been played.
_END_NS = 700 * NS_PER_MS
#: The `alignment-threshold` of GstAudioBaseSink.
_ALIGNMENT_NS = 40 * NS_PER_MS
_NEEDED = ("opusenc", "rtpopuspay", "rtpopusdepay", "opusdec", "rtpjitterbuffer", "udpsrc")


@dataclass(frozen=True)
class Peer:
    """A GStreamer receiver behind a network. latency_ms: of its jitter buffer."""

    network: Network
    latency_ms: int


@dataclass
class _Receiver:
    """A running receiver, and the sound that it has played so far."""

    ear: socket.socket
    port: int
    lost: frozenset[int]
    delays_ns: list[int]
    #: Instant (ns), RTP timestamp and samples of each packet of sound.
    arrivals: list[tuple[int, int, Pcm]] = field(default_factory=list)


def missing() -> str | None:
    """What is missing for GStreamer to take part, in one line; None if nothing is."""
    if shutil.which("gst-launch-1.0") is None or shutil.which("gst-inspect-1.0") is None:
        return "GStreamer is not installed (Debian packages gstreamer1.0-tools and -plugins-*)"
    for element in _NEEDED:
        found = subprocess.run(["gst-inspect-1.0", "--exists", element], check=False, timeout=60)
        if found.returncode:
            return f"GStreamer has no {element} (Debian packages gstreamer1.0-plugins-base, -good)"
    return None


def listen_live(track: Track, cap_bps: int, peers: Sequence[Peer]) -> list[Heard]:
    """Play the track once, in real time, to all `peers` at the same time; what each has heard.

    The encoder gets each block when it is complete. A receiver plays in step with its clock
    (`sync=true`), as to a sound card, but as RTP: the arrival of a packet is its playout, and its
    timestamp is its place in the sound.
    """
    with ended_alike(), ExitStack() as stack:
        relay = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        relay.bind((_LOOPBACK, 0))
        relay.setblocking(False)
        receivers = [_start_receiver(stack, peer, track.blocks) for peer in peers]
        mouth = _start_sender(stack, cap_bps, relay.getsockname()[1])
        _wait_for_ports({receiver.port for receiver in receivers})
        run = _Run(relay, mouth, receivers)
        run.run(track)
    return [_heard(track, receiver, run) for receiver in receivers]


def _start_receiver(stack: ExitStack, peer: Peer, packets: int) -> _Receiver:
    ear = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    ear.bind((_LOOPBACK, 0))
    ear.setblocking(False)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((_LOOPBACK, 0))
        port = free.getsockname()[1]
    caps = (
        f"application/x-rtp,media=audio,clock-rate=48000,encoding-name=OPUS,payload={_PAYLOAD_TYPE}"
    )
    _launch(
        stack,
        f"udpsrc address={_LOOPBACK} port={port} caps={caps} ! "
        f"rtpjitterbuffer latency={peer.latency_ms} do-lost=true ! rtpopusdepay ! "
        "opusdec plc=true ! audioconvert ! audio/x-raw,format=S16BE,rate=48000,channels=1 ! "
        f"rtpL16pay mtu={_MTU} perfect-rtptime=false ! "
        f"udpsink host={_LOOPBACK} port={ear.getsockname()[1]} sync=true",
    )
    lost = peer.network.lost(packets, spared=LEAD_IN_BLOCKS)
    return _Receiver(ear, port, lost, peer.network.delays_ns(packets))


def _start_sender(stack: ExitStack, cap_bps: int, port: int) -> int:
    """The file descriptor that takes the blocks of sound."""
    read_end, write_end = os.pipe()
    stack.callback(os.close, write_end)
    _launch(
        stack,
        f"fdsrc fd={read_end} blocksize={2 * BLOCK_SAMPLES} do-timestamp=true ! "
        "rawaudioparse use-sink-caps=false format=pcm pcm-format=s16le sample-rate=48000 "
        f"num-channels=1 ! opusenc bitrate={bitrate_under_cap(cap_bps)} bitrate-type=cbr "
        "audio-type=voice bandwidth=auto frame-size=20 complexity=10 ! "
        f"rtpopuspay pt={_PAYLOAD_TYPE} ! udpsink host={_LOOPBACK} port={port} sync=false",
        pass_fds=(read_end,),
    )
    os.close(read_end)
    return write_end


def _wait_for_ports(ports: set[int]) -> None:
    """Wait until all are open, because a receiver loses what is sent earlier."""
    clock = MonotonicClock()
    deadline_ns = clock.now_ns() + _TIMEOUT_NS
    while not ports <= open_udp_ports() and clock.now_ns() < deadline_ns:
        clock.sleep_until_ns(clock.now_ns() + 50 * NS_PER_MS)


def _launch(stack: ExitStack, pipeline: str, pass_fds: tuple[int, ...] = ()) -> None:
    process = subprocess.Popen(
        ["gst-launch-1.0", "-q", *pipeline.split()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=pass_fds,
    )
    stack.callback(process.wait)
    stack.callback(process.kill)


class _Run:
    """Plays the track, carries the packets and records the sound, in one loop without threads."""

    def __init__(self, relay: socket.socket, mouth: int, receivers: list[_Receiver]) -> None:
        self._clock = MonotonicClock()
        self._relay = relay
        self._mouth = mouth
        self._receivers = receivers
        self._under_way: list[tuple[int, int, int, bytes]] = []
        self._first_sequence: int | None = None
        self.begin_ns = 0
        self.packets = 0
        self.payload_octets = 0

    def run(self, track: Track) -> None:
        """Run until the whole track has been played and heard."""
        self.begin_ns = self._clock.now_ns() + _START_NS
        said = 0
        end_ns = self.begin_ns + track.blocks * BLOCK_NS + _END_NS
        readable = [self._relay, *(receiver.ear for receiver in self._receivers)]
        while (now_ns := self._clock.now_ns()) < end_ns:
            due_ns = end_ns
            if said < track.blocks:
                due_ns = min(due_ns, self.begin_ns + (said + 1) * BLOCK_NS)
            if self._under_way:
                due_ns = min(due_ns, self._under_way[0][0])
            ready = select.select(readable, (), (), max(0, due_ns - now_ns) / NS_PER_S)[0]
            for receiver in self._receivers:
                if receiver.ear in ready:
                    self._hear(receiver)
            if self._relay in ready:
                self._take()
            now_ns = self._clock.now_ns()
            while said < track.blocks and now_ns >= self.begin_ns + (said + 1) * BLOCK_NS:
                block = track.samples[said * BLOCK_SAMPLES : (said + 1) * BLOCK_SAMPLES]
                os.write(self._mouth, block.tobytes())
                said += 1
            while self._under_way and self._under_way[0][0] <= now_ns:
                _, _, port, packet = heappop(self._under_way)
                with suppress(ConnectionError):
                    self._relay.sendto(packet, (_LOOPBACK, port))

    def _hear(self, receiver: _Receiver) -> None:
        with suppress(BlockingIOError):
            while True:
                packet = receiver.ear.recv(_MTU)
                now_ns = self._clock.now_ns()
                sound = np.frombuffer(packet, ">i2", offset=_HEADER_OCTETS).astype(np.int16)
                timestamp = int.from_bytes(packet[4:8], "big")
                receiver.arrivals.append((now_ns, timestamp, sound))

    def _take(self) -> None:
        while True:
            try:
                packet = self._relay.recv(2048)
            except (BlockingIOError, ConnectionError):
                return
            now_ns = self._clock.now_ns()
            sequence = int.from_bytes(packet[2:4], "big")
            if self._first_sequence is None:
                self._first_sequence = sequence
            number = (sequence - self._first_sequence) & 0xFFFF
            self.packets += 1
            self.payload_octets += len(packet) - _HEADER_OCTETS
            for receiver in self._receivers:
                if number not in receiver.lost and number < len(receiver.delays_ns):
                    due_ns = now_ns + receiver.delays_ns[number]
                    heappush(self._under_way, (due_ns, number, receiver.port, packet))


def _heard(track: Track, receiver: _Receiver, run: _Run) -> Heard:
    heard = Heard(np.zeros(0, np.int16), 0, packets=run.packets, payload_octets=run.payload_octets)
    heard.lost = len(receiver.lost)
    if not receiver.arrivals:
        return heard
    heard.samples, places = laid_out(receiver.arrivals)
    lag_of_second = lags(track, heard.samples)
    heard.lag_samples = sorted(lag_of_second)[len(lag_of_second) // 2]
    for instant_ns, at in places:
        # The sample of the track that is heard first in this packet.
        said = at - lag_of_second[min(at // AUDIO_CLOCK_HZ, len(lag_of_second) - 1)]
        if LEAD_IN_BLOCKS * BLOCK_SAMPLES <= said < len(track.samples):
            mouth_ns = run.begin_ns + said * NS_PER_S // AUDIO_CLOCK_HZ
            heard.mouth_to_ear_ns.append(instant_ns - mouth_ns)
    return heard


def laid_out(arrivals: Sequence[tuple[int, int, Pcm]]) -> tuple[Pcm, list[tuple[int, int]]]:
    """The sound as GStreamer's sinks for sound cards play it, and (instant, place) of each packet.

    A packet follows the one before, except where its timestamp is farther away than
    `_ALIGNMENT_NS`. Gaps are silent. place: index of the packet's first sample in the sound.

    arrivals: instant (ns), RTP timestamp and samples of each packet; at least one.
    """
    first = arrivals[0][1]
    line = np.zeros(0, np.int16)
    places, pieces, at = [], [line], 0
    for instant_ns, timestamp, sound in arrivals:
        missing = serial_difference(timestamp - first) - at
        if missing > _ALIGNMENT_NS * AUDIO_CLOCK_HZ // NS_PER_S:
            pieces.append(np.zeros(missing, np.int16))
            at += missing
        places.append((instant_ns, at))
        pieces.append(sound)
        at += len(sound)
    return np.concatenate(pieces), places
