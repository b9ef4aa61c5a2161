"""What a version stack does after each thing that can happen to one end, and to two.

No history of updates, crashes, losses and power cuts leaves two ends without a way back:
application data passes both ways, or both ends run the elementary version, which talk.
"""

from copy import copy
from dataclasses import dataclass, field, replace
from itertools import product
from random import Random

import numpy as np
import pytest
from common import first_seed, repeats
from failing_disk import FailingDisk, PowerFailedError, software

from kontur_av.errors import ConfigError
from telepresence.link.protection.identity import MachineKey
from telepresence.link.supervision.message import LinkState
from telepresence.upkeep.file_store import StoredFile
from telepresence.upkeep.manifest import MANIFEST, signed_manifest
from telepresence.upkeep.version_stack import (
    ELEMENTARY,
    StackRecord,
    StartVersion,
    StopVersion,
    StoreRecord,
    VersionDirectory,
    VersionLimits,
    VersionState,
    VersionStatus,
    VersionSwitch,
    pack_status,
    parse_status,
    status_of,
)

SECOND = 1_000_000_000
NEW, EXECUTABLE, DEFECTIVE = VersionState
NOTHING = VersionStatus(contact=False, passed=False, stuck=False)
CONTACT = VersionStatus(contact=True, passed=False, stuck=False)
STUCK = replace(CONTACT, stuck=True)
PASSED = replace(CONTACT, passed=True)
WORDS = (NOTHING, STUCK, CONTACT, PASSED)
RECORD = StackRecord(current="v3", versions=(("v2", EXECUTABLE), ("v1", EXECUTABLE), ("v3", NEW)))
KEY = MachineKey.from_seed(bytes(32))


class Running:
    """A switch and its program, which tells one thing for some seconds."""

    def __init__(self, record=RECORD, **limits):
        self.now_ns = 0
        self.switch = VersionSwitch(record, 0, VersionLimits(**limits))
        self.events = list(iter(self.switch.next_event, None))

    def publish(self, status, seconds):
        for _ in range(seconds):
            self.switch.handle_status(status, self.now_ns)
            self.events += iter(self.switch.next_event, None)
            self.now_ns += SECOND

    def crash(self):
        self.switch.handle_exit(self.now_ns)
        self.now_ns += SECOND
        self.switch.handle_time(self.now_ns)
        self.events += iter(self.switch.next_event, None)

    @property
    def current(self):
        return self.switch.record.current

    def state(self, name):
        return self.switch.record.state(name)


@pytest.fixture
def running():
    """On trial: v3. Its first events are fetched."""
    found = Running()
    # The record is stored before a version starts.
    assert found.events == [StoreRecord(found.switch.record), StartVersion("v3")]
    assert found.switch.record.starts == 1
    found.events.clear()
    return found


def test_a_new_version_is_executable_once_data_passes_and_defective_after_a_minute_without(running):
    # A loss of signal does not count.
    for _ in range(20):
        running.publish(CONTACT, 2)
        running.publish(NOTHING, 100)
    assert (running.current, running.state("v3"), running.events) == ("v3", NEW, [])
    running.publish(CONTACT, 22)
    assert running.state("v3") is DEFECTIVE
    stop, *stored, start = running.events
    assert (stop, start) == (StopVersion(), StartVersion("v2"))
    assert all(isinstance(event, StoreRecord) for event in stored)
    # By order alone it is new again.
    running.switch.handle_order("v3", running.now_ns)
    assert (running.current, running.state("v3")) == ("v3", NEW)
    running.publish(CONTACT, 59)
    running.publish(PASSED, 1)
    running.publish(CONTACT, 300)
    assert running.current == "v3"
    names = ("v3", "v2", "v1")
    assert running.switch.record.versions == tuple((name, EXECUTABLE) for name in names)


def test_executable_versions_that_the_peer_refuses_are_set_aside_down_to_the_elementary_one():
    running = Running(RECORD.ordered("v2"))
    # One without traffic stays.
    running.publish(CONTACT, 5000)
    for current in ("v2", "v1", ELEMENTARY):
        assert running.current == current
        running.publish(STUCK, 62)
    assert running.state("v1") is running.state("v2") is EXECUTABLE
    running.publish(STUCK, 1000)
    assert running.current == ELEMENTARY
    assert running.switch.record.tried == ("v2", "v1")
    # So is one that hears nothing for a day.
    running = Running(deaf_ns=100 * SECOND)
    running.publish(NOTHING, 102)
    assert (running.current, running.state("v3")) == ("v2", NEW)


def test_a_version_that_crashes_is_started_again_and_then_replaced(running):
    for _ in range(3):
        running.crash()
    starts = [event.name for event in running.events if isinstance(event, StartVersion)]
    assert starts == ["v3", "v3", "v2"]
    assert running.state("v3") is DEFECTIVE


def test_a_version_that_says_nothing_is_ended_as_one_that_crashed(running):
    assert running.switch.poll_timeout() == 30 * SECOND
    running.switch.handle_time(30 * SECOND)
    assert list(iter(running.switch.next_event, None)) == [StopVersion()]
    assert running.switch.poll_timeout() == 31 * SECOND


def test_the_elementary_version_is_started_again_for_ever():
    running = Running(StackRecord())
    running.events.clear()
    for _ in range(50):
        running.crash()
    assert running.events == [StartVersion(ELEMENTARY)] * 50


def test_a_version_that_takes_the_machine_with_it_does_not_start_for_ever():
    record = RECORD
    for _ in range(9):
        record = Running(record).switch.record
    assert record.current == "v2"


def test_damaged_files_make_a_version_defective():
    running = Running(RECORD.ordered("v2"))
    running.switch.handle_broken(0)
    assert (running.current, running.state("v2")) == ("v1", DEFECTIVE)


@pytest.mark.parametrize("name", [ELEMENTARY, "v3"])
def test_the_elementary_and_the_current_version_are_not_removed(name):
    with pytest.raises(ConfigError, match="stays"):
        RECORD.removed(name)


def test_a_status_is_read_as_written_and_garbage_is_none():
    assert parse_status(pack_status(STUCK)) == STUCK
    deep = b'{"more": ' + b"[" * 60_000
    for octets in (b"", b"{}", b'{"contact": 1, "passed": true, "stuck": true}', b"\xff", deep):
        assert parse_status(octets) is None


@pytest.mark.parametrize("state", LinkState)
def test_a_gateway_is_stuck_while_the_ends_do_not_agree(state):
    class Metrics:
        # A refused peer is heard, though it gives no signal.
        signal = state is not LinkState.REFUSED

    Metrics.state = state.name.lower()
    agreed = state in (LinkState.APPROVE, LinkState.CONNECTED)
    passed = state is LinkState.CONNECTED
    assert status_of(Metrics) == VersionStatus(contact=True, passed=passed, stuck=not agreed)


#: What two running versions see of each other: contact here, contact there, agreement, data.
DEAF, HEARD, HEARS, REFUSED, AGREED, WORKS = range(6)
NAMES = ("a", "b", ELEMENTARY)
PAUSED = len(NAMES)


@dataclass
class Ways:
    """Which versions can talk: `pairs` by the names at both ends."""

    pairs: dict[tuple[str, str], int] = field(default_factory=dict)
    #: Versions that see contact with an elementary peer.
    hears_elementary: set[tuple[int, str]] = field(default_factory=set)

    def works(self, first, second):
        return first == second == ELEMENTARY or self.pairs.get((first, second)) == WORKS

    def status(self, end, own, peer):
        """What the program at an end tells while the radio carries all."""
        pair = (own, peer) if end == 0 else (peer, own)
        if self.works(*pair):
            return PASSED
        if own == ELEMENTARY:
            # It understands the first octet of every version.
            contact = True
        elif peer == ELEMENTARY:
            contact = (end, own) in self.hears_elementary
        else:
            level = self.pairs.get(pair, DEAF)
            contact = level >= REFUSED or level == (HEARS if end == 0 else HEARD)
        return STUCK if contact else NOTHING


def key(switch):
    values = {name: value for name, value in vars(switch).items() if name != "reason"}
    return tuple(values[name] for name in sorted(values) if name not in ("_events", "_now_ns"))


def drained(switch):
    """Do what a switch orders; return the records of which power may fail, and that are stored."""
    switch._now_ns = 0
    events = iter(switch.next_event, None)
    return [event.record for event in events if isinstance(event, StoreRecord)]


def later(switch, method, *arguments):
    """The switch one tick later, after an input."""
    other = copy(switch)
    other._events = type(switch._events)()
    getattr(other, method)(*arguments)
    return other, drained(other)


def all_states(names, limits):
    """Every state that one end can reach, whatever it hears, and wherever its power fails."""
    found, left = {}, []

    def meet(switch):
        if key(switch) not in found:
            found[key(switch)] = switch
            left.append(switch)

    def power_on(record):
        switch = VersionSwitch(record, 0, limits)
        before = drained(switch)
        meet(switch)
        for stored in before[:-1]:
            power_on(stored)

    power_on(StackRecord(versions=tuple((name, VersionState.NEW) for name in names)))
    while left:
        switch = left.pop()
        inputs = [("handle_status", word, 1) for word in WORDS]
        inputs += [("handle_exit", 1), ("handle_time", 1), ("handle_broken", 0)]
        inputs += [("handle_order", name, 0) for name in (*names, ELEMENTARY)]
        for action in inputs:
            other, stored = later(switch, *action)
            meet(other)
            for record in (switch.record, *stored):
                power_on(record)
    return found


class Table:
    """All states of one end as numbers.

    after[state, word]: the next one. runs[state]: an index of NAMES, or PAUSED.
    """

    def __init__(self, names, **limits):
        states = all_states(names, VersionLimits(silence_ns=2, pause_ns=1, crashes=2, **limits))
        numbers = {each: number for number, each in enumerate(states)}
        self.after = np.zeros((len(states), len(WORDS)), np.int32)
        self.runs = np.zeros(len(states), np.int32)
        for number, switch in enumerate(states.values()):
            self.runs[number] = PAUSED if switch._paused else NAMES.index(switch.record.current)
            for column, word in enumerate(WORDS):
                other, _ = later(switch, "handle_status", word, 1)
                self.after[number, column] = numbers[key(other)]


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
    # More ticks than one end needs for its longest walk down, twice.
    for _ in range(80):
        first, second = np.divmod(pairs, size)
        mine, theirs = table.runs[first], table.runs[second]
        after = table.after[first, told[0][mine, theirs]].astype(np.int64) * size
        # What comes to the same goes on as one.
        reached = np.zeros(size * size, bool)
        reached[after + table.after[second, told[1][theirs, mine]]] = True
        pairs = np.flatnonzero(reached)
    first, second = np.divmod(pairs, size)
    talk = np.zeros((PAUSED + 1, PAUSED + 1), bool)
    for one, other in product(range(PAUSED), range(PAUSED)):
        talk[one, other] = ways.works(NAMES[one], NAMES[other])
    return int(np.count_nonzero(~talk[table.runs[first], table.runs[second]]))


@pytest.fixture(scope="module")
def table():
    return Table(("a",), probation_ns=2, deaf_ns=3, starts=2)


@pytest.mark.parametrize("level", range(6))
@pytest.mark.parametrize("hears", [(), (0,), (1,), (0, 1)])
def test_every_pair_of_states_has_a_way_back(table, level, hears):
    """Any state of the one end with any of the other: more than what they reach together."""
    assert set(table.runs) == {NAMES.index("a"), NAMES.index(ELEMENTARY), PAUSED}
    ways = Ways({("a", "a"): level}, {(end, "a") for end in hears})
    assert without_a_way_back(table, ways) == 0


def test_every_pair_of_states_with_two_versions_has_a_way_back():
    """With smaller limits, so that there are few states."""
    two = Table(("a", "b"), probation_ns=1, deaf_ns=2, starts=1)
    for seed in range(first_seed(), first_seed() + repeats(1)):
        random = Random(seed)
        pairs = {pair: random.randrange(6) for pair in product("ab", "ab")}
        hears = {each for each in product((0, 1), "ab") if random.random() < 0.5}
        assert without_a_way_back(two, Ways(pairs, hears)) == 0, (seed, pairs, hears)


def versions_of(disk):
    return VersionDirectory(disk, {KEY.identity})


def signed(random, name):
    files = software(random, name)
    return {**files, MANIFEST: StoredFile(signed_manifest(name, files, KEY))}


def upkeep(disk, random):
    """Versions come, start, fail, work and go."""
    versions = versions_of(disk)
    for number in range(random.randint(1, 4)):
        record, name = versions.read(), f"v{number}"
        versions.add(name, signed(random, name))
        versions.store(record.added(name))
        versions.store(versions.read().ordered(name))
        record = versions.read()
        if random.random() < 0.5:
            versions.store(record.worked())
        else:
            versions.store(record.failed(defective=True))
            if random.random() < 0.5:
                versions.store(versions.read().removed(name))
                versions.forget(name)


@pytest.mark.parametrize("part", range(4))
def test_a_power_cut_leaves_a_version_that_starts(part):
    for seed in range(first_seed(0) + part, first_seed(0) + repeats(400), 4):
        random = Random(seed)
        disk = FailingDisk()
        first = signed(random, ELEMENTARY)
        disk.fuse = Random(-1 - seed).randrange(1, 6000)
        try:
            versions_of(disk).add(ELEMENTARY, first)
            upkeep(disk, random)
        except PowerFailedError:
            disk = disk.powered_again()
        versions = versions_of(disk)
        versions.tidy()
        if not versions.has_elementary():
            versions.add(ELEMENTARY, first)
        record = versions.read()
        assert not [path for path in disk.files("") if "unfinished" in path]
        for name in (record.current, ELEMENTARY):
            versions.check(name)
        for name, state in record.versions:
            if state is not VersionState.DEFECTIVE:
                versions.check(name)


def test_a_version_that_came_twice_is_known_by_its_manifest():
    random, versions = Random(1), versions_of(FailingDisk())
    files, record = signed(random, "v1"), versions.read()
    assert not versions.holds("v1", files, record)
    versions.add("v1", files)
    # A power cut left it without a record.
    assert not versions.holds("v1", files, record)
    record = record.added("v1")
    assert versions.holds("v1", files, record)
    assert not versions.holds("v1", signed(random, "v1"), record)
    assert not versions.holds("v1", software(random, "v1"), record)


@pytest.mark.rule("9")
def test_a_version_that_is_not_as_signed_by_a_trusted_machine_is_refused():
    for path in ("run", "lib/same.so", MANIFEST):
        files = signed(Random(1), "v1")
        octets = bytearray(files[path].octets)
        octets[len(octets) // 2] ^= 1
        files[path] = StoredFile(bytes(octets), executable=path == "run")
        with pytest.raises(ConfigError, match=r"damaged|signature"):
            versions_of(FailingDisk()).add("v1", files)
    files[MANIFEST] = StoredFile(b'{"more": ' + b"[" * 60_000, executable=False)
    with pytest.raises(ConfigError, match="manifest is damaged"):
        versions_of(FailingDisk()).add("v1", files)
    versions = VersionDirectory(FailingDisk(), {MachineKey.from_seed(bytes([1] * 32)).identity})
    with pytest.raises(ConfigError, match="not trusted"):
        versions.add("v1", signed(Random(1), "v1"))
