"""Compressed headers octet by octet, by hand from docs/wire-formats.md; and which form goes when.

For any source and any loss, no header is restored wrongly: `Path.send` checks all that comes out.
"""

from itertools import islice
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_header_sources import SLOT_NS, Path, rtp, video, voice

from telepresence.link.flows import video_flow, voice_flow
from telepresence.link.header_compression import (
    FIRST_WHOLE,
    KIND_STEADY,
    KIND_TIMED,
    KIND_WHOLE,
    KINDS,
    LIFETIME_NS,
    REFRESH_NS,
    HeaderForms,
    RtpCompressor,
    RtpDecompressor,
    RtpHeader,
)

VIDEO, VOICE = video_flow("video"), voice_flow("voice")
LIFE_SLOTS, REFRESH_SLOTS = LIFETIME_NS // SLOT_NS, REFRESH_NS // SLOT_NS
FLOWS = pytest.mark.parametrize("flow", [VIDEO, VOICE], ids=["video", "voice"])
STEADY = range(KIND_STEADY, KIND_TIMED)
#: Largest mean cost of each source in octets a packet, with tag and whole headers.
SOURCES = {
    "down, on its grid": (VIDEO, 4.2, lambda r: video(r, 60, packets=(3,), wait_ms=(8, 12))),
    "down, 2 to 4 packets": (VIDEO, 4.2, lambda r: video(r, 60, packets=(2, 3, 3, 3, 4))),
    "down, 120 packets a second": (VIDEO, 4.2, lambda r: video(r, 60, packets=(4,))),
    "up, on its grid": (VIDEO, 4.4, lambda r: video(r, 60)),
    "up, its clock 200 ppm off": (VIDEO, 4.4, lambda r: video(r, 60, ppm=200)),
    "up, pictures left out": (VIDEO, 4.4, lambda r: video(r, 60, skip=0.02)),
    "up, waits up to 0.3 s": (VIDEO, 4.4, lambda r: video(r, 60, wait_ms=(5, 300))),
    "up, on no grid": (VIDEO, 4.4, lambda r: video(r, 60, jitter_ms=16)),
    "voice, its clock 200 ppm off": (VOICE, 1.3, lambda r: voice(r, 60, ppm=-200)),
    "voice, blocks of 60 ms": (VOICE, 4.6, lambda r: voice(r, 60, block_ms=60)),
}
#: Sent at frame 1000; 100 slots later 9000 ticks of video or 4800 of voice have passed.
FIRST = bytes.fromhex("80 e0 fffe fffff000 11223344") + b"first"


@pytest.mark.parametrize(
    ("flow", "kind", "residue", "header"),
    [
        # The fifth block of 960 ticks: low bits of the sequence number 3 = 65 534 + 5.
        (VOICE, 4 + 3, "", "80 60 0003 000002c0 11223344"),
        # The window: two blocks before it, one after it.
        (VOICE, 4 + 1, "", "80 60 0001 fffffb40 11223344"),
        (VOICE, 4 + 0, "", "80 60 0004 00000680 11223344"),
        # Marker 1, sequence number 10 bits, timestamp 16, of them the first three in the kind.
        (VIDEO, 8 + 4, "051400", "80 e0 0005 00001400 11223344"),
        (VIDEO, 8 + 3, "fff328", "80 60 ffff fffff328 11223344"),
        # The limits of the windows: 64 packets before the reference and 959 after it; the
        # timestamp 32 768 ticks before 0x1328, and 32 767 after it.
        (VIDEO, 8 + 3, "be1328", "80 60 ffbe 00001328 11223344"),
        (VIDEO, 8 + 3, "bd1328", "80 60 03bd 00001328 11223344"),
        (VIDEO, 8 + 0, "009328", "80 60 0000 ffff9328 11223344"),
        (VIDEO, 8 + 0, "009327", "80 60 0000 00009327 11223344"),
    ],
)
def test_headers_octet_by_octet(flow, kind, residue, header):
    decompressor = RtpDecompressor(flow, SLOT_NS)
    assert decompressor.decompress(KIND_WHOLE, FIRST, 1000) == FIRST
    packet = decompressor.decompress(kind, bytes.fromhex(residue) + b"payload", 1100)
    assert packet == bytes.fromhex(header) + b"payload"


headers = st.builds(
    RtpHeader,
    st.integers(0, 1),
    st.integers(0, 127),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFFFF_FFFF),
    st.integers(0, 0xFFFF_FFFF),
)


@FLOWS
@given(headers, st.integers(0, 1 << 26), st.integers(4, 15), st.binary(max_size=4))
def test_restored_fields_pack_into_the_same_header(flow, since, slots, kind, residue):
    """Each form's packing is the inverse of its parsing, for any reference."""
    forms = HeaderForms(flow, SLOT_NS)
    header = forms.unpack(kind, residue, since, slots)
    if (kind in STEADY and flow is VIDEO) or (kind >= KIND_TIMED and len(residue) < 3):
        assert header is None
        return
    assert (header.payload_type, header.ssrc) == (since.payload_type, since.ssrc)
    assert header.marker in (0, 1) and header.sequence < 1 << 16 and header.timestamp < 1 << 32
    assert (kind, residue[: 3 if kind >= KIND_TIMED else 0]) in forms.pack(header)
    assert kind < KINDS


@pytest.mark.parametrize(("flow", "most", "source"), SOURCES.values(), ids=SOURCES)
def test_headers_cost_few_octets_on_average(flow, most, source):
    path = Path(flow)
    for count, packet in source(Random(1)):
        path.send(count, packet)
    assert all(exact for _, _, exact in path.outcomes)
    print(f"{path.octets_a_packet():.2f}", path.compressor.report())
    assert path.octets_a_packet() <= most


def test_whole_headers_come_first_and_each_1_6_s():
    path = Path(VOICE)
    kinds = [path.send(*item) for item in islice(voice(Random(1), 3, jitter_ms=0), 120)]
    whole = [number for number, kind in enumerate(kinds) if kind == KIND_WHOLE]
    assert whole == [0, 1, FIRST_WHOLE - 1, 82]
    assert all(kind in STEADY for kind in kinds if kind != KIND_WHOLE)
    # The receiver may have restarted.
    path.compressor.restart()
    later = islice(voice(Random(1), 4, jitter_ms=0), 120, 124)
    assert [path.send(*item) == KIND_WHOLE for item in later] == [True] * FIRST_WHOLE + [False]


@FLOWS
def test_losses_up_to_the_life_of_a_reference_make_no_other_packet_unreadable(flow):
    path = Path(flow)
    source = video if flow is VIDEO else voice
    for count, packet in source(Random(1), 30):
        path.send(count, packet, arrives=not 4_000 <= count % 12_000 < 8_800)
    assert len(path.outcomes) > 500 and all(exact for _, _, exact in path.outcomes)


def test_after_a_longer_loss_the_next_whole_header_ends_it():
    path = Path(VOICE)
    for count, packet in voice(Random(1), 20):
        path.send(count, packet, arrives=not 3_000 <= count < 11_000)
    lost = [count for count, _, exact in path.outcomes if not exact]
    assert lost and max(lost) - 11_000 < REFRESH_SLOTS


@FLOWS
def test_a_reference_is_used_for_its_life_and_no_slot_longer(flow):
    decompressor = RtpDecompressor(flow, SLOT_NS)
    decompressor.decompress(KIND_WHOLE, FIRST, 1000)
    assert isinstance(decompressor.decompress(8, bytes(3), 1000 + LIFE_SLOTS), bytes)
    assert decompressor.decompress(8, bytes(3), 1000 + LIFE_SLOTS + 1) == "no_context"
    decompressor.decompress(KIND_WHOLE, FIRST, 9000)
    decompressor.forget()
    assert decompressor.decompress(8, bytes(3), 9001) == "no_context"


@pytest.mark.parametrize("change", ["ssrc", "payload_type", "jump"])
def test_a_source_that_changes_is_compressed_again_when_no_reference_is_left(change):
    """A receiver that holds an old reference must not read the new source with it."""
    path, changed = Path(VOICE), {"ssrc": 8} if change == "ssrc" else {"payload_type": 98}
    kinds = []
    for number in range(1000):
        after = number >= 300
        fields = changed if after and change != "jump" else {}
        timestamp = number * 960 + 1_000_000 * (after and change == "jump")
        lost = number in (300, 301, 350)
        kinds.append(path.send(number * 20, rtp(number, timestamp, **fields), arrives=not lost))
    whole = [number for number, kind in enumerate(kinds[300:]) if kind == KIND_WHOLE]
    assert whole[:250] == list(range(250)) and len(whole) < 340
    assert all(exact for _, _, exact in path.outcomes)


def plain(timestamp, *, hz=30, seconds=60, ssrcs=1, extended=0):
    """Return (count, packet) of `hz` packets a second, each a millisecond after its instant.

    ssrcs: sources that take turns. extended: packets of ten that have an extension.
    """
    random = Random(1)
    for number in range(hz * seconds):
        packet = rtp(number // ssrcs, timestamp(number, random), ssrc=number % ssrcs)
        first = b"\x90" if number % 10 < extended else b"\x80"
        yield 1000 + number * 1000 // hz, first + packet[1:]


def drawn(_, random):
    return random.randrange(1 << 32)


NEVER_GAINING = {
    "constant timestamps": (VIDEO, lambda: plain(lambda *_: 12_345)),
    "random timestamps": (VIDEO, lambda: plain(drawn)),
    "two SSRCs": (VOICE, lambda: plain(lambda number, _: number // 2 * 3000, hz=50, ssrcs=2)),
    "extensions": (VIDEO, lambda: plain(drawn, extended=9)),
    "8 kHz in a voice flow": (VOICE, lambda: plain(lambda number, _: number * 160, hz=50)),
}


@pytest.mark.parametrize(("flow", "source"), NEVER_GAINING.values(), ids=NEVER_GAINING)
def test_a_source_that_never_gains_costs_its_whole_headers(flow, source):
    path = Path(flow)
    for count, packet in source():
        path.send(count, packet)
    assert path.octets_a_packet() <= 13
    assert all(exact for _, _, exact in path.outcomes)


@pytest.mark.parametrize(
    "first_octets",
    [b"\x81\x60", b"\x90\x60", b"\xa0\x60", b"\x60\x60"],
    ids=["csrc", "extension", "padding", "version"],
)
def test_other_headers_are_sent_unchanged(first_octets):
    compressor, decompressor = RtpCompressor(VIDEO, SLOT_NS), RtpDecompressor(VIDEO, SLOT_NS)
    packet = first_octets + bytes(30)
    for count in range(10):
        assert compressor.compress(packet, count) == (KIND_WHOLE, packet, 12)
        assert decompressor.decompress(KIND_WHOLE, packet, count) == packet
    assert decompressor.decompress(KIND_TIMED, bytes(3), 10) == "no_context"
    assert compressor.compress(b"short", 0) == (KIND_WHOLE, b"short", 5)


def test_garbage_is_reported_in_one_word():
    decompressor = RtpDecompressor(VIDEO, SLOT_NS)
    assert decompressor.decompress(KIND_TIMED, bytes(3), 0) == "no_context"
    assert decompressor.decompress(KIND_WHOLE, FIRST, 0) == FIRST
    for kind, body in ((0, bytes(40)), (2, bytes(40)), (3, b""), (4, b""), (8, bytes(2))):
        assert decompressor.decompress(kind, body, 0) == "malformed"


def test_each_packet_and_each_octet_of_its_header_is_counted():
    path = Path(VOICE)
    kinds, octets = [], 0
    for count, packet in voice(Random(1), 5):
        kind, _, header_octets = path.compressor.compress(packet, count)
        kinds.append(kind)
        octets += 1 + header_octets
    report = path.compressor.report()
    assert report.pop("packets") == len(kinds)
    assert report.pop("header_octets") == octets
    assert report["whole"] == kinds.count(KIND_WHOLE)
    assert report["steady"] == sum(kind in STEADY for kind in kinds)
    assert sum(report.values()) == len(kinds)


#: One behaviour of a source: its number of packets, and for each packet: slots since the last one,
#: step of the sequence number, distance of the timestamp from the link's time, marker.
habits = st.fixed_dictionaries(
    {
        "packets": st.integers(1, 60),
        "slots": st.sampled_from([0, 1, 11, 20, 33, 33, 40, 66, 500, 3000]),
        "more_slots": st.integers(0, 30),
        "sequence": st.sampled_from([1, 1, 1, 1, 2, 5, 20, 300, -1, 0, 40_000]),
        "off_ticks": st.sampled_from([0, 0, 1, 60, 180, 1500, 6000, 40_000]),
        "grid": st.sampled_from([1, 960, 3000, 3000, 3600, 3753, 1500]),
        "ppm": st.sampled_from([0, 0, 200, -200]),
        "marker_each": st.sampled_from([1, 1, 2, 3, 1000]),
        "jump_ticks": st.sampled_from([0, 0, 0, 0, 960, 90_000, 1 << 31, -5]),
        "new_source": st.sampled_from([False, False, False, True]),
        "payload_type": st.sampled_from([96, 96, 96, 97]),
        "gap_slots": st.sampled_from([0, 0, 0, 100, 1_000, 6_600, 6_601, 13_000]),
        "loss": st.sampled_from([0.0, 0.0, 0.1, 0.7, 1.0]),
        "event": st.sampled_from(["", "", "", "told", "receiver", "sender"]),
    }
)


class Source:
    """Packets by habits, with numbers and timestamps near their wraps."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.count = self.random.randrange(1 << 25)
        self.drift = 0.0
        self.begin()

    def begin(self):
        random = self.random
        self.sequence = random.choice([0, 65_500, random.randrange(1 << 16)])
        self.offset = random.choice([0, (1 << 32) - 50_000, random.randrange(1 << 32)])
        self.ssrc = random.randrange(1 << 32)
        self.packets = 0

    def packet(self, habit, ticks_a_slot):
        slots = habit["slots"] + self.random.randrange(habit["more_slots"] + 1)
        self.count += slots
        self.drift += slots * ticks_a_slot * habit["ppm"] * 1e-6
        self.packets += 1
        self.sequence += habit["sequence"]
        line = self.count * ticks_a_slot + round(self.drift)
        line -= line % habit["grid"]
        line += self.random.randint(-habit["off_ticks"], habit["off_ticks"])
        return self.count, rtp(
            self.sequence,
            self.offset + line,
            marker=int(self.packets % habit["marker_each"] == 0),
            payload_type=habit["payload_type"],
            ssrc=self.ssrc,
        )


def run(flow, path, source, habit):
    source.offset += habit["jump_ticks"]
    if habit["new_source"]:
        source.begin()
    for k in range(habit["packets"]):
        count, packet = source.packet(habit, 48 if flow is VOICE else 90)
        path.send(count, packet, arrives=source.random.random() >= habit["loss"])
        if k == habit["packets"] // 2:
            source.count += habit["gap_slots"]


@FLOWS
@given(seed=st.integers(0, 1 << 30), history=st.lists(habits, max_size=12))
@settings(max_examples=100)
def test_exact_or_not_at_all(flow, seed, history):
    """Restarts of either end, silence, any losses: `Path.send` checks all that comes out."""
    source, path = Source(seed), Path(flow)
    for habit in history:
        if habit["event"] == "receiver":
            path.decompressor.forget()
        elif habit["event"] == "told":
            path.compressor.restart()
        elif habit["event"] == "sender":
            # The receiver notices a new start.
            path = Path(flow)
        run(flow, path, source, habit)


@FLOWS
@given(seed=st.integers(0, 1 << 30), history=st.lists(habits, max_size=12))
@settings(max_examples=60)
def test_without_loss_every_packet_is_decompressed(flow, seed, history):
    source, path = Source(seed), Path(flow)
    for habit in history:
        run(flow, path, source, {**habit, "loss": 0.0})
    assert all(exact for _, _, exact in path.outcomes)
