"""Deadband: which samples are sent, which are left out, and that none of them counts as lost."""

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
    "news",
    [
        {"contact": False},
        {"mode": 1},
        {"lit": 2},
        {"halted": True},
        {"fx_n": -5.0 * (1 + FORCE_SHARE) - 0.001},
        {"fy_n": 5.0 * FORCE_SHARE + 0.001},
        {"energy_uj": 100 + FEEDBACK_ENERGY_UJ},
    ],
)
def test_a_changed_field_of_the_robot_is_sent_at_once(news):
    assert sent(feedback_deadband(), [REST, REST, REST._replace(**news)]) == [0, 2]


@pytest.mark.parametrize(
    "news",
    [
        {"dead_man": False},
        {"state": 4},
        {"buttons": 1},
        {"halted": True},
        {"energy_uj": COMMAND_ENERGY_UJ},
    ],
)
def test_a_changed_field_of_the_joystick_is_sent_at_once(news):
    rest = Command(0.01, 0.0, 0)
    assert sent(command_deadband(), [rest, rest, rest._replace(**news)]) == [0, 2]


def test_losing_the_peer_is_sent_at_once():
    band = feedback_deadband()
    assert band.handle_sample(REST, False, 0) == REST
    assert band.handle_sample(REST, False, NS_PER_MS) is None
    assert band.handle_sample(REST, True, 2 * NS_PER_MS) == REST


def test_the_next_sample_says_that_the_controller_acted_meanwhile():
    band = feedback_deadband()
    band.handle_sample(REST, False, 0)
    assert band.handle_sample(REST._replace(acted=True), False, NS_PER_MS) is None
    assert band.handle_sample(REST, False, LONGEST_PAUSE_NS).acted
    assert not band.handle_sample(REST, False, 2 * LONGEST_PAUSE_NS).acted


def test_the_band_of_a_fast_hand_is_wider():
    def worst_m(speed_m_s):
        band, held, worst = command_deadband(), None, 0.0
        for k in range(200):
            value = Command(speed_m_s * k / 1000, 0.0, 0)
            if band.handle_sample(value, False, k * NS_PER_MS) is not None:
                held = value
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


def test_a_sample_left_out_does_not_count_as_lost():
    robot, joystick = robot_link(deadband=True), joystick_link(deadband=True)
    matcher = LatencyMatcher()
    events = []
    for k in range(3000):
        now_ns = k * NS_PER_MS
        # Pressed, released and pressed again, with pauses between.
        push = 5.0 if k // 200 % 2 else 0.0
        robot.handle_local(Feedback(-push, 0.0, k, push > 0), now_ns)
        joystick.handle_local(Command(0.0, 0.0, k), now_ns)
        up, down = robot.poll_transmit(now_ns), joystick.poll_transmit(now_ns)
        if up is not None:
            joystick.handle_datagram(up, now_ns + NS_PER_MS // 2)
        if down is not None:
            robot.handle_datagram(down, now_ns + NS_PER_MS // 2)
        felt = joystick.latest(now_ns + NS_PER_MS // 2)
        # Greetings come first.
        assert k < 5 or (felt is not None and felt.contact == (push > 0))
        while (event := joystick.next_event()) is not None:
            events.append(event)
    report, sent = joystick.received_figures(), robot.sent_figures()
    assert report.received == sent.sent < 600
    assert report.lost == report.late == report.restarts == report.garbage == 0
    assert sent.left_out + sent.sent + report.greetings == 3000
    assert len(events) == 1, "found once, never lost"
    matcher.handle_sent(robot.take_sent_stamps())
    matcher.handle_received(joystick.take_received_stamps())
    latencies = [ns for _, ns in matcher.take_matches_ns(3000 * NS_PER_MS)]
    assert len(latencies) == report.received and set(latencies) == {NS_PER_MS // 2}


def test_where_the_peer_misses_samples_none_is_left_out_for_a_while():
    """Pauses between samples would stretch a burst of losses."""
    robot, joystick = robot_link(deadband=True), joystick_link(deadband=True)
    found_ms, lost_ms = 1000, 1000 + 3 * MAX_AGE_NS // NS_PER_MS
    whole_ms = WHOLE_NS // NS_PER_MS
    sent = []
    for k in range(lost_ms + whole_ms + 1000):
        now_ns = k * NS_PER_MS
        robot.handle_local(REST, now_ns)
        joystick.handle_local(Command(0.0, 0.0, 0), now_ns)
        up, down = robot.poll_transmit(now_ns), joystick.poll_transmit(now_ns)
        sent.append(up is not None)
        if up is not None and not found_ms <= k < lost_ms:
            joystick.handle_datagram(up, now_ns)
        if down is not None:
            robot.handle_datagram(down, now_ns)
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
    assert link.sent_figures().left_out is None
