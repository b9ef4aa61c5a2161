"""Opus packets by RFC 6716: their length, their flags, and senders whose clock is too slow."""

import pytest
from rtp_packets import received

from kontur_av.errors import ProtocolError
from kontur_av.rtp.payload_opus import SlowClock, holds_copy, is_pause, opus_samples

#: RFC 6716 table 2: by configuration, the length of a frame in samples at 48 kHz.
FRAMES = (*[480, 960, 1920, 2880] * 3, *[480, 960] * 2, *[120, 240, 480, 960] * 4)


@pytest.mark.parametrize(("config", "samples"), list(enumerate(FRAMES)))
def test_every_configuration_has_its_length(config, samples):
    for code, frames in ((0, 1), (1, 2), (2, 2)):
        assert opus_samples(bytes((config << 3 | code, 9))) == frames * samples
    most = 5760 // samples
    # The two highest bits of the count mean padding and a variable rate.
    assert opus_samples(bytes((config << 3 | 3, 0xC0 | most))) == most * samples
    for count in (0, most + 1):
        with pytest.raises(ProtocolError, match="120 ms is the most"):
            opus_samples(bytes((config << 3 | 3, count)))


@pytest.mark.parametrize("octets", ["", "03"])
def test_octets_without_a_length_are_no_opus(octets):
    with pytest.raises(ProtocolError, match="Opus packet"):
        opus_samples(bytes.fromhex(octets))


@pytest.mark.parametrize(
    ("octets", "pause", "copy"),
    [
        ("08 40", True, True),
        ("08 80", False, False),
        # One frame at a constant rate, with padding: 2 octets, or 254 and 3.
        ("0b 01 c0", False, True),
        ("0b 41 02 40 0000", True, True),
        ("0b 41 ff03 40" + "00" * 257, True, True),
        # Hybrid frames have one block.
        ("60 40", True, True),
        ("68 40", True, True),
        ("78 80", False, False),
        # CELT has no flags. Several frames, and what ends before its frame, tell nothing.
        ("80 40", False, False),
        ("f8 00", False, False),
        ("09 40", False, False),
        ("0a 40 00", False, False),
        ("0b 02 40", False, False),
        ("0b 01", False, False),
        ("0b 41 ff", False, False),
        ("08", False, False),
        ("", False, False),
    ],
)
def test_the_flags_of_a_packet_of_one_frame(octets, pause, copy):
    payload = bytes.fromhex(octets)
    assert (is_pause(payload), holds_copy(payload)) == (pause, copy)


def scales(clock, steps, *, first=0, payload=b"\x08\x80", missing=(), restart=()):
    """What a clock finds in packets whose timestamps advance by `steps`."""
    found, timestamp = [], 2**32 - 700
    for number, step in enumerate(steps, first):
        timestamp = (timestamp + step) & 0xFFFF_FFFF
        if number not in missing:
            packet = received(payload, number, timestamp=timestamp, restart=number in restart)
            found.append(clock.handle_packet(packet))
    return found


@pytest.mark.parametrize(("slow", "step"), [(2, 480), (3, 320), (6, 160)])
def test_three_steps_in_a_row_show_a_slow_clock(slow, step):
    # RFC 7587 section 4.1: timestamps count 48 kHz.
    assert scales(SlowClock(), [step] * 5) == [1, 1, 1, slow, 1]


@pytest.mark.parametrize("step", [960, 1920, 0, 500, 2**32 - 480])
def test_other_steps_are_no_slow_clock(step):
    assert scales(SlowClock(), [step] * 8) == [1] * 8


def test_what_is_not_in_a_row_shows_no_slow_clock():
    clock = SlowClock()
    assert scales(clock, [480] * 9, missing={3, 6}) == [1] * 7
    assert scales(SlowClock(), [480] * 9, restart={3, 6}) == [1] * 9
    # Nor do steps that differ.
    assert scales(SlowClock(), [0, 480, 480, 320, 320, 480, 480]) == [1] * 7
    assert scales(SlowClock(), [0, 480, 480, 960, 480, 480, 480]) == [1] * 6 + [2]
    # A malformed packet is not counted, and interrupts the row.
    assert scales(SlowClock(), [480] * 4, payload=b"") == [1] * 4
