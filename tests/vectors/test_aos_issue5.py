"""Both directions through a strict decoder of CCSDS 732.0-B-5, Issue 5 (October 2025).

In Issue 5 the bits 42 and 43 of the primary header are the two highest bits of a spacecraft
identifier of ten bits (4.1.2.2), which were spare bits before. The decoder here also has the checks
that only some decoders make: a count cycle that is not used is zero, and no bit is set that has no
meaning. It knows nothing of this project.
"""

from typing import NamedTuple

import pytest

from telepresence.link.flows import Level, packet_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.sender import LinkSender

FLOWS = [packet_flow("tmtc", Level.TMTC), packet_flow("files", Level.MAINTENANCE)]


class AosFrame(NamedTuple):
    scid: int
    vcid: int
    count: int
    usage: bool


def decode(frame, *, length):
    """Return the fields of the primary header; raise ValueError for what Issue 5 forbids."""
    if len(frame) != length:
        raise ValueError("length")
    register = 0xFFFF
    for octet in frame:
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1) ^ (0x11021 if register & 0x8000 else 0)
    if register:
        raise ValueError("FECF")
    header = int.from_bytes(frame[:6], "big")
    if header >> 46 != 0b01:
        raise ValueError("version")
    replay, usage, cycle = header >> 7 & 1, header >> 6 & 1, header & 0xF
    if replay:
        raise ValueError("replay")
    if cycle and not usage:
        raise ValueError("a cycle that is not used")
    scid = (header >> 4 & 0b11) << 8 | header >> 38 & 0xFF
    count = header >> 8 & 0xFFFFFF
    return AosFrame(scid, header >> 32 & 0x3F, cycle << 24 | count if usage else count, bool(usage))


def frames(profile, slots=5000):
    """Traffic of all kinds: with samples and without, pieces, fill, supervision."""
    sender = LinkSender(profile, FLOWS, first_count=1234)
    for slot in range(slots):
        if slot % 5:
            sender.handle_haptic(bytes(12), 0)
        if slot % 3 == 0:
            sender.handle_packet("tmtc", bytes(slot % 40), 0)
        if slot % 40 == 0:
            sender.handle_packet("files", bytes(700), 0)
        yield sender.poll_transmit(slot * 1_000_000, bytes(12) if slot % 500 == 7 else None)


@pytest.mark.parametrize(
    ("profile", "vcids"), [(UPLINK, set(range(32))), (DOWNLINK, {1})], ids=["uplink", "downlink"]
)
def test_a_strict_decoder_takes_every_frame(profile, vcids):
    decoded = [decode(frame, length=profile.frame_octets) for frame in frames(profile)]
    assert {frame.scid for frame in decoded} == {profile.scid}
    assert {frame.vcid for frame in decoded} <= vcids
    # The usage flag differs with and without a sample, and yet the count has no gap.
    assert {frame.usage for frame in decoded} == {False, True}
    assert [frame.count for frame in decoded] == list(range(1234, 1234 + len(decoded)))
