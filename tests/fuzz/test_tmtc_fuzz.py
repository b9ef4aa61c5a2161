"""Any octets: a packet is refused, or packing it again gives the same octets."""

import contextlib

from hypothesis import example, given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from telepresence.tmtc import (
    Housekeeping,
    SelectAck,
    SelectCamera,
    SpacePacket,
    TelecommandReceiver,
    TelecommandSender,
    pack_packet,
    parse_packet,
)

names = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), min_size=1, max_size=10)
tokens = st.integers(0, 65535)
messages = st.one_of(
    st.builds(SelectCamera, names, tokens),
    st.builds(SelectAck, names, tokens, st.booleans()),
    st.builds(
        Housekeeping, names, st.booleans(), st.integers(-32767, 32767).map(lambda n: n * 2e-3)
    ),
)


@given(messages, st.integers(0, 16383))
def test_round_trip(message: SelectCamera | SelectAck | Housekeeping, count: int) -> None:
    octets = pack_packet(message, count)
    assert len(octets) <= 20
    assert parse_packet(octets) == SpacePacket(count, message)


@given(messages, st.data())
def test_mutated_packets_are_refused_or_pack_to_the_same_octets(
    message: SelectCamera | SelectAck | Housekeeping, data: st.DataObject
) -> None:
    octets = bytearray(pack_packet(message, 0))
    for _ in range(data.draw(st.integers(1, 3))):
        octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ProtocolError):
        packet = parse_packet(bytes(octets))
        assert pack_packet(packet.message, packet.count) == bytes(octets)


@given(st.binary(max_size=32))
@example(bytes.fromhex("1101c005000801beef") + b"static")
def test_any_octets_are_counted_by_both_ends_and_never_raise(octets: bytes) -> None:
    receiver, sender = TelecommandReceiver(), TelecommandSender(first_token=0)
    receiver.handle_packet(octets, 0)
    sender.handle_packet(octets, 0)
    assert receiver.garbage == (receiver.next_event() is None)
    assert sender.garbage + sender.unexpected == (sender.next_event() is None)
