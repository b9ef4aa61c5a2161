"""Haptic samples and greetings are read back as written; malformed ones are refused."""

import struct
from math import inf, nan

import pytest
from haptic_samples import unpack_command, unpack_feedback
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from telepresence.haptics import sample
from telepresence.haptics.sample import (
    Command,
    Feedback,
    Greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
    read_command,
    read_feedback,
    read_greeting,
)

bits = st.booleans()
NO_MORE = st.just(())
counts = st.integers(-32767, 32767)
energies = st.integers(0, (1 << 24) - 1)
sequences, sessions = st.integers(0, 1 << 17), st.integers(1, 255)
COMMANDS = st.builds(
    Command,
    counts.map(lambda count: count * 20e-6),
    counts.map(lambda count: count * 20e-6),
    energies,
    *(bits, st.integers(0, 7), st.integers(0, 15), bits, bits, bits, bits, NO_MORE),
)
FEEDBACKS = st.builds(
    Feedback,
    counts.map(lambda count: count * 2e-3),
    counts.map(lambda count: count * 2e-3),
    energies,
    *(bits, st.integers(0, 3), st.none() | st.integers(0, 14), *[bits] * 5, NO_MORE),
)


@settings(max_examples=60)
@given(COMMANDS, FEEDBACKS, sequences, sessions, bits)
def test_a_sample_is_read_as_it_was_written(command, feedback, sequence, session, holding):
    for value, pack, read in (
        (command, pack_command, read_command),
        (feedback, pack_feedback, read_feedback),
    ):
        data = pack(sequence, value, holding, session)
        assert len(data) == 12
        number, counted, flags, got = read(data)
        assert (number, counted) == (session, sequence % 65536)
        assert got[2:] == value[2:] and got[:2] == pytest.approx(value[:2])
        assert bool(flags & sample.FLAG_HOLDING) is holding
        assert not flags & (sample.FLAG_SATURATED | sample.FLAG_GREETING)
        # A total counts from the beginning of its session.
        base = value.energy_uj // 3
        assert read(pack(sequence, value, session=session, base_uj=base))[3].energy_uj == (
            value.energy_uj - base
        )
        other = read_feedback if read is read_command else read_command
        with pytest.raises(ProtocolError, match="instead of a"):
            other(data)


def test_bits_are_where_the_table_says():
    assert pack_command(
        0x1234, Command(0.06, -0.05, 6_016_277, stop=True, blind=True, buttons=0b0101), session=7
    ) == bytes.fromhex("1234 11 5b 0bb8 f63c 07 5bcd15")
    assert pack_command(
        1, Command(0.0, 0.0, 0, dead_man=False, state=4, acted=True, halted=True), holding=True
    ) == bytes.fromhex("0001 2c 04 0000 0000 01 000000")
    assert pack_feedback(
        0xFFFF, Feedback(-7.0, 0.5, (1 << 24) - 1, True, lit=2, stopped=True), session=255
    ) == bytes.fromhex("ffff 81 3b f254 00fa ff ffffff")
    assert pack_feedback(
        2,
        Feedback(0.0, 0.0, 0, False, mode=1, acted=True, halted=True, waiting=True, blind=True),
        True,
    ) == bytes.fromhex("0002 bc 05 0000 0000 01 000000")


@pytest.mark.parametrize(
    ("positions", "counted"),
    [
        ((0.65534, -0.65534), (32767, -32767, 0)),
        ((0.655345, 0.0), (32767, 0, 0)),
        ((0.65536, -0.00005), (32767, -2, 2)),
        ((0.00005, -0.7), (2, -32767, 2)),
        ((inf, -inf), (32767, -32767, 2)),
    ],
)
def test_a_value_out_of_range_is_cut_and_flagged(positions, counted):
    for data in (
        pack_command(0, Command(*positions, 1 << 30, dead_man=False)),
        pack_feedback(0, Feedback(*(100.0 * position for position in positions), 1 << 30, False)),
    ):
        flags, x, y, energy = struct.unpack(">xxBxhhI", data)
        assert (x, y, flags & 2) == counted
        # A total saturates, it never wraps.
        assert energy == 0x01FFFFFF


def test_a_bug_of_the_caller_raises():
    for bad in (Command(nan, 0.0, 0), Command(0.0, nan, 0), Command(0.0, 0.0, 0, state=8)):
        with pytest.raises(ValueError, match=r"NaN|no state 8"):
            pack_command(0, bad)
    for worse in (Feedback(nan, 0.0, 0, True), Feedback(0.0, 0.0, 0, True, mode=4)):
        with pytest.raises(ValueError, match=r"NaN|no mode 4"):
            pack_feedback(0, worse)


@pytest.mark.parametrize("feedback", [False, True])
def test_what_is_never_sent_is_refused(feedback):
    read = unpack_feedback if feedback else unpack_command
    kind = 0x80 if feedback else 0
    good = [0, 0, kind, 3, 0, 1, 0, 1, 1, 0, 0, 0]
    read(bytes(good))
    changes = [
        ({2: kind ^ 0x80}, "instead of a"),
        ({4: 0x80, 5: 0}, "-32768 is never sent"),
        ({6: 0x80, 7: 0}, "-32768 is never sent"),
        ({8: 0}, "no session"),
        ({2: kind | 0x40}, "no session"),
    ]
    for change, words in changes:
        with pytest.raises(ProtocolError, match=words):
            read(bytes({**dict(enumerate(good)), **change}.values()))
    for length in (0, 11, 13):
        with pytest.raises(ProtocolError, match=f"{length} octets instead of 12"):
            read(bytes(length))


@given(
    st.integers(0, 255), st.integers(1, (1 << 32) - 1), st.integers(0, (1 << 32) - 1), bits, bits
)
def test_a_greeting_is_read_as_it_was_written(session, number, answers, partner, feedback):
    greeting = Greeting(session, number, answers, partner)
    for holding in (False, True):
        data = pack_greeting(greeting, feedback=feedback, holding=holding)
        assert data[2] == 0x40 | (0x80 if feedback else 0x08) | 0x20 * partner | 0x04 * holding
        assert sample.is_greeting(data) and not sample.is_greeting(data + b"\0")
        assert read_greeting(data, feedback=feedback) == greeting
        with pytest.raises(ProtocolError, match="other direction"):
            read_greeting(data, feedback=not feedback)
    for change in ({0: 1}, {3: 2}, {4: 0, 5: 0, 6: 0, 7: 0}):
        with pytest.raises(ProtocolError, match="octets 0 and 3"):
            read_greeting(bytes({**dict(enumerate(data)), **change}.values()), feedback=feedback)


@pytest.mark.parametrize(
    ("octets", "greeting", "feedback"),
    [
        # A joystick that sends in session 5 asks the life 0xbee100, and holds.
        ("0005 4c 00 00c0ffee 00bee100", Greeting(5, 0xC0FFEE, 0xBEE100), False),
        # The robot's life 0xbeef00 offers session 6 for that request.
        ("0006 c0 00 00beef00 00c0ffee", Greeting(6, 0xBEEF00, 0xC0FFEE), True),
    ],
)
def test_a_greeting_has_these_octets(octets, greeting, feedback):
    data = bytes.fromhex(octets)
    assert pack_greeting(greeting, feedback=feedback, holding=not feedback) == data
    assert read_greeting(data, feedback=feedback) == greeting
