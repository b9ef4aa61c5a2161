"""The LED panel: the newest state is shown, acknowledged, and gone after 2 s of silence."""

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.tasks.definitions import Pattern
from telepresence.tasks.panel_picture import (
    DARK,
    SILENCE_NS,
    LedPanel,
    PanelPicture,
    PanelSender,
)

LED_3 = PanelPicture(Pattern.LEDS, 8)


def exchange(sender, panel, now_ns, lost=lambda: False):
    datagram = sender.poll_transmit(now_ns)
    if datagram is not None and not lost():
        panel.handle_datagram(datagram, now_ns)
    answer = panel.poll_transmit(now_ns)
    if answer is not None and not lost():
        sender.handle_datagram(answer, now_ns)


@given(st.integers(0, 2**32), st.integers(0, 9))
def test_over_a_path_that_loses_half_the_newest_state_is_shown_and_known(first, seed):
    sender, panel, random = PanelSender(first_number=first), LedPanel(), Random(seed)
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


def test_it_is_dark_after_two_seconds_of_silence_and_lit_by_the_next_datagram():
    sender, panel = PanelSender(), LedPanel()
    sender.show(LED_3, 0)
    exchange(sender, panel, 0)
    assert panel.picture(SILENCE_NS - 1) == LED_3
    assert panel.picture(SILENCE_NS) == DARK
    exchange(sender, panel, SILENCE_NS)
    assert panel.picture(SILENCE_NS) == LED_3


def test_a_late_state_is_not_shown_but_a_restarted_sender_is_heard():
    sender, panel = PanelSender(first_number=100), LedPanel()
    late = sender.poll_transmit(0)
    sender.show(LED_3, NS_PER_MS)
    exchange(sender, panel, NS_PER_MS)
    panel.handle_datagram(late, 2 * NS_PER_MS)
    assert panel.picture(2 * NS_PER_MS) == LED_3 and panel.late == 1
    panel.handle_datagram(late, NS_PER_S)
    assert panel.picture(NS_PER_S) == DARK


@given(st.binary(max_size=20))
def test_garbage_is_counted(octets):
    sender, panel = PanelSender(), LedPanel()
    sender.handle_datagram(octets, 0)
    panel.handle_datagram(octets, 0)
    assert (sender.garbage, panel.garbage) == (1, 1)
