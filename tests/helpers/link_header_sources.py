"""RTP sources that behave like real ones, and a lossy path between the two ends of a flow."""

import struct

from telepresence.link.header_compression import KIND_WHOLE, RtpCompressor, RtpDecompressor

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
    """One flow from end to end."""

    def __init__(self, flow):
        self.compressor = RtpCompressor(flow, SLOT_NS)
        self.decompressor = RtpDecompressor(flow, SLOT_NS)
        #: Result of each received packet: (count, kind, whether it equals the sent one).
        self.outcomes = []

    def send(self, count, packet, *, arrives=True):
        """Send `packet` and return its kind; assert that nothing wrong comes out."""
        kind, body, header_octets = self.compressor.compress(packet, count)
        assert header_octets == len(body) - len(packet) + 12 if packet[0] == 0x80 else True
        assert kind == KIND_WHOLE or header_octets <= 3
        if arrives:
            out = self.decompressor.decompress(kind, body, count)
            assert out in (packet, "no_context"), (kind, count)
            self.outcomes.append((count, kind, out == packet))
        return kind

    def octets_a_packet(self):
        report = self.compressor.report()
        return report["header_octets"] / report["packets"]
