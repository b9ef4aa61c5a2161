"""No history of updates, crashes, losses and power cuts leaves two ends without a way back.

A way back: application data passes both ways, or both ends run the elementary version, which talk.
`KONTUR_HISTORIES=10000` draws as many random histories as the claim has.
"""

import os
from copy import copy
from itertools import product
from random import Random

import numpy as np
import pytest
from version_ends import (
    DEAF,
    LIMITS,
    NOTHING,
    REFUSED,
    SECOND,
    WORKS,
    VersionEnd,
    Ways,
    executable,
    status_at,
)

from telepresence.upkeep.version_stack import (
    ELEMENTARY,
    StackRecord,
    StoreRecord,
    VersionLimits,
    VersionState,
    VersionStatus,
    VersionSwitch,
)

HISTORIES = int(os.environ.get("KONTUR_HISTORIES", "1000"))
BLOCK = 250
STEP = 10 * SECOND
UPDATES = ("u1", "u2")


def drawn_ways(random):
    """Any relation of versions; each is as likely as another, but that one pair may work."""
    ways = Ways()
    names = ("v1", "v2", *UPDATES)
    for pair in product(names, names):
        ways.pairs[pair] = random.choice((DEAF, REFUSED, REFUSED, WORKS, *range(6)))
    for end, name in product((0, 1), names):
        if random.random() < 0.5:
            ways.hears_elementary.add((end, name))
    return ways


def step(ways, ends, now_ns, tell):
    """Each end hears its program; `tell(end, status)` is what the radio leaves of it."""
    told = [tell(number, status_at(ways, ends, number)) for number in (0, 1)]
    for number, end in enumerate(ends):
        if end.switch is None:
            continue
        if end.running is None or end.running in end.silent:
            end.switch.handle_time(now_ns)
        else:
            end.switch.handle_status(told[number], now_ns)
        end.work(now_ns)


def history(seed):
    """Some minutes of trouble, then clean contact; return whether the ends talk in the end."""
    random = Random(seed)
    ways = drawn_ways(random)
    ends = []
    for _ in (0, 1):
        end = VersionEnd(executable(*random.sample(("v1", "v2"), random.randint(0, 2))), random)
        end.broken = {name for name in UPDATES if random.random() < 0.2}
        end.silent = {name for name in UPDATES if random.random() < 0.2}
        end.power_on(0)
        ends.append(end)
    now_ns, contact = 0, True
    for _ in range(random.randint(10, 120)):
        now_ns += STEP
        if random.random() < 0.1:
            contact = not contact
        loss = random.choice((0.0, 0.1, 0.5))

        def tell(_end, status, loss=loss, contact=contact):
            if not contact or random.random() < loss:
                return NOTHING
            if status.passed and random.random() < loss:
                # The last word of one end is lost, and the ends disagree about what passed.
                return VersionStatus(contact=True, passed=False, stuck=random.random() < 0.5)
            return status

        for end in ends:
            trouble = random.random()
            if end.switch is None:
                end.power_on(now_ns)
            elif trouble < 0.05:
                name = random.choice((*UPDATES, *dict(end.stored.versions), ELEMENTARY))
                if name in UPDATES or name == ELEMENTARY or end.stored.state(name):
                    if random.random() < 0.3:
                        end.fuse = random.randrange(4)
                    order(end, name, now_ns)
            elif trouble < 0.1:
                end.power_off()
            elif trouble < 0.15:
                end.fuse = random.randrange(4)
            elif trouble < 0.25 and end.running is not None:
                end.running = None
                end.switch.handle_exit(now_ns)
                end.work(now_ns)
        step(ways, ends, now_ns, tell)
    for end in ends:
        end.fuse = None
        if end.switch is None:
            end.power_on(now_ns)
    # Each version of both ends may need its longest wait.
    longest_ns = 2 * 5 * (LIMITS.deaf_ns + LIMITS.probation_ns + LIMITS.crashes * 40 * SECOND)
    end_ns = now_ns + longest_ns
    while now_ns < end_ns:
        now_ns += STEP
        step(ways, ends, now_ns, lambda _end, status: status)
        if settled(ways, ends):
            return True
    return False


def order(end, name, now_ns):
    if name in UPDATES:
        end.add(name, now_ns)
    else:
        end.switch.handle_order(name, now_ns)
        end.work(now_ns)


def settled(ways, ends):
    """Clean contact changes nothing any more: what talks goes on talking."""
    return (
        None not in (ends[0].running, ends[1].running)
        and ways.works(ends[0].running, ends[1].running)
        and not any(end.running in end.silent for end in ends)
    )


@pytest.mark.parametrize("block", range(-(-HISTORIES // BLOCK)))
def test_every_random_history_has_a_way_back(block):
    seeds = range(block * BLOCK, min((block + 1) * BLOCK, HISTORIES))
    assert [seed for seed in seeds if not history(seed)] == []


#: Few and small numbers, so that all states can be visited.
FEW = VersionLimits(probation_ns=2, deaf_ns=3, silence_ns=2, pause_ns=1, crashes=2, starts=2)
WORDS = (
    NOTHING,
    VersionStatus(contact=True, passed=False, stuck=True),
    VersionStatus(contact=True, passed=False, stuck=False),
    VersionStatus(contact=True, passed=True, stuck=False),
)


def key(switch):
    values = {name: value for name, value in vars(switch).items() if name != "reason"}
    return tuple(values[name] for name in sorted(values) if name not in ("_events", "_now_ns"))


def drained(switch):
    """Do what a switch orders; return the records of which power may fail, and that are stored."""
    records = []
    while (event := switch.next_event()) is not None:
        if isinstance(event, StoreRecord):
            records.append(event.record)
    switch._now_ns = 0
    return records


def later(switch, action):
    """The switch one tick later, after an input."""
    other = copy(switch)
    other._events = type(switch._events)()
    action(other)
    return other, drained(other)


def all_states(names):
    """Every state that one end can reach, whatever it hears, and wherever its power fails."""
    found, left = {}, []

    def meet(switch):
        if key(switch) not in found:
            found[key(switch)] = switch
            left.append(switch)

    def power_on(record):
        switch = VersionSwitch(record, 0, FEW)
        before = drained(switch)
        meet(switch)
        for stored in before[:-1]:
            power_on(stored)

    power_on(StackRecord(versions=tuple((name, VersionState.NEW) for name in names)))
    while left:
        switch = left.pop()
        inputs = [lambda one, word=word: one.handle_status(word, 1) for word in WORDS]
        inputs += [lambda one: one.handle_exit(1), lambda one: one.handle_time(1)]
        inputs += [lambda one: one.handle_broken(0)]
        inputs += [
            lambda one, name=name: one.handle_order(name, 0) for name in (*names, ELEMENTARY)
        ]
        for action in inputs:
            other, stored = later(switch, action)
            meet(other)
            for record in (switch.record, *stored):
                power_on(record)
    return found


#: More ticks than one end needs for its longest walk down, twice.
TICKS = 80


class Table:
    """All states of one end as numbers.

    after[state, word]: the next one. runs[state]: an index of NAMES, or PAUSED.
    """

    def __init__(self, names):
        states = all_states(names)
        numbers = {each: number for number, each in enumerate(states)}
        self.after = np.zeros((len(states), len(WORDS)), np.int32)
        self.runs = np.zeros(len(states), np.int32)
        for number, switch in enumerate(states.values()):
            self.runs[number] = PAUSED if switch._paused else NAMES.index(switch.record.current)
            for column, word in enumerate(WORDS):
                other, _ = later(switch, lambda one, word=word: one.handle_status(word, 1))
                self.after[number, column] = numbers[key(other)]


NAMES = ("a", "b", ELEMENTARY)
PAUSED = len(NAMES)


def words(ways, end):
    """By what runs here and there: the number of what the program here tells."""
    found = np.zeros((PAUSED + 1, PAUSED + 1), np.int32)
    for own, peer in product(range(PAUSED), range(PAUSED)):
        found[own, peer] = WORDS.index(ways.status(end, NAMES[own], NAMES[peer]))
    return found


def without_a_way_back(table, ways):
    """How many pairs of any states do not talk after enough clean contact."""
    size = len(table.runs)
    pairs = np.arange(size * size)
    told = [words(ways, end) for end in (0, 1)]
    for _ in range(TICKS):
        first, second = np.divmod(pairs, size)
        mine, theirs = table.runs[first], table.runs[second]
        after = table.after[first, told[0][mine, theirs]].astype(np.int64) * size
        # What comes to the same goes on as one.
        pairs = np.unique(after + table.after[second, told[1][theirs, mine]])
    first, second = np.divmod(pairs, size)
    talk = np.zeros((PAUSED + 1, PAUSED + 1), bool)
    for one, other in product(range(PAUSED), range(PAUSED)):
        talk[one, other] = ways.works(NAMES[one], NAMES[other])
    return int(np.count_nonzero(~talk[table.runs[first], table.runs[second]]))


@pytest.fixture(scope="module")
def table():
    return Table(("a",))


@pytest.mark.parametrize("level", range(6))
@pytest.mark.parametrize("hears", [(), (0,), (1,), (0, 1)])
def test_every_pair_of_states_has_a_way_back(table, level, hears):
    """Any state of the one end with any of the other: more than what they reach together."""
    assert set(table.runs) == {NAMES.index("a"), NAMES.index(ELEMENTARY), PAUSED}
    ways = Ways({("a", "a"): level}, {(end, "a") for end in hears})
    assert without_a_way_back(table, ways) == 0


@pytest.mark.skipif(HISTORIES < 10_000, reason="minutes: set KONTUR_HISTORIES=10000")
def test_every_pair_of_states_with_two_versions_has_a_way_back():
    two = Table(("a", "b"))
    random = Random(1)
    for _ in range(20):
        pairs = {pair: random.randrange(6) for pair in product("ab", "ab")}
        hears = {each for each in product((0, 1), "ab") if random.random() < 0.5}
        assert without_a_way_back(two, Ways(pairs, hears)) == 0
