"""Rows of haptic samples: collected while somebody reads, and read back as they were."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS
from pipelines.hand import haptic_trace
from pipelines.hand.haptics import JoystickEnd, RobotEnd, robot_side
from pipelines.session.probe import Probe
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.envelope import SafetyEnvelope

#: Of the fields that the first version did not have.
LATER = (0.5,) * len(haptic_trace.LATER_FIELDS)


def test_rows_are_read_back_as_they_were_with_axes_by_name():
    trace = haptic_trace.HapticTrace()
    trace.handle_watched(True)
    rows = [
        (k * NS_PER_MS + 2**40, 0.001 * k, -0.5, 1.5, float("nan"), 1e5, *LATER, k)
        for k in range(haptic_trace.BLOCK_ROWS + 1)
    ]
    # In every second cycle a sample is sent, in every third one or two are received.
    counts = [(65_530 + k // 2, k // 3, 2 * (k // 3)) for k in range(haptic_trace.BLOCK_ROWS + 1)]
    for row, count in zip(rows[:-1], counts[:-1], strict=True):
        trace.add((*row, *count))
    assert trace.poll_block() is None
    trace.add((*rows[-1], *counts[-1]))
    block = trace.poll_block()
    assert trace.poll_block() is None
    assert block is not None and len(block) == haptic_trace.BLOCK_ROWS * haptic_trace.ROW.itemsize
    found = haptic_trace.rows_of(block)
    assert found.dtype == haptic_trace.ROW and haptic_trace.ROW.itemsize == 40 + 4 * len(LATER)
    sent = [(65_530 + k // 2) % 65_536 if k % 2 else -1 for k in range(haptic_trace.BLOCK_ROWS)]
    received = [2 * (k // 3) if k and k % 3 == 0 else -1 for k in range(haptic_trace.BLOCK_ROWS)]
    told = [(*row, one, other) for row, one, other in zip(rows[:-1], sent, received, strict=True)]
    assert found.tobytes() == np.array(told, haptic_trace.ROW).tobytes()
    trace = haptic_trace.HapticTrace(("z_m", "pan_rad"))
    trace.handle_watched(True)
    for k in range(haptic_trace.BLOCK_ROWS + 1):
        trace.add((k, 0.1, 0.2, 0.0, 0.0, 0.0, *LATER, 0, 0, 0, 0, 0.25, 0.5, 0.75, *[k] * 3))
    found = haptic_trace.rows_of(trace.poll_block())
    assert [found[name][3] for name in ("z_m", "z_n", "z_uj", "pan_rad")] == [0.25, 0.5, 0.75, 3]


def test_nothing_is_collected_without_a_reader_and_readers_are_looked_for_ten_times_a_second():
    trace = haptic_trace.HapticTrace()
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
    flags = haptic_trace.flags_of(contact=True, dead_man=False, acted=True, state=state, lit=lit)
    assert flags & 0xFF == 0b101
    assert (haptic_trace.state_of(flags), haptic_trace.lit_of(flags)) == (state, lit)


def test_both_ends_trace_what_they_felt():
    robot = RobotEnd(Probe(), robot_side(SafetyEnvelope(), boot_id=1))
    joystick = JoystickEnd(Probe(), boot_id=2)
    blocks = {robot: [], joystick: []}
    for end in blocks:
        end.trace.handle_watched(True)
    for k in range(4000):
        now_ns = k * NS_PER_MS
        for end in (robot, joystick):
            end.handle_cycle(now_ns, NS_PER_MS)
            block = end.trace.poll_block()
            if block is not None:
                blocks[end].append(haptic_trace.rows_of(block))
        for one, other in ((robot, joystick), (joystick, robot)):
            sample = one.poll_transmit(now_ns)
            if sample is not None:
                other.handle_datagram(sample, now_ns)
    tip, handle = (np.concatenate(blocks[end]) for end in (robot, joystick))
    # The last block is not whole.
    assert len(tip) == len(handle) == 4000 - haptic_trace.BLOCK_ROWS
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
    assert {haptic_trace.state_of(int(flags)) for flags in tip["flags"][100:]} == {
        JoystickState.APPLICATION
    }
    assert {haptic_trace.lit_of(int(flags)) for flags in handle["flags"]} >= {0, 1}
