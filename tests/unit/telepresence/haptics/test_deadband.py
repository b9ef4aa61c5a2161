"""Deadband: which samples are sent; none left out counts as lost, and all stays passive."""

from itertools import pairwise
from math import hypot

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.deadband import (
    COMMAND_ENERGY_UJ,
    FEEDBACK_ENERGY_UJ,
    FORCE_FLOOR_N,
    FORCE_SHARE,
    LONGEST_PAUSE_NS,
    POSITION_FLOOR_M,
    WHOLE_NS,
    command_deadband,
    feedback_deadband,
)
from telepresence.haptics.latency import LatencyMatcher
from telepresence.haptics.loop import MAX_AGE_NS, joystick_link, robot_link
from telepresence.haptics.sample import Command, Feedback

REST = Feedback(-5.0, 0.0, 100, True)
COMMAND = Command(0.01, 0.0, 0)


def sent(deadband, values, holding=False):
    """Return the cycles, counted from 0, whose samples are sent; one cycle a millisecond."""
    return [
        k
        for k, value in enumerate(values)
        if deadband.handle_sample(value, holding, k * NS_PER_MS) is not None
    ]


def test_an_unchanged_value_is_repeated_so_that_two_samples_may_be_lost():
    band = feedback_deadband()
    cycles = sent(band, [REST] * 100)
    assert {b - a for a, b in pairwise(cycles)} == {LONGEST_PAUSE_NS // NS_PER_MS}
    assert 3 * LONGEST_PAUSE_NS < MAX_AGE_NS
    assert band.left_out == band.samples - len(cycles) == 100 - len(cycles)


@pytest.mark.parametrize(
    ("begin", "news"),
    [
        (REST, {"contact": False}),
        (REST, {"mode": 1}),
        (REST, {"lit": 2}),
        (REST, {"halted": True}),
        (REST, {"fx_n": -5.0 * (1 + FORCE_SHARE) - 0.001}),
        (REST, {"fy_n": 5.0 * FORCE_SHARE + 0.001}),
        (REST, {"energy_uj": 100 + FEEDBACK_ENERGY_UJ}),
        (COMMAND, {"dead_man": False}),
        (COMMAND, {"state": 4}),
        (COMMAND, {"buttons": 1}),
        (COMMAND, {"halted": True}),
        (COMMAND, {"energy_uj": COMMAND_ENERGY_UJ}),
    ],
)
def test_a_changed_field_is_sent_at_once(begin, news):
    band = feedback_deadband() if begin is REST else command_deadband()
    assert sent(band, [begin, begin, begin._replace(**news)]) == [0, 2]


def test_losing_the_peer_is_sent_at_once_and_what_the_controller_did_with_the_next_sample():
    band = feedback_deadband()
    assert band.handle_sample(REST, False, 0) == REST
    assert band.handle_sample(REST, False, NS_PER_MS) is None
    assert band.handle_sample(REST, True, 2 * NS_PER_MS) == REST
    assert band.handle_sample(REST._replace(acted=True), True, 3 * NS_PER_MS) is None
    later_ns = 2 * NS_PER_MS + LONGEST_PAUSE_NS
    assert band.handle_sample(REST, True, later_ns).acted
    assert not band.handle_sample(REST, True, later_ns + LONGEST_PAUSE_NS).acted


def test_the_band_of_a_fast_hand_is_wider():
    def worst_m(speed_m_s):
        band, held, worst = command_deadband(), None, 0.0
        for k in range(200):
            value = Command(speed_m_s * k / 1000, 0.0, 0)
            if band.handle_sample(value, False, k * NS_PER_MS) is not None:
                held = value
            if k >= 100:
                worst = max(worst, value.x_m - held.x_m)
        return worst

    assert 0 < worst_m(0.01) <= POSITION_FLOOR_M
    assert POSITION_FLOOR_M < worst_m(0.3) <= POSITION_FLOOR_M + 0.3 * 0.001


forces = st.floats(-65, 65, allow_nan=False)


@given(st.lists(st.tuples(forces, forces, st.integers(0, 300)), min_size=1, max_size=60))
def test_the_held_value_stays_within_the_band(steps):
    band = feedback_deadband()
    held, held_k, energy_uj = None, 0, 0
    for k, (fx_n, fy_n, more_uj) in enumerate(steps):
        energy_uj += more_uj
        value = Feedback(fx_n, fy_n, energy_uj, True)
        if band.handle_sample(value, False, k * NS_PER_MS) is not None:
            held, held_k = value, k
        room_n = max(FORCE_SHARE * hypot(held.fx_n, held.fy_n), FORCE_FLOOR_N)
        assert hypot(fx_n - held.fx_n, fy_n - held.fy_n) <= room_n
        assert energy_uj - held.energy_uj < FEEDBACK_ENERGY_UJ
        assert k - held_k < LONGEST_PAUSE_NS // NS_PER_MS


def linked(cycles, felt, *, loses=range(0)):
    """Drive both links with a deadband, half a millisecond apart; yield once a cycle.

    felt: what the robot feels in a cycle. loses: cycles in which the joystick hears nothing.
    """
    robot, joystick = robot_link(deadband=True), joystick_link(deadband=True)
    for k in range(cycles):
        now_ns = k * NS_PER_MS
        robot.handle_local(felt(k), now_ns)
        joystick.handle_local(Command(0.0, 0.0, k), now_ns)
        up, down = robot.poll_transmit(now_ns), joystick.poll_transmit(now_ns)
        if up is not None and k not in loses:
            joystick.handle_datagram(up, now_ns + NS_PER_MS // 2)
        if down is not None:
            robot.handle_datagram(down, now_ns + NS_PER_MS // 2)
        yield robot, joystick, up is not None


def test_a_sample_left_out_does_not_count_as_lost():
    def push_n(k):
        # Pressed, released and pressed again, with pauses between.
        return 5.0 if k // 200 % 2 else 0.0

    def felt(k):
        return Feedback(-push_n(k), 0.0, k, push_n(k) > 0)

    for k, (robot, joystick, _) in enumerate(linked(3000, felt)):  # noqa: B007
        latest = joystick.latest(k * NS_PER_MS + NS_PER_MS // 2)
        # Greetings come first.
        assert k < 5 or (joystick.hearing and latest.contact == (push_n(k) > 0))
    report, told = joystick.received_metrics(), robot.sent_metrics()
    assert report.received == told.sent < 600
    assert report.lost == report.late == report.restarts == report.garbage == 0
    assert told.left_out + told.sent + report.greetings + report.echoes == 3000
    matcher = LatencyMatcher()
    matcher.handle_sent(robot.take_sent_stamps())
    matcher.handle_received(joystick.take_received_stamps())
    latencies = [ns for _, ns in matcher.take_matches_ns(3000 * NS_PER_MS)]
    assert len(latencies) == report.received and set(latencies) == {NS_PER_MS // 2}


def test_where_the_peer_misses_samples_none_is_left_out_for_a_while():
    """Pauses between samples would stretch a burst of losses."""
    found_ms, lost_ms = 1000, 1000 + 3 * MAX_AGE_NS // NS_PER_MS
    whole_ms = WHOLE_NS // NS_PER_MS
    run = linked(lost_ms + whole_ms + 1000, lambda _: REST, loses=range(found_ms, lost_ms))
    sent = [sent for _, _, sent in run]
    # A joystick that hears nothing at the start has missed nothing.
    assert sum(sent[100:found_ms]) < found_ms / 5
    assert all(sent[lost_ms:whole_ms])
    assert sum(sent[lost_ms + whole_ms :]) < 1000 / 5


def test_without_a_deadband_every_sample_is_sent():
    link = robot_link()
    link.handle_local(REST, 0)
    assert link.poll_transmit(0) is not None
    link.handle_local(REST, NS_PER_MS)
    assert link.poll_transmit(NS_PER_MS) is not None
    assert link.sent_metrics().left_out is None
