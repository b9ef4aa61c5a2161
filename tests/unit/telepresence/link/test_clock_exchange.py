"""The peer's clock through an uneven path: the stated error always holds the truth."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from random import Random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from telepresence.link.clock_estimator import ClockEstimate, ClockEstimator
from telepresence.link.clock_exchange import ClockExchange

SLOT_NS = 10 * NS_PER_MS


@dataclass
class Path:
    """Delays of both ways: a floor, and an exponential tail above it."""

    there_ns: int
    back_ns: int
    jitter_ns: int = 0
    loss: float = 0.0
    seed: int = 0
    _random: Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = Random(self.seed)

    def delay_ns(self, *, there: bool) -> int | None:
        if self._random.random() < self.loss:
            return None
        tail = self._random.expovariate(1 / self.jitter_ns) if self.jitter_ns else 0
        return (self.there_ns if there else self.back_ns) + round(tail)


@dataclass
class Ends:
    """Two ends on true time; the clock of the second is shifted, drifts, and may be stepped."""

    path: Path
    offset_ns: int
    drift: float = 0.0
    start_ns: int = 10**15
    #: True time and size of a step of the second clock.
    step: tuple[int, int] | None = None

    def peer_ns(self, true_ns: int) -> int:
        shift_ns = self.offset_ns + round(self.drift * (true_ns - self.start_ns))
        if self.step is not None and true_ns >= self.start_ns + self.step[0]:
            shift_ns += self.step[1]
        return true_ns + shift_ns

    def run(self, seconds: float) -> Iterator[tuple[int, ClockEstimate | None, ClockExchange]]:
        """Yield true time, the first end's estimate and the first end, twice a second."""
        clocks = (lambda now_ns: now_ns, self.peer_ns)
        ends = tuple(
            ClockExchange(
                version=2,
                master=not number,
                life=number + 1,
                told_offset_ns=0,
                now_ns=clock(self.start_ns),
            )
            for number, clock in enumerate(clocks)
        )
        for number, end in enumerate(ends):
            end.handle_peer(2 - number, clocks[number](self.start_ns))
        under_way: list[tuple[int, int, bytes]] = []
        for slot in range(round(seconds * NS_PER_S / SLOT_NS)):
            true_ns = self.start_ns + slot * SLOT_NS
            for one in sorted(one for one in under_way if one[0] <= true_ns):
                under_way.remove(one)
                came_ns, to, data = one
                assert ends[to].handle_message(data, clocks[to](came_ns), heard=True)
            for number, end in enumerate(ends):
                now_ns = clocks[number](true_ns)
                if now_ns < end.next_ns:
                    continue
                data = end.poll_transmit(now_ns, now_ns)
                delay_ns = self.path.delay_ns(there=not number)
                if delay_ns is not None:
                    under_way.append((true_ns + delay_ns, 1 - number, data))
            if slot % 50 == 49:
                yield true_ns, ends[0].estimate(true_ns), ends[0]


def ms(most: int) -> st.SearchStrategy[int]:
    return st.integers(0, most * NS_PER_MS)


@settings(deadline=None, max_examples=40)
# Messages overtake each other while the stamp begins anew.
@example(0, 0, 300 * NS_PER_MS, 0.0, 32_180_001_697, -1, 34, 371)
@given(
    there_ns=ms(300),
    back_ns=ms(300),
    jitter_ns=st.sampled_from([0, 100 * NS_PER_US, 20 * NS_PER_MS, 300 * NS_PER_MS]),
    loss=st.sampled_from([0.0, 0.3]),
    # As far apart as clocks that nobody set: 30 years, in both directions.
    offset_ns=st.integers(-1800 * NS_PER_S, 1800 * NS_PER_S) | st.integers(-(10**18), 10**18),
    ppm=st.integers(-50, 50),
    wraps_in_s=st.integers(0, 60),
    seed=st.integers(0, 1000),
)
def test_the_stated_error_holds_the_truth(
    there_ns: int,
    back_ns: int,
    jitter_ns: int,
    loss: float,
    offset_ns: int,
    ppm: int,
    wraps_in_s: int,
    seed: int,
) -> None:
    # Stamps repeat every 2**32 µs, for one of the ends while this runs.
    start_ns = ((1 << 32) * 1000) * 400_000 - wraps_in_s * NS_PER_S + 123
    path = Path(there_ns, back_ns, jitter_ns, loss, seed)
    ends = Ends(path, offset_ns, ppm * 1e-6, start_ns)
    known = 0
    for true_ns, estimate, end in ends.run(90):
        assert end.report(true_ns).restarts == 0
        if estimate is None:
            continue
        known += 1
        truth_ns = ends.peer_ns(true_ns) - true_ns
        assert abs(truth_ns - estimate.offset_ns) <= estimate.error_ns
        assert abs(ppm * 1000 - estimate.drift_ppb) <= estimate.drift_error_ppb
    assert known > 100


def test_without_jitter_the_error_is_about_half_the_round_trip() -> None:
    path = Path(2 * NS_PER_MS, 2 * NS_PER_MS)
    ends = Ends(path, 12 * NS_PER_S, 50e-6)
    *_, (true_ns, estimate, _) = ends.run(60)
    assert estimate is not None
    # The delays are equal, so the middle is near the truth: within what drifted since they came.
    assert abs(ends.peer_ns(true_ns) - true_ns - estimate.offset_ns) < 120 * NS_PER_US
    assert estimate.error_ns < 2.4 * NS_PER_MS
    assert estimate.drift_error_ppb < 200_000


def test_jitter_costs_little() -> None:
    path = Path(NS_PER_MS, NS_PER_MS, jitter_ns=2 * NS_PER_MS, seed=1)
    *_, (_, estimate, _) = Ends(path, 0, 50e-6).run(60)
    assert estimate is not None
    assert estimate.error_ns < 1.5 * NS_PER_MS


@pytest.mark.parametrize("step_ns", [5 * NS_PER_S, -5 * NS_PER_S, 3 * NS_PER_MS])
def test_a_step_begins_the_estimate_anew(step_ns: int) -> None:
    ends = Ends(Path(NS_PER_MS, NS_PER_MS), NS_PER_S, step=(20 * NS_PER_S, step_ns))
    *_, (true_ns, estimate, end) = ends.run(40)
    assert end.report(true_ns).restarts == 1
    assert estimate is not None
    assert abs(ends.peer_ns(true_ns) - true_ns - estimate.offset_ns) <= estimate.error_ns


def test_the_error_grows_while_nothing_comes() -> None:
    estimator = ClockEstimator()
    for second in range(20):
        estimator.handle_least(second * NS_PER_S, -NS_PER_MS)
        estimator.handle_largest(second * NS_PER_S, NS_PER_MS)
    errors = [
        found.error_ns
        for second in (20, 40, 60)
        if (found := estimator.estimate(second * NS_PER_S)) is not None
    ]
    assert len(errors) == 3
    assert errors == sorted(set(errors))
    assert estimator.estimate(100 * NS_PER_S) is None


def test_a_new_life_of_the_peer_begins_anew() -> None:
    *_, (true_ns, estimate, end) = Ends(Path(NS_PER_MS, NS_PER_MS), NS_PER_S).run(5)
    assert estimate is not None
    end.handle_peer(7, true_ns)
    assert end.estimate(true_ns) is None
    assert end.next_ns == true_ns


def test_what_is_not_the_peers_is_refused() -> None:
    def end(life: int, *, master: bool, version: int = 2) -> ClockExchange:
        made = ClockExchange(version=version, master=master, life=life, told_offset_ns=0, now_ns=0)
        made.handle_peer(3 - life, 0)
        return made

    data = end(2, master=False).poll_transmit(0, 0)
    assert end(1, master=True).handle_message(data, 0, heard=True)
    assert not end(1, master=False).handle_message(data, 0, heard=True)
    assert not end(2, master=True).handle_message(data, 0, heard=True)
    assert not end(1, master=True, version=3).handle_message(data, 0, heard=True)
