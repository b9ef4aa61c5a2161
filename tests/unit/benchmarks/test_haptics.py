"""`python -m benchmarks haptics`: cells, channel, schedule and the command."""

from itertools import pairwise

import pytest
from positions import ROOT

from benchmarks.haptics.cell import BAND_NAMES, Cell, kept_cells, random_cells, read_cell
from benchmarks.haptics.channel import SampleChannel
from benchmarks.haptics.hands import HANDS
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


def test_samples_overtake_each_other_within_the_jitter_and_a_wrong_cell_is_refused():
    arrived = carried(SampleChannel(seed="1", delay_ns=20 * MS, jitter_ns=50 * MS), 5000)
    assert sorted(number for _, number in arrived) == list(range(5000))
    waits = [now - number for now, number in arrived]
    assert (min(waits), max(waits)) == (21, 70)
    assert sum(after < before for (_, before), (_, after) in pairwise(arrived)) > 2000
    assert read_cell("delay=100, wall=2000") == Cell(delay=100.0, wall=2000.0)
    assert read_cell("hand=arm-2kg,delay=5") == Cell(delay=5.0, hand="arm-2kg")
    for text, fix in (
        *(("delay", "NAME=VALUE"), ("colour=1", "NAME=VALUE"), ("delay=far", "a number")),
        *(("delay=1001", "0 to 1000 ms"), ("delay=nan", "0 to 1000 ms"), ("loss=31", "0 to 30 %")),
        ("hand=third", "loose, soft, firm"),
    ):
        with pytest.raises(ConfigError, match=fix):
            read_cell(text)


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


def test_the_small_grid_reaches_the_limits_of_the_claims_and_random_cells_meet_every_value():
    grid, traces = kept_cells("small.txt"), kept_cells("traces.txt")
    assert len(set(grid)) == len(grid) == 69
    assert len({cell.name for cell in traces}) == 20
    limits = {"delay": (0, 1000), "jitter": (0, 50), "loss": (0, 30), "blackout": (0, 5)}
    for name, ends in limits.items():
        values = {getattr(cell, name) for cell in grid}
        assert (min(values), max(values)) == ends
    assert max(cell.wall for cell in grid) == 5000
    assert {cell.hand for cell in grid} == {cell.hand for cell in traces} == set(HANDS)
    page = (ROOT / "docs" / "experiments" / "haptic-traces.md").read_text(encoding="utf-8")
    assert all(f"`{cell.name}`" in page for cell in traces)
    cells = list(random_cells(300, seed=3))
    assert cells == list(random_cells(300, seed=3)) != list(random_cells(300, seed=4))
    assert len({cell.setting for cell in cells}) == 300
    assert all(read_cell(cell.name) == cell for cell in cells)
    met = {name: {getattr(cell, name) for cell in cells} for name in ("hand", "restart", "at")}
    restarts = {"none", "joystick", "robot", "both"}
    assert met == {"hand": set(HANDS), "restart": restarts, "at": {"contact", "free"}}
    assert {cell.band for cell in cells} == set(BAND_NAMES[:-1])
    angles = [cell.angle for cell in cells]
    assert min(angles) < -150 < 150 < max(angles)
