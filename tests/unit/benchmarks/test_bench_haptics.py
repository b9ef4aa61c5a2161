"""`python -m benchmarks haptics`: cells, channel, schedule and the command."""

from collections import Counter
from itertools import pairwise

import pytest

from benchmarks.__main__ import main
from benchmarks.haptics.cell import Cell, full_grid, read_cell, small_grid
from benchmarks.haptics.channel import SampleChannel
from benchmarks.haptics.hands import HANDS
from benchmarks.haptics.plan import plan
from kontur_av.errors import ConfigError

MS = 1_000_000


def carried(channel, datagrams):
    """(instant in ms, number) of each arrival when one datagram a millisecond is sent."""
    arrived = []
    for now in range(datagrams + 2000):
        if now < datagrams:
            channel.handle_datagram(now.to_bytes(4), now * MS)
        while (data := channel.poll_transmit(now * MS)) is not None:
            arrived.append((now, int.from_bytes(data)))
    assert channel.poll_timeout() is None
    return arrived


def test_samples_overtake_each_other_within_the_jitter():
    arrived = carried(SampleChannel(seed="1", delay_ns=20 * MS, jitter_ns=50 * MS), 5000)
    assert sorted(number for _, number in arrived) == list(range(5000))
    waits = [now - number for now, number in arrived]
    assert (min(waits), max(waits)) == (21, 70)
    assert sum(after < before for (_, before), (_, after) in pairwise(arrived)) > 2000


@pytest.mark.parametrize("burst", [1.0, 10.0])
def test_loss_share_and_burst_length_are_as_configured(burst):
    channel = SampleChannel(seed="1", loss=0.3, burst=burst)
    there = {number for _, number in carried(channel, 60_000)}
    lost = [number for number in range(60_000) if number not in there]
    assert channel.lost == len(lost)
    assert len(lost) / 60_000 == pytest.approx(0.3, rel=0.1)
    bursts = sum(number - 1 in there for number in lost)
    # Independent losses also come in a row: 1 / (1 - loss) on average.
    assert len(lost) / bursts == pytest.approx(max(burst, 1 / 0.7), rel=0.1)


def test_an_outage_loses_new_datagrams_but_not_those_under_way():
    channel = SampleChannel(seed="1", delay_ns=5 * MS, dark=[(100 * MS, 200 * MS)])
    numbers = [number for _, number in carried(channel, 300)]
    assert numbers == [*range(100), *range(200, 300)]


def test_a_cell_is_read_and_a_wrong_one_is_refused():
    assert read_cell("delay=100, wall=2000") == Cell(delay=100.0, wall=2000.0)
    assert read_cell("hand=arm-2kg,delay=5") == Cell(delay=5.0, hand="arm-2kg")
    for text, mend in (
        ("delay", "NAME=VALUE"),
        ("colour=1", "NAME=VALUE"),
        ("delay=far", "a number"),
        ("delay=1001", "0 to 1000 ms"),
        ("delay=nan", "0 to 1000 ms"),
        ("loss=31", "0 to 30 %"),
        ("hand=third", "loose, soft, firm"),
    ):
        with pytest.raises(ConfigError, match=mend):
            read_cell(text)


def test_the_grids_reach_the_limits_of_the_claims():
    for grid in (list(small_grid()), list(full_grid())):
        assert len(set(grid)) == len(grid)
        for name, least, most in (
            ("delay", 0, 1000),
            ("jitter", 0, 50),
            ("loss", 0, 30),
            ("blackout", 0, 5),
        ):
            values = {getattr(cell, name) for cell in grid}
            assert (min(values), max(values)) == (least, most)
        assert max(cell.wall for cell in grid) == 5000
        assert {cell.hand for cell in grid} == set(HANDS)


def test_every_hand_meets_every_value_of_the_full_grid_about_equally_often():
    """Every hand in every cell would take hours."""
    cells = [cell for cell in full_grid() if cell.channel != "clean"]
    axes = (("delay", 6), ("wall", 3), ("jitter", 3), ("blackout", 3))
    for name, values in axes:
        counts = Counter((cell.hand, getattr(cell, name)) for cell in cells)
        even = len(cells) / len(HANDS) / values
        assert len(counts) == len(HANDS) * values
        assert all(0.7 * even < count < 1.3 * even for count in counts.values())


def test_taps_touch_four_times_a_second_before_the_hold():
    planned = plan(Cell(hand="taps"), 10.0)
    moves = [point.move_ns for point in planned.script[:-2]]
    assert set(moves) == {125 * MS}
    assert len(moves) == 2 * 4 * 5


def test_the_hold_comes_after_all_blackouts_and_is_long_enough_for_an_oscillation():
    for cell in full_grid():
        found = plan(cell, 10.0)
        begin, end = found.hold_ns
        assert end - begin >= 12 * cell.delay * MS
        assert all(until + cell.delay * MS < begin for _, until in found.down_dark + found.up_dark)
        script_ns = sum(point.move_ns + point.stay_ns for point in found.script)
        assert end < found.end_ns < script_ns


def test_a_wrong_option_is_refused_in_one_line(capsys):
    for options in (["--cell", "delay=5000"], ["--seconds", "1"], ["--jobs", "0"]):
        assert main(["haptics", *options]) == 2
        assert capsys.readouterr().err.count("\n") == 1
