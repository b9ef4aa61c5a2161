"""Datagrams with several frames: each frame comes out octet for octet; garbage gives none."""

from random import Random

import pytest
from common import first_seed, repeats
from mutated_octets import mutate

from telepresence.link.frame import FrameCodec, Pointers
from telepresence.link.path.bundles import MOST_OCTETS, FramePacker, FrameUnpacker
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.protection.datagrams import COMPACT, PACKED

MS = 1_000_000
SAMPLE = bytes(range(1, 13))


def bundles(packer, frames):
    """A frame a slot; what is left comes later."""
    packed, now_ns = [], 0
    for frame in (*frames, *[None] * 20):
        if frame is not None:
            packer.handle_frame(frame, now_ns)
        while (bundle := packer.poll_transmit(now_ns)) is not None:
            packed.append((now_ns // MS, *bundle))
        now_ns += MS
    return packed


def test_compact_frames_by_hand():
    up = FrameCodec(UPLINK)
    frames = [
        up.pack_idle(0xFFFFFF, SAMPLE),
        up.pack(0, SAMPLE, 0, bytes.fromhex("8b03616263").ljust(12, b"\0")),
        up.pack_idle(1, None),
        up.pack(2, None, 31, b"x" * 24),
        b"\1" + up.pack_idle(3, SAMPLE)[1:],
    ]
    packed = bundles(FramePacker(UPLINK, batch=1, compact=True), frames)
    sample = SAMPLE.hex()
    assert [(slot, kind, body.hex()) for slot, kind, body in packed] == [
        (0, COMPACT, "ffffff" + "c0" + sample),
        (1, COMPACT, "000000" + "e0" + "00" + "05" + sample + "8b03616263"),
        # An idle frame goes with the next one.
        (3, COMPACT, "000001" + "00" + "b0" + "1f" + b"x".hex() * 24),
        (4, COMPACT, "000003" + "88" + frames[4].hex()),
    ]
    down = FrameCodec(DOWNLINK)
    frames = [down.pack(7, None, 2046, b"y"), *(down.pack_idle(8 + n, None) for n in range(12))]
    packed = bundles(FramePacker(DOWNLINK, batch=1, compact=True), frames)
    assert [(slot, body.hex()) for slot, _, body in packed] == [
        (0, "000007" + "a0" + "07fe" + "0001" + "79"),
        (11, "000008" + "0a"),
        (22, "000013" + "00"),
    ]
    # Whole frames, as many as a datagram may have.
    packed = bundles(FramePacker(DOWNLINK, batch=4, compact=False), frames[:4])
    assert packed == [(slot, PACKED, b"".join(frames[slot - 1 : slot + 1])) for slot in (1, 3)]


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK])
@pytest.mark.parametrize("seed", range(first_seed(1), first_seed(1) + 10))
def test_any_frames_come_out_and_mutated_datagrams_are_whole_frames_or_none(profile, seed):
    random, codec = Random(seed), FrameCodec(profile)
    compact, batch = random.random() < 0.7, random.choice((1, 2, 4))
    frames, count = [], random.randrange(1 << 24)
    for _ in range(300):
        count += 1 if random.random() < 0.95 else random.randrange(5)
        sample = SAMPLE if random.random() < 0.5 else None
        size = profile.largest_zone_octets - (0 if sample is None else profile.insert_octets)
        frame = codec.pack_idle(count, sample)
        if random.random() < 0.5:
            zone = random.randbytes(random.choice((0, 1, size // 2, size))).ljust(size, b"\0")
            pointer = random.choice((0, Pointers(profile).idle, Pointers(profile).no_start))
            frame = codec.pack(count, sample, pointer, zone)
        if random.random() < 0.02:
            frame = mutate(random, frame)[: len(frame)].ljust(len(frame))
        frames.append(frame)
    packed = bundles(FramePacker(profile, batch=batch, compact=compact), frames)
    unpacker = FrameUnpacker(profile)
    assert [frame for _, kind, body in packed for frame in unpacker.unpack(kind, body)] == frames
    assert all(len(body) <= MOST_OCTETS for _, _, body in packed)
    for _ in range(repeats(300)):
        _, kind, body = random.choice(packed)
        got = unpacker.unpack(kind, mutate(random, body))
        assert got is None or {len(frame) for frame in got} == {profile.frame_octets}
