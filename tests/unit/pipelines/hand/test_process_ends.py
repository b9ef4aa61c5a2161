"""The joystick's process: what it makes of the inputs of a page."""

from types import SimpleNamespace

from pipelines.hand.hand_topics import pack_input
from pipelines.hand.process_ends import _hand
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.figures import HandInputFigures


def test_inputs_of_a_page_that_move_nothing_are_told():
    told, flushes = [], []
    inputs = [PageInput(False, x, 0.0, 0, number) for number, x in enumerate((0.5, 0.5, 7.0))]
    octets = iter([pack_input(one) for one in (*inputs, inputs[1])])
    reader = SimpleNamespace(latest_octets=lambda: next(octets))
    context = SimpleNamespace(
        on_flush=flushes.append, probe=SimpleNamespace(tell=lambda figures: told.append(figures))
    )
    bus = SimpleNamespace(reader=lambda _topic: reader)
    take = _hand(context, bus, PageDevice(start_m=(0.0, 0.0)), "input")
    for _ in range(4):
        take(0)
    flushes[0]()
    # One out of range, and one that came again.
    assert told == [HandInputFigures(inputs_ignored=2)]
