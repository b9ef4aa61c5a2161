"""What was sent is sent again: each row in its cycle, and no cap that cannot carry the units."""

from types import SimpleNamespace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.haptic_trace import ROW, flags_of
from pipelines.hand.replaying import ReplayedEnd, ReplayScript, ReplayTime
from pipelines.recording.process_replaying import ReplayStart
from pipelines.recording.recorded_session import MOST_MORE_NS, cap_needed_bps, longest_wait_ns
from pipelines.recording.recorder_metrics import ReplayMetrics
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import ContactRow, SampleReceivedRow, SampleSentRow

BEGIN_NS = 7_000 * NS_PER_S
HALF_NS = NS_PER_MS // 2


def rows(lateness_ns, *, contact=()):
    """Cycles of an end, each this late; contact: numbers of those that touch."""
    found = np.zeros(len(lateness_ns), ROW)
    number = np.arange(len(lateness_ns))
    found["time_ns"] = BEGIN_NS + number * NS_PER_MS + HALF_NS + lateness_ns
    found["fx_n"] = -number / 10
    found["flags"] = [
        flags_of(contact=k in contact, dead_man=True, acted=False, state=3, lit=4) for k in number
    ]
    return found


def pair(robot_rows, joystick_rows, *, speed=1.0):
    time = ReplayTime(recorded_ns=BEGIN_NS, replayed_ns=0, speed=speed)
    probes = [Probe(), Probe()]
    ends = [
        ReplayedEnd(given, time, probe, robot=robot, boot_id=5)
        for given, probe, robot in zip(
            (robot_rows, joystick_rows), probes, (True, False), strict=True
        )
    ]
    return ends, probes


def run(ends, cycles):
    robot, joystick = ends
    for cycle in range(cycles):
        now_ns = cycle * NS_PER_MS + HALF_NS
        for end in ends:
            end.handle_cycle(now_ns, NS_PER_MS)
        for sender, receiver in ((robot, joystick), (joystick, robot)):
            sample = sender.poll_transmit(now_ns)
            if sample is not None:
                receiver.handle_datagram(sample, now_ns)
    for end in ends:
        end.publish()


def test_each_recorded_cycle_is_sent_in_its_cycle_and_contacts_are_told():
    late = np.random.default_rng(1).integers(-100_000, 400_000, 300)
    ends, probes = pair(rows(late, contact=range(200, 250)), rows(late))
    run(ends, 400)
    sent = [row.sent_ns for row in probes[0].series(SampleSentRow).rows()]
    received = probes[1].series(SampleReceivedRow).rows()
    # Some cycles go to the greetings with which the session begins.
    assert 270 < len(sent) <= 300
    assert max(sent) == 299 * NS_PER_MS + HALF_NS
    assert len(received) >= 270
    assert [
        (row.instant_ns // NS_PER_MS, row.led) for row in probes[0].series(ContactRow).rows()
    ] == [(200, 4)]
    assert all(end.superseded == 0 for end in ends)

    # Half the speed takes twice the time.
    ends, probes = pair(rows(np.zeros(300, int)), rows(np.zeros(300, int)), speed=0.5)
    run(ends, 700)
    last = max(row.sent_ns for row in probes[0].series(SampleSentRow).rows())
    assert last // NS_PER_MS == 599


def test_of_two_rows_in_one_cycle_the_newer_is_sent_and_a_late_process_tells_what_it_left_out():
    late = np.zeros(300, np.int64)
    late[100] = 900_000
    late[200:] = 0
    ends, probes = pair(rows(late), np.delete(rows(late * 0), slice(150, 160)))
    run(ends, 300)
    sent = [
        {row.sent_ns // NS_PER_MS for row in probe.series(SampleSentRow).rows()} for probe in probes
    ]
    assert ends[0].superseded == 1
    assert 100 not in sent[0]
    assert 101 in sent[0]
    assert not sent[1] & set(range(150, 160))
    assert {149, 160} <= sent[1]
    told = []
    context = SimpleNamespace(
        started_ns=0,
        clock=SimpleNamespace(now_ns=lambda: 3 * NS_PER_S),
        probe=SimpleNamespace(publish=told.append),
    )
    items = [(second * NS_PER_S, b"") for second in range(5)]
    script = ReplayStart(recorded_ns=0, lead_ns=NS_PER_S, speed=1.0).script(context, items, 1)
    # Those of seconds 0 and 1 were due at 1 s and 2 s.
    assert told == [ReplayMetrics(items_left_out=2)]
    assert script.poll_timeout() == 3 * NS_PER_S + 1


@pytest.mark.parametrize("large", [1, 6])
def test_the_cap_that_is_named_carries_the_units_and_one_less_does_not(large):
    """Pictures of 80 kbit/s, one of them large."""
    units = [(k * NS_PER_S // 25, 400) for k in range(250)]
    units[100] = units[100][0], 400 * large
    capabilities = {"channel_bps": 120_000, "payload_octets": 1000}

    def needed(cap_bps, speed=1.0):
        return cap_needed_bps(
            units, cap_bps=cap_bps, recorded_bps=85_000, speed=speed, **capabilities
        )

    assert needed(85_000) == 85_000
    named = needed(30_000)
    assert 60_000 < named < 85_000
    most_ns = longest_wait_ns(units, cap_bps=85_000, **capabilities) + MOST_MORE_NS
    assert longest_wait_ns(units, cap_bps=named, **capabilities) <= most_ns
    assert longest_wait_ns(units, cap_bps=named - 1000, **capabilities) > most_ns
    assert needed(named) == named
    assert needed(85_000, speed=2.0) > 110_000


def sent_by(script, *, until_ns):
    """(number, capture, now) of what a process sends that wakes when it must."""
    found = []
    while (due_ns := script.poll_timeout()) is not None and due_ns <= until_ns:
        while (due := script.poll_due(due_ns)) is not None:
            found.append((*due, due_ns))
    return found


def test_a_process_sends_each_item_when_it_is_due_and_a_restarted_one_repeats_none():
    captured_ns = [BEGIN_NS + ms * NS_PER_MS for ms in (0, 33, 66, 66, 100)]
    time = ReplayTime(recorded_ns=BEGIN_NS, replayed_ns=5 * NS_PER_S, speed=2.0)
    due_ms = [5010, 5026.5, 5043, 5043, 5060]

    def started(ms):
        now_ns = round(ms * NS_PER_MS)
        return ReplayScript(captured_ns, time, cost_ns=10 * NS_PER_MS, now_ns=now_ns)

    whole = sent_by(started(0), until_ns=6 * NS_PER_S)
    assert [number for number, _, _ in whole] == [0, 1, 2, 3, 4]
    assert [now_ns / NS_PER_MS for _, _, now_ns in whole] == due_ms
    assert all(now_ns - capture_ns == 10 * NS_PER_MS for _, capture_ns, now_ns in whole)
    first = sent_by(started(0), until_ns=5_030 * NS_PER_MS)
    assert first + sent_by(started(5_030), until_ns=6 * NS_PER_S) == whole
    assert [started(ms).left_out for ms in (0, 5_030, 5_061)] == [0, 2, 5]
    assert started(5_061).poll_timeout() is None
    # One that overslept sends all that is due.
    late = started(0)
    assert [late.poll_due(5_043 * NS_PER_MS) is not None for _ in range(5)] == [True] * 4 + [False]
