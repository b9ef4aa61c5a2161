"""The paired runs of protection: percentiles by nearest rank, pairs in their order, and targets."""

from pipelines.bench.link.paired import (
    PLAIN,
    PROTECTED,
    REKEYED,
    EndFigures,
    PairedRun,
    delays_us,
    headlines,
)


def run(way, p99_us, cpu_percent, *, late_us=50.0, slips=1):
    lateness_us = {"p99": late_us, "p99.9": 2 * late_us}
    end = EndFigures(cpu_percent=cpu_percent, lateness_us=lateness_us, slips=slips, sessions=1)
    delay_us = {"p50": 500.0, "p99": p99_us, "p99.9": 900.0}
    return PairedRun(
        way=way,
        delay_us={"uplink": delay_us, "downlink": delay_us},
        samples=1000,
        frames_lost=0,
        ends={"ground": end, "space": end},
    )


def added(runs):
    """By what was added: its value and whether the target is met."""
    return {line.what: (line.value, line.met) for line in headlines(runs) if line.met is not None}


def test_percentiles_are_by_nearest_rank():
    found = delays_us([1000 * n for n in range(1, 1001)])
    assert found == {"p50": 500.0, "p99": 990.0, "p99.9": 999.0}
    assert delays_us([7000]) == {"p50": 7.0, "p99": 7.0, "p99.9": 7.0}
    assert delays_us([]) == {}


def test_what_protection_adds_is_the_median_of_the_pairs():
    # The machine's load changes from pair to pair, and falls on both runs of a pair.
    runs = []
    for load_us, more_us, more_percent in ((0, 40, 2), (900, 60, 6), (100, 200, 7)):
        runs.append(run(PLAIN, 600 + load_us, 10))
        runs.append(run(PROTECTED, 600 + load_us + more_us, 10 + more_percent, late_us=90.0))
        runs.append(run(REKEYED, 5000, 90, late_us=95.0, slips=3))
    assert added(runs) == {
        "added to a sample's way, uplink, p99": (60, True),
        "added to a sample's way, downlink, p99": (60, True),
        "added to the CPU of the ground gateway": (6, False),
        "added to the CPU of the space gateway": (6, False),
        "added to the lateness of slots of the ground gateway, p99": (40, False),
        "added to the lateness of slots of the space gateway, p99": (40, False),
    }
    renewed = {line.what: line.value for line in headlines(runs) if "by new keys" in line.what}
    assert renewed == {
        "added by new keys to the lateness of slots of the ground gateway, p99.9": 10,
        "added by new keys to the slots of the ground gateway left out": 2,
        "added by new keys to the lateness of slots of the space gateway, p99.9": 10,
        "added by new keys to the slots of the space gateway left out": 2,
    }


def test_without_runs_nothing_is_claimed():
    assert added([]) == {}
    assert all(line.value is None for line in headlines([]))
