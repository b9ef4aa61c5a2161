"""RTP sources that behave like real ones, and a lossy path between the two ends of a flow."""

import struct
from collections import deque

from telepresence.link.compression.header_compression import RtpCompressor, RtpDecompressor

SLOT_NS = 1_000_000


def rtp(sequence, timestamp, *, marker=0, payload_type=96, ssrc=7, payload=b"payload"):
    second = marker << 7 | payload_type
    fields = (0x80, second, sequence & 0xFFFF, timestamp & 0xFFFF_FFFF, ssrc & 0xFFFF_FFFF)
    return struct.pack(">BBHII", *fields) + payload


def video(random, seconds, *, hz=30, packets=(1,), jitter_ms=0.0, wait_ms=(5, 60), ppm=0, skip=0.0):
    """Return (count, packet) of a source of pictures with random offsets and its own clock.

    packets: possible numbers of packets a picture. wait_ms: from capture to the first frame.
    """
    sequence, offset, ssrc = random.randrange(1 << 16), random.randrange(1 << 32), random.random()
    ssrc = int(ssrc * (1 << 32))
    count = 0
    for picture in range(round(seconds * hz)):
        if random.random() < skip:
            continue
        captured_s = picture / hz * (1 + ppm * 1e-6)
        captured_s += random.uniform(-jitter_ms, jitter_ms) / 1000
        timestamp = offset + round(captured_s * 90_000)
        parts = random.choice(packets)
        wait = random.uniform(*wait_ms)
        for part in range(parts):
            count = max(count, round(1000 + picture / hz * 1000 + wait + part / 2))
            marker = int(part == parts - 1)
            yield count, rtp(sequence, timestamp, marker=marker, ssrc=ssrc)
            sequence += 1


def voice(random, seconds, *, block_ms=20, jitter_ms=3.0, ppm=0):
    """Return (count, packet) of a source of blocks of sound at 48 kHz."""
    sequence, offset, ssrc = random.randrange(1 << 16), random.randrange(1 << 32), 0x8000_0001
    count = 0
    for block in range(round(seconds * 1000 / block_ms)):
        sent_ms = block * block_ms * (1 + ppm * 1e-6) + random.uniform(-jitter_ms, jitter_ms)
        count = max(count, round(1000 + sent_ms))
        timestamp = offset + block * block_ms * 48
        yield count, rtp(sequence + block, timestamp, payload_type=97, ssrc=ssrc)


class Path:
    """One flow from end to end. Acknowledgements are delayed and keep their order."""

    def __init__(self, flow, *, heard=True, alive_slots=500):
        self.compressor = RtpCompressor(flow, SLOT_NS)
        self.decompressor = RtpDecompressor(flow, SLOT_NS)
        self.heard = heard
        self.compressor.handle_peer(heard=heard)
        self._alive_slots = alive_slots
        self._acknowledgements = deque()
        self._told = (0, -alive_slots)
        #: Result of each received packet: (count, kind, whether it equals the sent one).
        self.outcomes = []

    def hear(self, heard):
        if not heard:
            self._acknowledgements.clear()
        self.heard = heard
        self.compressor.handle_peer(heard=heard)

    def receiver_restarts(self, count, delay_slots):
        self.decompressor.forget()
        self._acknowledgements.append((count + delay_slots, None))

    def send(self, count, packet, *, arrives=True, told=True, delay_slots=40):
        """Send `packet` and return its kind; assert that nothing wrong comes out."""
        while self._acknowledgements and self._acknowledgements[0][0] <= count:
            at, number = self._acknowledgements.popleft()
            if not self.heard:
                continue
            if number is None:
                self.compressor.forget()
            else:
                self.compressor.handle_acknowledgement(number, at)
        kind, body, header_octets = self.compressor.compress(packet, count)
        assert header_octets == len(body) - len(packet) + 12 if packet[0] == 0x80 else True
        assert kind < 3 or header_octets <= 3
        if arrives:
            out = self.decompressor.decompress(kind, body, count)
            assert out in (packet, "no_context"), (kind, count)
            self.outcomes.append((count, kind, out == packet))
        number, since = self._told
        held = self.decompressor.context_id
        if self.heard and (held != number or count - since >= self._alive_slots):
            self._told = (held, count)
            if told:
                at = count + delay_slots
                if self._acknowledgements:
                    at = max(at, self._acknowledgements[-1][0])
                self._acknowledgements.append((at, held))
        return kind

    def octets_a_packet(self):
        report = self.compressor.report()
        return report["header_octets"] / report["packets"]
