"""Both ends of a connection's media against each other, over a network that loses packets."""

import random
from collections import deque
from dataclasses import replace

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.feedback import rate_message
from kontur_av.rtp.header_extensions import elements_of
from kontur_av.rtp.rtcp import is_rtcp
from pipelines.partner.description import wanted_line
from pipelines.partner.media import PictureCame, RtcMedia, SoundCame

DELAY_NS, STEP_NS = 15 * NS_PER_MS, 2 * NS_PER_MS
#: The receiver's clock is ahead of the sender's by this; sender reports tell Unix time.
AHEAD_NS = 500 * NS_PER_S
BPS = {"audio": 32_000, "video": 1_500_000}


def unit(number, octets=3000):
    """An access unit of one slice, with parameter sets and IDR at the first."""
    body = number.to_bytes(4, "big") + b"\x55" * octets
    start = b"\x00\x00\x00\x01"
    names = (b"\x67\x42\xe0\x1f", b"\x68\xce", b"\x65\x88") if not number else (b"\x41\x9a",)
    head = b"".join(start + name for name in names)
    return head + body


class Pair:
    """A sender and a receiver of both kinds. lost: tells whether a datagram gets lost."""

    def __init__(self, lost=lambda datagram: False):
        draw = random.Random(1).getrandbits
        lines = [
            wanted_line("audio", mid="0", ssrc=101, sends=True),
            wanted_line("video", mid="1", ssrc=102, sends=True),
        ]
        back = [wanted_line(line.kind, mid=line.mid, ssrc=0, receives=True) for line in lines]
        options = {"randbits": draw, "most_bps": 1_500_000, "cname": "c"}
        self.sender = RtcMedia(lines, bps=BPS, **options)
        self.receiver = RtcMedia(back, bps={}, **options, wall_offset_ns=-AHEAD_NS)
        self._lines, self._options = lines, options
        self._lost = lost
        self._ways = deque(), deque()
        self.events = []
        self.sent = []

    def change_devices(self):
        """The sender goes on with other sources: new SSRCs, sequence numbers and timestamps."""
        lines = [replace(line, ssrc=line.ssrc + 100) for line in self._lines]
        self.sender = RtcMedia(lines, bps=BPS, **self._options)

    def played(self):
        """(number, event) of each block of sound that was not concealed."""
        return [
            (int.from_bytes(event.block.payload[1:], "big"), event)
            for event, _ in self.events
            if isinstance(event, SoundCame) and event.block.payload is not None
        ]

    def run(self, begin_ns, end_ns):
        for now_ns in range(begin_ns, end_ns, STEP_NS):
            self._step(self.sender, now_ns, 0, 0)
            self._step(self.receiver, now_ns + AHEAD_NS, 1, AHEAD_NS)
            while (event := self.receiver.next_event()) is not None:
                self.events.append((event, now_ns))

    def _step(self, media, now_ns, index, ahead_ns):
        media.handle_timeout(now_ns)
        incoming = self._ways[1 - index]
        while incoming and incoming[0][0] + ahead_ns <= now_ns:
            datagram = incoming.popleft()[1]
            (media.handle_rtcp if is_rtcp(datagram) else media.handle_rtp)(datagram, now_ns)
        while (datagram := media.poll_transmit(now_ns)) is not None:
            if index == 0:
                self.sent.append(datagram)
            if not self._lost(datagram):
                self._ways[index].append((now_ns - ahead_ns + DELAY_NS, datagram))


def drive(pair, seconds, octets=3000, begin=0):
    """Send 25 pictures and 50 blocks a second, from the second `begin` on."""
    for block in range(begin * 50, (begin + seconds) * 50):
        now_ns = block * 20 * NS_PER_MS
        if block % 2 == 0:
            stamp = CaptureStamp(now_ns, block // 2, "camera")
            pair.sender.send_unit(AccessUnit(unit(block // 2, octets), stamp, block == 0), now_ns)
        # A CELT packet of 20 ms, and its number.
        packet = b"\xfc" + block.to_bytes(4, "big")
        pair.sender.send_opus(packet, CaptureStamp(now_ns, block, "voice"), now_ns)
        pair.run(now_ns, now_ns + 20 * NS_PER_MS)
    return [event for event, _ in pair.events if isinstance(event, PictureCame)]


def test_units_and_packets_arrive_as_they_were_coded_and_dated():
    pair = Pair()
    pictures = drive(pair, 3)
    assert len(pictures) >= 73
    # One clock for picture and voice: the sender's, moved by what both call Unix time.
    dated = [(event, 40 * number) for number, event in enumerate(pictures)]
    for number, event in enumerate(pictures):
        assert split_annex_b(event.unit.data) == split_annex_b(unit(number))
    assert len(pair.played()) > 140
    dated += [(event, 20 * number) for number, event in pair.played()]
    for event, capture_ms in dated:
        if event.capture_ns is not None:
            assert abs(event.capture_ns - capture_ms * NS_PER_MS - AHEAD_NS) < 20_000
    # Every picture carries a playout delay of zero.
    sent = [one for one in pair.sent if not is_rtcp(one) and one[1] & 0x7F == 96]
    assert {elements_of(one)[3] for one in sent} == {bytes(3)}
    metrics = pair.sender.metrics.sent["video"]
    assert metrics.reception.lost == 0
    assert abs(metrics.reception.round_trip_ns - 2 * DELAY_NS) < 3 * NS_PER_MS


def test_lost_packets_are_mended_before_a_picture_is_given_up():
    generator = random.Random(3)
    first = set()

    def lost(datagram):
        # Each packet at most once, so that its repetition comes through.
        key = datagram[:12]
        if is_rtcp(datagram) or key in first or generator.random() > 0.08:
            return False
        first.add(key)
        return True

    pair = Pair(lost)
    pictures = drive(pair, 4)
    assert len(pictures) >= 97
    assert sum(event.unit.damaged for event in pictures) == 0
    received = pair.receiver.metrics.received["video"]
    assert received.repeated > 10
    assert pair.sender.metrics.sent["video"].repeated >= received.repeated


def test_a_loss_that_cannot_be_mended_asks_for_a_key_picture():
    gone = []

    def lost(datagram):
        if is_rtcp(datagram) or datagram[1] & 0x7F != 96:
            return False
        number = int.from_bytes(datagram[2:4], "big")
        if not gone and len(pair.sent) > 60:
            gone.append(number)
        return number in gone

    pair = Pair(lost)
    drive(pair, 3)
    assert pair.receiver.metrics.received["video"].keys_asked >= 1
    assert pair.sender.metrics.sent["video"].keys_asked >= 1
    assert pair.sender.take_key_request(3 * NS_PER_S)
    assert not pair.sender.take_key_request(3 * NS_PER_S)


@pytest.mark.parametrize("key", [True, False])
def test_other_devices_of_the_partner_go_on_at_once(key):
    pair = Pair()
    drive(pair, 2)
    pair.change_devices()
    now_ns = 2 * NS_PER_S
    first = AccessUnit(unit(0 if key else 50), CaptureStamp(now_ns, 0, "camera"), True)
    pair.sender.send_unit(first, now_ns)
    pair.run(now_ns, now_ns + 20 * NS_PER_MS)
    pictures = drive(pair, 2, begin=2)
    assert len(pictures) >= 98
    # What waits for its time when the new voice begins is dropped.
    assert len(set(range(200)) - {number for number, _ in pair.played()}) <= 4
    # Pictures of another camera are not predicted from those before.
    assert (pair.receiver.metrics.received["video"].keys_asked > 0) == (not key)


@pytest.mark.rule("7")
def test_garbage_is_counted_a_wish_is_of_its_own_stream_and_a_stalled_sender_drops():
    pair = Pair()
    generator = random.Random(4)
    for _ in range(200):
        octets = generator.randbytes(generator.randrange(60))
        for handle in (pair.receiver.handle_rtp, pair.receiver.handle_rtcp):
            handle(octets, 0)
        pair.sender.handle_rtcp(octets, 0)
        pair.receiver.handle_rtp(bytes([0x90, 96]) + octets, 0)
    assert pair.receiver.metrics.garbage > 100
    assert pair.sender.metrics.garbage > 100
    pair.events.clear()
    assert len(drive(pair, 2)) >= 40
    pair = Pair()
    for ssrc, requested_bps in ((999, None), (102, 300_000)):
        pair.sender.handle_rtcp(rate_message(300_000, ssrc=5, media_ssrcs=[ssrc]), 0)
        assert pair.sender.requested_bps == requested_bps
    pair = Pair()
    pair.sender.send_unit(AccessUnit(unit(0, 400_000), CaptureStamp(0, 0, "camera"), True), 0)
    now_ns = NS_PER_S
    pair.sender.send_unit(AccessUnit(unit(1), CaptureStamp(now_ns, 1, "camera"), False), now_ns)
    assert pair.sender.metrics.sent["video"].dropped == 1
    assert pair.sender.take_key_request(now_ns)
