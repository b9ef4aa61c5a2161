"""The processes of robot and joystick: a robot without power, and the inputs of a page."""

from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from kontur_av.media import CaptureStamp
from kontur_av.returned import PartError
from pipelines.hand import partner_arm, process_ends, timed_calls
from pipelines.hand.hand_topics import HAND_INPUT_TOPIC
from pipelines.hand.process_ends import PageHand
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.haptic_metrics import HandInputMetrics


def test_inputs_of_a_page_that_move_nothing_are_told():
    told, flushes = [], []
    inputs = [PageInput(False, x, 0.0, 0, number) for number, x in enumerate((0.5, 0.5, 7.0))]
    samples = iter([*inputs, inputs[1]])
    lease = MagicMock(stamp=CaptureStamp(0, 0, "page"))
    lease.octets = lambda: HAND_INPUT_TOPIC.pack(next(samples))
    reader = SimpleNamespace(latest=lambda: lease)
    context = SimpleNamespace(
        on_flush=flushes.append, probe=SimpleNamespace(publish=lambda metrics: told.append(metrics))
    )
    bus = SimpleNamespace(reader=lambda _topic, depth: reader)
    hand = PageHand(context, bus, PageDevice(start_m=(0.0, 0.0)), HAND_INPUT_TOPIC)
    for _ in range(4):
        hand.take(0)
    flushes[0]()
    # One out of range, and one that came again.
    assert told == [HandInputMetrics(inputs_ignored=2)]


class Powered:
    """A robot that was built anew; it notes its calls, and fails at these."""

    def __init__(self, fails=(), *, emergency=False):
        self.calls, self.fails = [], fails
        if emergency:
            self.emergency_off = lambda: self.calls.append("emergency_off")

    def __getattr__(self, name):
        def call():
            self.calls.append(name)
            if name in self.fails:
                raise RuntimeError("E1")

        if name not in ("configure", "deactivate", "power_off"):
            raise AttributeError(name)
        return call


@pytest.mark.parametrize(
    ("robot", "calls", "said"),
    [
        (Powered(["deactivate"]), ["configure", "deactivate", "power_off"], ""),
        (Powered(["configure"]), ["configure", "deactivate", "power_off"], "configure() failed"),
        (Powered(["power_off"]), ["configure", "deactivate", "power_off"], "power_off() failed"),
        (Powered(emergency=True), ["emergency_off"], ""),
    ],
)
def test_the_power_of_a_robot_is_taken_by_a_driver_that_is_built_anew(
    robot, calls, said, monkeypatch
):
    monkeypatch.setattr(timed_calls, "load_robot", lambda spec, axes: robot)
    context = MagicMock(takes_power=True)
    with pytest.raises(PartError) if said else nullcontext() as refused:
        process_ends.run_robot(context)
    assert robot.calls == calls and said in str(refused and refused.value)
    robot.calls.clear()
    with pytest.raises(PartError) if said else nullcontext():
        partner_arm.run_second_robot(context)
    assert robot.calls == calls
