"""The LED panel: its datagrams octet by octet; the newest state is shown, and gone after 2 s."""

from binascii import crc_hqx
from contextlib import suppress
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.tasks import panel_picture as panels
from telepresence.tasks.definitions import Pattern
from telepresence.tasks.panel_picture import DARK, SILENCE_NS, PanelPicture

LED_3 = PanelPicture(Pattern.LEDS, 8)
#: Their checks come from a calculation bit by bit.
VECTORS = [
    ("4c01 00000001 00 00 000000 0000 0000 cc19", 1, DARK),
    ("4c01 01020304 01 81 fff4d6 0000 0000 ac60", 0x01020304, PanelPicture(Pattern.LEDS, 0x81)),
    (
        "4c01 ffffffff 02 00 00ff00 ee6c 03e8 2c48",
        0xFFFFFFFF,
        PanelPicture(Pattern.SPOT, spot_m=(-0.045, 0.01), colour=(0, 255, 0)),
    ),
]


@pytest.mark.parametrize(("octets", "number", "picture"), VECTORS)
def test_a_state_has_these_octets(octets, number, picture):
    packed = panels.pack_picture(number, picture)
    assert packed == bytes.fromhex(octets)
    found, parsed = panels.parse_picture(packed)
    assert found == number and panels.pack_picture(number, parsed) == packed
    assert parsed.spot_m == pytest.approx(picture.spot_m)
    assert (parsed.pattern, parsed.leds, parsed.colour) == (
        *(picture.pattern, picture.leds),
        picture.colour,
    )


def test_an_acknowledgement_has_these_octets():
    assert panels.pack_acknowledgement(0x01020304).hex(" ") == "41 01 01 02 03 04 86 f2"
    assert panels.parse_acknowledgement(panels.pack_acknowledgement(7)) == 7


def test_each_bit_is_checked():
    for octets, parse in (
        (panels.pack_picture(9, LED_3), panels.parse_picture),
        (panels.pack_acknowledgement(9), panels.parse_acknowledgement),
    ):
        whole = int.from_bytes(octets, "big")
        for bit in range(8 * len(octets)):
            with pytest.raises(ProtocolError):
                parse((whole ^ 1 << bit).to_bytes(len(octets), "big"))


@given(st.integers(0, 2**32 - 1), st.data())
def test_a_changed_state_with_a_right_check_is_refused_or_packs_to_the_same_octets(number, data):
    picture = PanelPicture(data.draw(st.sampled_from(list(Pattern)[1:])), 5, (0.1, -0.3))
    octets = bytearray(panels.pack_picture(number, picture)[:-2])
    for _ in range(data.draw(st.integers(0, 3))):
        octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
    whole = bytes(octets) + crc_hqx(octets, 0xFFFF).to_bytes(2, "big")
    with suppress(ProtocolError):
        assert panels.pack_picture(*panels.parse_picture(whole)) == whole


def exchange(sender, panel, now_ns, lost=lambda: False):
    datagram = sender.poll_transmit(now_ns)
    if datagram is not None and not lost():
        panel.handle_datagram(datagram, now_ns)
    answer = panel.poll_transmit(now_ns)
    if answer is not None and not lost():
        sender.handle_datagram(answer, now_ns)


@pytest.fixture
def ends():
    return panels.PanelSender(first_number=100), panels.LedPanel()


@given(st.integers(0, 2**32), st.integers(0, 9))
def test_over_a_path_that_loses_half_the_newest_state_is_shown_and_known(first, seed):
    sender, panel, random = panels.PanelSender(first_number=first), panels.LedPanel(), Random(seed)
    for number in range(20):
        at_ns = number * 5 * NS_PER_S
        picture = PanelPicture(Pattern.LEDS, 1 << number % 8)
        sender.show(picture, at_ns)
        assert not sender.shown
        for tick in range(40):
            now_ns = at_ns + tick * 100 * NS_PER_MS
            exchange(sender, panel, now_ns, lambda: random.random() < 0.5)
            if sender.shown:
                assert panel.picture(now_ns) == picture
        assert sender.shown


def test_it_is_dark_after_two_seconds_of_silence_and_lit_by_the_next_datagram(ends):
    sender, panel = ends
    sender.show(LED_3, 0)
    exchange(sender, panel, 0)
    assert panel.picture(SILENCE_NS - 1) == LED_3
    assert panel.picture(SILENCE_NS) == DARK
    exchange(sender, panel, SILENCE_NS)
    assert panel.picture(SILENCE_NS) == LED_3


def test_a_late_state_is_not_shown_but_a_restarted_sender_is_heard(ends):
    sender, panel = ends
    late = sender.poll_transmit(0)
    sender.show(LED_3, NS_PER_MS)
    exchange(sender, panel, NS_PER_MS)
    panel.handle_datagram(late, 2 * NS_PER_MS)
    assert panel.picture(2 * NS_PER_MS) == LED_3 and panel.late == 1
    panel.handle_datagram(late, NS_PER_S)
    assert panel.picture(NS_PER_S) == DARK


@given(st.binary(max_size=20))
def test_garbage_is_counted(octets):
    for end in (panels.PanelSender(), panels.LedPanel()):
        end.handle_datagram(octets, 0)
        assert end.garbage == 1
