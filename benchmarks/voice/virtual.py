"""This project's voice over a lossy network on virtual time: every run gives the same."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.voice.network import Network
from benchmarks.voice.speech import LEAD_IN_BLOCKS, Track
from kontur_av.clock import NS_PER_S
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_NS, BLOCK_SAMPLES, CaptureStamp, Pcm
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpIdentity
from kontur_av.streams.voice_receiver import VoicePlayer, VoiceReceiver
from pipelines.media.media_metrics import CodingCosts
from pipelines.media.stream_metrics import voice_receiver, voice_sender
from pipelines.session.setup.table import Setup, VoiceStream
from pipelines.table import topology_of


@dataclass
class Heard:
    """The sound at the ear.

    samples: int16 at 48 kHz, with silence in gaps. lag_samples: delay behind the track.
    mouth_to_ear_ns: of each decoded block. made_up_ns: duration of concealed or inserted sound;
    None if unknown. payload_octets: of all packets sent.
    """

    samples: Pcm
    lag_samples: int
    mouth_to_ear_ns: list[int] = field(default_factory=list)
    made_up_ns: int | None = None
    packets: int = 0
    payload_octets: int = 0
    lost: int = 0


#: Of a packet: (instant of sending, the RTP packet, a sender report or None).
Sent = tuple[int, bytes, bytes | None]


def speak(
    setup: Setup, stream: VoiceStream, track: Track, costs: CodingCosts | None = None
) -> list[Sent]:
    """The packets of the track, from the session's own cores."""
    costs = costs or CodingCosts()
    sent: list[Sent] = []
    identity = RtpIdentity(ssrc=0x6B6F6E74, first_sequence=65_000, timestamp_offset=1 << 31)
    sender = voice_sender(setup, stream, identity, wall_offset_ns=0)
    encoder = OpusEncoder(bitrate_bps=sender.bitrate_bps)
    for number in range(track.blocks):
        samples = track.samples[number * BLOCK_SAMPLES : (number + 1) * BLOCK_SAMPLES]
        stamp = CaptureStamp(number * BLOCK_NS, number, "bench")
        complete_ns = stamp.capture_ns + BLOCK_NS
        if not sender.handle_block(stamp, complete_ns):
            continue
        encoded_ns = complete_ns + costs.ns("voice_encode")
        sender.handle_packet(encoder.encode(samples), stamp, encoded_ns)
        # The pacer of a voice stream delays no packet that comes at its regular rate.
        while (packet := sender.poll_transmit(encoded_ns)) is not None:
            sent.append((encoded_ns, packet, sender.poll_report(encoded_ns)))
    return sent


def listen(
    setup: Setup,
    stream: VoiceStream,
    sent: Sequence[Sent],
    network: Network,
    costs: CodingCosts | None = None,
) -> Heard:
    """What is heard of `sent` behind the network, with the session's own cores."""
    costs = costs or CodingCosts()
    receiver = voice_receiver(topology_of(setup), stream, wall_offset_ns=0)
    ear = _Ear(receiver, costs.ns("voice_decode"))
    lost = network.lost(len(sent), spared=LEAD_IN_BLOCKS)
    delays_ns = network.delays_ns(len(sent))
    heard = Heard(np.zeros(0, np.int16), 0, lost=len(lost))
    arrivals: list[Sent] = []
    for number, (sent_ns, packet, report) in enumerate(sent):
        heard.packets += 1
        heard.payload_octets += len(packet) - RTP_HEADER_OCTETS
        if number not in lost:
            arrivals.append((sent_ns + delays_ns[number], packet, report))
    arrivals.sort(key=lambda arrival: arrival[0])
    for arrival_ns, packet, report in arrivals:
        ear.handle_time(arrival_ns)
        if report is not None:
            receiver.handle_report(report, arrival_ns)
        receiver.handle_packet(packet, arrival_ns)
        ear.handle_time(arrival_ns)
    ear.handle_time(arrivals[-1][0] + NS_PER_S)
    ear.fill(heard)
    return heard


class _Ear:
    """Plays blocks when they are due, and keeps their samples and instants."""

    def __init__(self, receiver: VoiceReceiver, cost_ns: int) -> None:
        self._receiver = receiver
        self._cost_ns = cost_ns
        self._player = VoicePlayer()
        self._pieces: list[tuple[int, Pcm]] = []
        self._mouth_to_ear_ns: list[int] = []
        self._made_up = 0

    def handle_time(self, now_ns: int) -> None:
        receiver = self._receiver
        while (due_ns := receiver.poll_timeout()) is not None and due_ns <= now_ns:
            receiver.handle_timeout(due_ns)
            self._drain()
        self._drain()

    def _drain(self) -> None:
        while (block := self._receiver.next_event()) is not None:
            samples, decoded = self._player.play(block)
            heard_ns = block.play_ns + self._cost_ns
            self._pieces.append((heard_ns, samples))
            capture_ns = self._receiver.capture_ns(block.timestamp)
            if not decoded:
                self._made_up += len(samples)
            elif capture_ns is not None:
                self._mouth_to_ear_ns.append(heard_ns - capture_ns)

    def fill(self, heard: Heard) -> None:
        """Put the sound on one time line that begins with the track."""
        length = _samples(self._pieces[-1][0]) + len(self._pieces[-1][1])
        line = np.zeros(length, np.int16)
        at = 0
        for instant_ns, samples in self._pieces:
            # Rounding of instants must not make gaps.
            if abs(_samples(instant_ns) - at) > 2:
                at = _samples(instant_ns)
            part = samples[: length - at]
            line[at : at + len(part)] = part
            at += len(part)
        heard.samples = line
        heard.mouth_to_ear_ns = self._mouth_to_ear_ns
        heard.made_up_ns = self._made_up * NS_PER_S // AUDIO_CLOCK_HZ
        middle = sorted(heard.mouth_to_ear_ns)[len(heard.mouth_to_ear_ns) // 2]
        heard.lag_samples = _samples(middle)


def _samples(duration_ns: int) -> int:
    return duration_ns * AUDIO_CLOCK_HZ // NS_PER_S
