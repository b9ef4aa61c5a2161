"""When snapshots are taken, and of what."""

from itertools import pairwise

from kontur_av.clock import NS_PER_S
from pipelines.media.snapshots import SnapshotSchedule
from pipelines.session.setup.built_in import BUILT_IN
from pipelines.table import topology_of

SPACEJUSTIN = topology_of(BUILT_IN["spacejustin"])
#: When the session began.
START_NS = 7 * NS_PER_S // 2


def schedule_at(session_ns):
    return SnapshotSchedule(SPACEJUSTIN, started_ns=START_NS, now_ns=START_NS + session_ns)


def instants(end_ns):
    """When snapshots are due in a session, each since its start."""
    schedule = schedule_at(0)
    while (due_ns := schedule.poll_timeout()) < START_NS + end_ns:
        schedule.handle_time(due_ns)
        yield due_ns - START_NS


def taken(schedule, now_ns):
    schedule.handle_time(now_ns)
    return list(iter(schedule.next_event, None))


def test_the_first_snapshot_comes_after_a_second_and_a_day_has_some_dozens():
    first = list(instants(20 * NS_PER_S))
    assert first[0] == NS_PER_S
    assert len(first) >= 5
    day = list(instants(86_400 * NS_PER_S))
    assert len(day) <= 50
    assert len({due_ns // NS_PER_S for due_ns in day}) == len(day)


def test_a_restarted_process_continues_the_schedule():
    whole = list(instants(600 * NS_PER_S))
    for before, after in pairwise(whole):
        for session_ns in (before, after - 1):
            assert schedule_at(session_ns).poll_timeout() == START_NS + after


def test_displays_and_the_merge_with_its_halves_are_kept():
    schedule = schedule_at(0)
    assert taken(schedule, START_NS + NS_PER_S - 1) == []
    assert taken(schedule, START_NS + NS_PER_S) == [
        ("space-uplink_video-0001s", "displayed/uplink_video", False),
        ("ground-downlink_video-0001s", "displayed/downlink_video", False),
        ("ground-stereo-0001s", "camera/stereo", True),
    ]
    assert taken(schedule, START_NS + NS_PER_S) == []


def test_snapshots_that_were_missed_are_not_caught_up():
    schedule = schedule_at(0)
    late_ns = START_NS + 60 * NS_PER_S
    assert len(taken(schedule, late_ns)) == 3
    assert schedule.poll_timeout() > late_ns
    assert taken(schedule, late_ns) == []
