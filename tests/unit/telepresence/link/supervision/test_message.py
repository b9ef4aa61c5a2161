"""The supervision message octet by octet, as docs/wire-formats.md defines it, and its pacing."""

from binascii import crc_hqx
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_supervision_pair import GROUND, SPACE, alive

from kontur_av.errors import ConfigError
from telepresence.link.flows import Level, packet_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.repair.reserve import Loss
from telepresence.link.supervision.message import (
    Configuration,
    LinkState,
    MessageKind,
    MessagePacing,
    SupervisionMessage,
    SupervisionTiming,
    message_version,
    pack_message,
    parse_message,
)

MS, S = 1_000_000, 1_000_000_000
TIMING = SupervisionTiming()
words, longs = st.integers(0, 65535), st.integers(0, (1 << 24) - 1)
MESSAGES = st.builds(
    SupervisionMessage,
    st.integers(1, 15),
    st.sampled_from([kind for kind in MessageKind if kind is not MessageKind.CLOCK]),
    st.sampled_from(LinkState),
    *([st.booleans()] * 5),
    *(st.integers(1, 65535), words, words),
    st.tuples(words, words),
    *([st.integers(0, (1 << 24) - 1)] * 2),
    st.builds(Loss, words, words),
)


def told(message):
    """What its kind tells of a message."""
    rates = message.kind in (MessageKind.CONFIGURE, MessageKind.REJECT)
    if message.kind not in (MessageKind.ALIVE, MessageKind.CONFIRM):
        message = message._replace(loss=Loss())
    if message.kind is MessageKind.HELLO:
        return message._replace(heard=0, rates_kbps=(0, 0))
    message = message._replace(number=0, echo=0)
    return message if rates else message._replace(rates_kbps=(0, 0))


@given(MESSAGES)
def test_a_message_is_read_as_it_was_written(message):
    data = pack_message(message)
    wrong_side = MessageKind.CONFIRM if message.master else MessageKind.CONFIGURE
    expected = None if message.kind is wrong_side else told(message)
    assert len(data) == 12 and parse_message(data) == expected
    assert message_version(data) == message.version
    for bad in (data[:-1], data + b"\0", b""):
        assert parse_message(bad) is None and message_version(bad) == 0


def message(**changes):
    table = {"version": 4, "boot_id": 0x0102, "heard": 0x0304, "digest": 0x0506}
    return alive(**{**table, **changes})


def test_bits_are_where_the_table_says():
    assert pack_message(message()) == bytes.fromhex("40 6a 0102 0304 0506 00000000")
    flags = {"master": 0x10, "signal": 8, "application": 4, "fresh": 2, "sending": 1}
    for name, flag in flags.items():
        one = message(**{**dict.fromkeys(flags, False), name: True}, state=LinkState.REFUSED)
        assert pack_message(one)[1] == 0xA0 | flag
    configure = message(kind=MessageKind.CONFIGURE, master=True, rates_kbps=(256, 4000))
    assert pack_message(configure) == bytes.fromhex("41 7a 0102 0304 0506 01000fa0")
    hello = message(kind=MessageKind.HELLO, heard=0, number=0xABCDEF, echo=0x123456)
    assert pack_message(hello) == bytes.fromhex("44 6a 0102 0506 abcdef 123456")


@pytest.mark.parametrize(
    ("octets", "what"),
    [
        ("009d1234abcd55aa0700ff01", "version 0"),
        ("159d1234abcd55aa0700ff01", "kind 5"),
        ("10dd1234abcd55aa0700ff01", "state 6"),
        ("109d0000abcd55aa0700ff01", "life 0"),
        ("129d1234abcd55aa0700ff01", "CONFIRM of a master"),
        ("118d1234abcd55aa0700ff01", "CONFIGURE of a slave"),
        ("109d1234abcd55aa0700ff", "too short"),
        ("109d1234abcd55aa0700ff0101", "too long"),
        ("", "nothing"),
    ],
)
def test_impossible_messages_are_refused(octets, what):
    assert parse_message(bytes.fromhex(octets)) is None, what


def test_messages_come_at_once_on_a_change_then_fast_then_slowly():
    """10 ms apart at least; 20 ms for 2 s; then 0.5 s, or 50 ms to a peer that may not hear."""
    pacing = MessagePacing(TIMING, 0)
    assert (pacing.due_ns, pacing.earliest_ns) == (0, 0)

    def due(now_ms, content=(1,), *, heard=True, settled=False):
        pacing.handle_content(content, now_ms * MS, heard=heard, settled=settled)
        return pacing.due_ns // MS

    assert due(0) <= 0
    pacing.handle_sent((1,), 0)
    assert pacing.earliest_ns == 10 * MS
    assert due(1) == due(1999) == 20
    assert due(2000) == 500 and due(2000, heard=False) == 50
    assert due(1, settled=True) == 500
    assert due(1, content=(2,), settled=True) == 10
    pacing.handle_sent((2,), 3000 * MS)
    assert due(3001, content=(2,)) == 3500
    # The 2 s count from the change, not from its message.
    assert due(3002, content=(3,)) == 3010
    pacing.handle_sent((3,), 3010 * MS)
    assert due(5001, content=(3,)) == 3030
    assert due(5002, content=(3,)) == 3510
    # Another message keeps its distance, too.
    pacing.handle_extra(3505 * MS)
    assert due(5003, content=(3,)) == 3515


@pytest.mark.parametrize("field", list(vars(TIMING)))
def test_each_wait_is_positive(field):
    for value in (0, -1):
        with pytest.raises(ConfigError, match=f"supervision {field} is {value}: it must be posi"):
            replace(TIMING, **{field: value})


def test_waits_between_messages_rise():
    equal = SupervisionTiming(spacing_ns=5, fast_ns=5, search_ns=5, slow_ns=5, round_trip_ns=7)
    assert equal.answer_ns == 28
    for field, value in (("spacing_ns", 6), ("fast_ns", 6), ("search_ns", 6)):
        with pytest.raises(ConfigError, match="must rise in this order"):
            replace(equal, **{field: value})


TEXT = """\
32 12 1000000 75 0 1
tc 0 raw 0 0
voice 1 rtp 48000 960
500 12 1000000 76 1 0
tm 0 raw 0 0
"""


def test_both_ends_digest_the_same_text_with_the_masters_way_out_first():
    up, down = [packet_flow("tc", Level.TMTC), voice_flow("voice")], [packet_flow("tm", Level.TMTC)]
    ways = {"transmit_flows": up, "receive_flows": down}
    ground = Configuration(transmit=UPLINK, receive=DOWNLINK, **ways)
    space = Configuration(transmit=DOWNLINK, transmit_flows=down, receive=UPLINK, receive_flows=up)
    assert ground.text(master=True) == space.text(master=False) == TEXT
    assert (
        ground.digest(master=True) == space.digest(master=False) == crc_hqx(TEXT.encode(), 0xFFFF)
    )
    # The digest includes which end is the master, because the directions differ.
    assert ground.digest(master=True) != space.digest(master=True)
    for change in ({"scid": 1}, {"vcid": 3}, {"insert_octets": 11}, {"slot_ns": 5}):
        other = replace(ground, transmit=replace(UPLINK, **change))
        assert other.digest(master=True) != ground.digest(master=True)


def test_a_configuration_tells_its_rates_and_has_a_version_of_four_bits():
    assert GROUND.rates_kbps() == (256, 4000) and SPACE.rates_kbps() == (4000, 256)
    fast = replace(DOWNLINK, slot_ns=10_000)
    assert replace(GROUND, receive=fast).rates_kbps() == (256, 65535)
    for version in (1, 15):
        assert replace(GROUND, version=version).version == version
    for version in (0, 16):
        with pytest.raises(ConfigError, match="must be from 1 to 15"):
            replace(GROUND, version=version)
