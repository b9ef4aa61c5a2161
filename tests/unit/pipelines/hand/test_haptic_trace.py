"""Rows of haptic samples: collected while somebody reads, and read back as they were."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS
from pipelines.hand.haptic_trace import (
    BLOCK_ROWS,
    ROW,
    HapticTrace,
    flags_of,
    lit_of,
    rows_of,
    state_of,
)
from pipelines.hand.haptics import JoystickEnd, RobotEnd, robot_side
from pipelines.session.probe import Probe
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.envelope import SafetyEnvelope


def test_rows_are_read_back_as_they_were_with_axes_by_name():
    trace = HapticTrace()
    trace.handle_watched(True)
    rows = [
        (k * NS_PER_MS + 2**40, 0.001 * k, -0.5, 1.5, float("nan"), 1e5, k)
        for k in range(BLOCK_ROWS + 1)
    ]
    # In every second cycle a sample is sent, in every third one or two are received.
    counts = [(65_530 + k // 2, k // 3, 2 * (k // 3)) for k in range(BLOCK_ROWS + 1)]
    for row, count in zip(rows[:-1], counts[:-1], strict=True):
        trace.add((*row, *count))
    assert trace.poll_block() is None
    trace.add((*rows[-1], *counts[-1]))
    block = trace.poll_block()
    assert trace.poll_block() is None
    assert block is not None and len(block) == BLOCK_ROWS * ROW.itemsize
    found = rows_of(block)
    assert found.dtype == ROW and ROW.itemsize == 40
    sent = [(65_530 + k // 2) % 65_536 if k % 2 else -1 for k in range(BLOCK_ROWS)]
    received = [2 * (k // 3) if k and k % 3 == 0 else -1 for k in range(BLOCK_ROWS)]
    told = [(*row, one, other) for row, one, other in zip(rows[:-1], sent, received, strict=True)]
    assert found.tobytes() == np.array(told, ROW).tobytes()
    trace = HapticTrace(("z", "gripper"))
    trace.handle_watched(True)
    for k in range(BLOCK_ROWS + 1):
        trace.add((k, 0.1, 0.2, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0.25, 0.5, 0.75, *[k] * 3))
    found = rows_of(trace.poll_block())
    assert [found[name][3] for name in ("z_m", "z_n", "z_uj", "gripper_m")] == [0.25, 0.5, 0.75, 3]


def test_nothing_is_collected_without_a_reader_and_readers_are_looked_for_ten_times_a_second():
    trace = HapticTrace()
    asked = 0
    for k in range(1000):
        asked += trace.asks(k * NS_PER_MS)
        trace.add((k, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0, 0))
    assert asked == 10 and trace.rows is None and trace.poll_block() is None
    trace.handle_watched(True)
    trace.add((1, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0, 0))
    # Looked for again: the block that is begun stays.
    trace.handle_watched(True)
    assert trace.rows is not None and len(trace.rows) == 1
    trace.handle_watched(False)
    assert trace.rows is None


@pytest.mark.parametrize("lit", [None, 0, 4])
@pytest.mark.parametrize("state", JoystickState)
def test_flags_have_state_and_led(state, lit):
    flags = flags_of(contact=True, dead_man=False, acted=True, state=state, lit=lit)
    assert flags & 0xFF == 0b101
    assert (state_of(flags), lit_of(flags)) == (state, lit)


def test_both_ends_trace_what_they_felt():
    robot = RobotEnd(Probe(), robot_side(SafetyEnvelope(), life=1))
    joystick = JoystickEnd(Probe(), life=2)
    blocks = {robot: [], joystick: []}
    for end in blocks:
        end.trace.handle_watched(True)
    for k in range(4000):
        now_ns = k * NS_PER_MS
        for end in (robot, joystick):
            end.handle_cycle(now_ns, NS_PER_MS)
            block = end.trace.poll_block()
            if block is not None:
                blocks[end].append(rows_of(block))
        for one, other in ((robot, joystick), (joystick, robot)):
            sample = one.poll_transmit(now_ns)
            if sample is not None:
                other.handle_datagram(sample, now_ns)
    tip, handle = (np.concatenate(blocks[end]) for end in (robot, joystick))
    # The last block is not whole.
    assert len(tip) == len(handle) == 4000 - BLOCK_ROWS
    for one, other in ((tip, handle), (handle, tip)):
        sent = one["sent"][one["sent"] >= 0]
        assert len(sent) > 3900 and (np.diff(sent) == 1).all()
        assert set(other["received"][other["received"] >= 0]) <= {*sent, sent[-1] + 1}
    assert (np.diff(tip["time_ns"]) == NS_PER_MS).all()
    touching = (tip["flags"] & 1).astype(bool)
    assert touching.any()
    # The wall pushes to the left, and the handle feels it.
    assert (tip["fx_n"][touching] <= 0).all() and tip["fx_n"].min() < -2.0
    assert handle["fx_n"].min() < -2.0
    assert abs(handle["x_m"][-1] - tip["x_m"][-1]) < 0.05
    assert {state_of(int(flags)) for flags in tip["flags"][100:]} == {JoystickState.APPLICATION}
    assert {lit_of(int(flags)) for flags in handle["flags"]} >= {0, 1}
