"""What a version stack does after each thing that can happen to one end."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.supervision.message import LinkState
from telepresence.upkeep.version_stack import (
    ELEMENTARY,
    StackRecord,
    StartVersion,
    StopVersion,
    StoreRecord,
    VersionLimits,
    VersionState,
    VersionStatus,
    VersionSwitch,
    pack_status,
    parse_status,
    status_of,
)

SECOND = 10**9
NEW, EXECUTABLE, DEFECTIVE = VersionState
NOTHING = VersionStatus(contact=False, passed=False, stuck=False)
CONTACT = VersionStatus(contact=True, passed=False, stuck=False)
REFUSED = VersionStatus(contact=True, passed=False, stuck=True)
PASSED = VersionStatus(contact=True, passed=True, stuck=False)
RECORD = StackRecord(current="v3", versions=(("v2", EXECUTABLE), ("v1", EXECUTABLE), ("v3", NEW)))


class Running:
    """A switch and its program, which tells one thing for some seconds."""

    def __init__(self, record=RECORD, **limits):
        self.now_ns = 0
        self.switch = VersionSwitch(record, 0, VersionLimits(**limits))
        self.events = []
        self.drain()

    def drain(self):
        while (event := self.switch.next_event()) is not None:
            self.events.append(event)

    def tell(self, status, seconds):
        for _ in range(seconds):
            self.switch.handle_status(status, self.now_ns)
            self.drain()
            self.now_ns += SECOND

    def crash(self):
        self.switch.handle_exit(self.now_ns)
        self.now_ns += SECOND
        self.switch.handle_time(self.now_ns)
        self.drain()

    @property
    def current(self):
        return self.switch.record.current

    def state(self, name):
        return self.switch.record.state(name)


def test_the_record_is_stored_before_a_version_starts():
    running = Running()
    assert running.events == [StoreRecord(running.switch.record), StartVersion("v3")]
    assert running.switch.record.starts == 1


def test_a_new_version_through_which_data_passes_becomes_executable_and_the_first():
    running = Running()
    running.tell(CONTACT, 59)
    running.tell(PASSED, 1)
    running.tell(CONTACT, 300)
    assert running.current == "v3"
    assert running.switch.record.versions == (
        ("v3", EXECUTABLE),
        ("v2", EXECUTABLE),
        ("v1", EXECUTABLE),
    )


def test_a_new_version_without_data_is_defective_and_the_last_executable_one_starts():
    running = Running()
    running.events.clear()
    running.tell(CONTACT, 62)
    assert running.state("v3") is DEFECTIVE
    stop, *stored, start = running.events
    assert (stop, start) == (StopVersion(), StartVersion("v2"))
    assert all(isinstance(event, StoreRecord) for event in stored)


def test_a_loss_of_signal_does_not_count():
    running = Running()
    for _ in range(20):
        running.tell(CONTACT, 2)
        running.tell(NOTHING, 100)
    assert (running.current, running.state("v3")) == ("v3", NEW)
    running.tell(CONTACT, 22)
    assert running.state("v3") is DEFECTIVE


def test_executable_versions_that_the_peer_refuses_are_set_aside_down_to_the_elementary_one():
    running = Running(RECORD.ordered("v2"))
    running.tell(REFUSED, 62)
    assert running.current == "v1"
    running.tell(REFUSED, 62)
    assert running.current == ELEMENTARY
    assert running.state("v1") is running.state("v2") is EXECUTABLE
    running.tell(REFUSED, 1000)
    assert running.current == ELEMENTARY
    assert running.switch.record.tried == ("v2", "v1")


def test_an_executable_version_without_traffic_stays():
    running = Running(RECORD.ordered("v2"))
    running.tell(CONTACT, 5000)
    assert running.current == "v2"


def test_a_version_that_hears_nothing_for_a_day_is_set_aside():
    running = Running(deaf_ns=100 * SECOND)
    running.tell(NOTHING, 102)
    assert (running.current, running.state("v3")) == ("v2", NEW)


def test_a_version_that_crashes_is_started_again_and_then_replaced():
    running = Running()
    running.events.clear()
    for _ in range(3):
        running.crash()
    starts = [event.name for event in running.events if isinstance(event, StartVersion)]
    assert starts == ["v3", "v3", "v2"]
    assert running.state("v3") is DEFECTIVE


def test_a_version_that_says_nothing_is_ended_as_one_that_crashed():
    running = Running()
    running.events.clear()
    assert running.switch.poll_timeout() == 30 * SECOND
    running.switch.handle_time(30 * SECOND)
    running.drain()
    assert running.events == [StopVersion()]
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


def test_a_defective_version_is_new_again_by_order_only():
    running = Running()
    running.tell(CONTACT, 62)
    running.switch.handle_order("v3", running.now_ns)
    running.drain()
    assert (running.current, running.state("v3")) == ("v3", NEW)


def test_damaged_files_make_a_version_defective():
    running = Running(RECORD.ordered("v2"))
    running.switch.handle_broken(0)
    assert (running.current, running.state("v2")) == ("v1", DEFECTIVE)


@pytest.mark.parametrize("name", [ELEMENTARY, "v3"])
def test_the_elementary_and_the_current_version_are_not_removed(name):
    with pytest.raises(ConfigError, match="stays"):
        RECORD.removed(name)


def test_a_status_is_read_as_written_and_garbage_is_none():
    assert parse_status(pack_status(REFUSED)) == REFUSED
    deep = b'{"more": ' + b"[" * 60_000
    for octets in (b"", b"{}", b'{"contact": 1, "passed": true, "stuck": true}', b"\xff", deep):
        assert parse_status(octets) is None


@pytest.mark.parametrize("state", LinkState)
def test_a_gateway_is_stuck_while_the_ends_do_not_agree(state):
    class Figures:
        # A refused peer is heard, though it gives no signal.
        signal = state is not LinkState.REFUSED

    Figures.state = state.name.lower()
    agreed = state in (LinkState.APPROVE, LinkState.CONNECTED)
    passed = state is LinkState.CONNECTED
    assert status_of(Figures) == VersionStatus(contact=True, passed=passed, stuck=not agreed)
