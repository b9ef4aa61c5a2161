"""Any datagrams in any order: each is counted once, and nothing raises."""

from collections import Counter

import pytest
from haptic_session import begin_session
from hypothesis import given
from hypothesis import strategies as st

from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.sample import Command, pack_command


@pytest.mark.rule("7")
@given(st.lists(st.binary(max_size=14) | st.binary(min_size=12, max_size=12), max_size=50))
def test_everything_is_counted_exactly_once(datagrams):
    for link in (robot_link(), joystick_link()):
        for now_ns, data in enumerate(datagrams):
            link.handle_datagram(data, now_ns * 1_000_000)
            # Whatever was heard, it can be answered.
            link.poll_transmit(now_ns * 1_000_000)
        found = link.counts
        counted = found.received + found.late + found.repeated + found.strays + found.garbage
        assert counted + found.greetings + found.echoes == len(datagrams)


@given(
    st.integers(0, 65535),
    st.lists(st.sampled_from(["deliver", "lose", "repeat", "swap"]), min_size=1, max_size=300),
)
def test_counters_are_correct_for_any_path(first, path):
    """Compares with simple counting on unbounded sequence numbers."""
    link = robot_link()
    session = begin_session(link)
    arrivals = []
    for number, fate in enumerate(path):
        if fate == "swap":
            arrivals.insert(max(0, len(arrivals) - 1), number)
        else:
            arrivals += [number] * {"deliver": 1, "lose": 0, "repeat": 2}[fate]
    newest, seen = -1, set()
    counts = Counter()
    begin = arrivals[0] if arrivals else 0
    for now, number in enumerate(arrivals):
        data = pack_command(first + number, Command(0.0, 0.0, 0), session=session)
        link.handle_datagram(data, now * 1_000_000)
        if number in seen or number < begin:
            counts["repeated"] += 1
        elif number > newest:
            counts["received"] += 1
            newest = number
        else:
            counts["late"] += 1
        seen.add(number)
    known = sum(number >= begin for number in seen)
    counts["lost"] = newest - begin + 1 - known if arrivals else 0
    report = link.received_metrics()
    assert {name: getattr(report, name) for name in counts} == counts
    assert report.restarts == 0
