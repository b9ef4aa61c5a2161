"""Opus packets by RFC 6716: their length, their flags, and senders whose clock is too slow."""

import pytest
from rtp_packets import received

from kontur_av.errors import ProtocolError
from kontur_av.rtp.payload_opus import SlowClock, holds_copy, is_pause, opus_samples

#: RFC 6716 table 2: by configuration, the length of a frame in samples at 48 kHz.
FRAMES = (*[480, 960, 1920, 2880] * 3, *[480, 960] * 2, *[120, 240, 480, 960] * 4)


def test_every_configuration_has_its_length():
    for config, samples in enumerate(FRAMES):
        for code, frames in ((0, 1), (1, 2), (2, 2)):
            assert opus_samples(bytes((config << 3 | code, 9))) == frames * samples
        most = 5760 // samples
        # The two highest bits of the count mean padding and a variable rate.
        assert opus_samples(bytes((config << 3 | 3, 0xC0 | most))) == most * samples
        for count in (0, most + 1):
            with pytest.raises(ProtocolError, match="120 ms is the most"):
                opus_samples(bytes((config << 3 | 3, count)))
    for octets in (b"", b"\3"):
        with pytest.raises(ProtocolError, match="Opus packet"):
            opus_samples(octets)


@pytest.mark.parametrize(
    ("octets", "pause", "copy"),
    [
        # One flag of a pause and one of a copy for each 20 ms, at 20, 10, 40 and 60 ms
        # (RFC 6716 sections 4.2.3 and 4.2.4).
        ("08 40", True, True),
        ("08 80", False, False),
        *(("00 c0", False, True), ("00 00", True, False)),
        *(("10 a0", False, True), ("10 40", False, False), ("10 20", True, True)),
        *(("18 90", False, True), ("18 20", False, False), ("18 10", True, True)),
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


@pytest.mark.parametrize(
    ("steps", "changes", "found"),
    [
        # RFC 7587 section 4.1: timestamps count 48 kHz. Three steps in a row show a slow clock.
        *(([5760 // n] * 5, {}, [1, 1, 1, n // 6, 1]) for n in (12, 18, 36)),
        *(([step] * 8, {}, [1] * 8) for step in (960, 1920, 0, 500, 2**32 - 480)),
        # In a row, and all the same.
        ([480] * 9, {"missing": {3, 6}}, [1] * 7),
        ([480] * 9, {"restart": {3, 6}}, [1] * 9),
        ([0, 480, 480, 320, 320, 480, 480], {}, [1] * 7),
        ([0, 480, 480, 960, 480, 480, 480], {}, [1] * 6 + [2]),
        # A malformed packet is not counted, and interrupts the row.
        ([480] * 4, {"payload": b""}, [1] * 4),
    ],
)
def test_three_steps_in_a_row_show_a_slow_clock(steps, changes, found):
    """changes: payload, and the numbers of packets that are missing or follow a restart."""
    clock, timestamp, scales = SlowClock(), 2**32 - 700, []
    for number, step in enumerate(steps):
        timestamp = (timestamp + step) & 0xFFFF_FFFF
        if number not in changes.get("missing", ()):
            payload, restart = changes.get("payload", b"\x08\x80"), changes.get("restart", ())
            packet = received(payload, number, timestamp=timestamp, restart=number in restart)
            scales.append(clock.handle_packet(packet))
    assert scales == found
