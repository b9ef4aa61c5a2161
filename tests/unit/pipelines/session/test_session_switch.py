"""Stop and start of a running session, and of each process that ended, on virtual time."""

from itertools import pairwise

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.session_switch import (
    SENDER_REST_NS,
    TIMEOUT_NS,
    Activity,
    Order,
    RestartPolicy,
    SessionSwitch,
    SwitchAction,
)
from pipelines.session.topology.rows import Stage

START, END, KILL = SwitchAction.START, SwitchAction.END, SwitchAction.KILL


@pytest.fixture
def switch():
    return SessionSwitch()


def done(switch):
    return switch.activity, list(iter(switch.next_event, None))


def stop(switch, at_ns=10, ended_ns=20):
    switch.handle_order(Order.STOP, at_ns)
    switch.handle_all_ended(ended_ns)
    assert done(switch) == (Activity.STOPPED, [END])


def test_a_stop_ends_all_and_a_start_begins_again_and_orders_that_change_nothing_are_ignored(
    switch,
):
    # Processes that all failed do not stop the session.
    switch.handle_all_ended(4)
    switch.handle_order(Order.START, 5)
    assert done(switch) == (Activity.RUNNING, [])
    stop(switch)
    switch.handle_order(Order.STOP, 30)
    assert done(switch) == (Activity.STOPPED, [])
    switch.handle_order(Order.START, 40)
    switch.handle_order(Order.START, 41)
    assert done(switch) == (Activity.RUNNING, [START])
    assert switch.stops_ns == [(10, 40)]


def test_a_start_waits_until_all_have_ended_and_a_later_stop_takes_it_back(switch):
    switch.handle_order(Order.STOP, 10)
    switch.handle_order(Order.START, 11)
    assert done(switch) == (Activity.STOPPING, [END])
    switch.handle_order(Order.STOP, 12)
    switch.handle_all_ended(15)
    assert done(switch) == (Activity.STOPPED, [])
    for order, now_ns in ((Order.START, 20), (Order.STOP, 21), (Order.START, 22)):
        switch.handle_order(order, now_ns)
    switch.handle_all_ended(25)
    assert done(switch) == (Activity.RUNNING, [START, END, START])
    assert switch.stops_ns == [(10, 20), (21, 25)]


def test_what_does_not_end_by_itself_is_ended(switch):
    switch.handle_order(Order.STOP, 10)
    assert switch.poll_timeout() == 10 + TIMEOUT_NS
    switch.handle_timeout(9 + TIMEOUT_NS)
    assert done(switch) == (Activity.STOPPING, [END])
    switch.handle_timeout(10 + TIMEOUT_NS)
    assert done(switch) == (Activity.STOPPING, [KILL])
    assert switch.poll_timeout() is None
    switch.handle_all_ended(11 + TIMEOUT_NS)
    assert switch.activity is Activity.STOPPED


def test_a_session_may_end_while_it_is_stopped(switch):
    stop(switch)
    assert switch.running_ns(4, 30) == 6
    switch.handle_end(30)
    assert (switch.stops_ns, switch.next_event()) == ([(10, 30)], None)
    assert switch.running_ns(4, 30) == 6


def lives(policy, lives_s, now_ns=0):
    """Live so long each time; (start, end) of each start, and when the next is due."""
    found = []
    for life_s in lives_s:
        policy.handle_start(now_ns)
        assert policy.poll_timeout() is None
        found.append((now_ns, now_ns + round(life_s * NS_PER_S)))
        policy.handle_end(found[-1][1])
        now_ns = policy.poll_timeout()
    return [*found, (now_ns, None)]


def pauses_ns(found):
    return [after[0] - before[1] for before, after in pairwise(found)]


@pytest.mark.parametrize(
    ("stage", "lives_s", "pauses_ms"),
    [
        (Stage.RELAY, [0.1] * 7, [50, 100, 200, 400, 800, 1000, 1000]),
        # After a good life the pauses begin anew.
        (Stage.SOURCE, [0, 0, 4.999, 5, 0], [50, 100, 200, 50, 100]),
    ],
)
def test_the_pause_doubles_up_to_a_second_while_lives_are_short(stage, lives_s, pauses_ms):
    policy = RestartPolicy(stage)
    assert policy.poll_timeout() is None
    found = pauses_ns(lives(policy, lives_s))
    assert found == [pause * NS_PER_MS for pause in pauses_ms]

    # No second holds packets of two starts of a sender: its next start begins a second later.
    for life_s in (0, 0.3, 60):
        assert min(pauses_ns(lives(RestartPolicy(Stage.SENDER), [life_s] * 8))) > NS_PER_S


def test_a_stopped_process_stays_stopped_until_it_is_started():
    policy = RestartPolicy(Stage.SENDER)
    policy.handle_start(0)
    policy.handle_wanted(False, 5)
    # One that does not end by itself is killed.
    assert (policy.poll_timeout(), policy.poll_kill()) == (None, 5 + TIMEOUT_NS)
    policy.handle_stop(8)
    assert policy.poll_timeout() is None
    policy.handle_wanted(True, 10)
    # A sender rests after its end, not after the order.
    assert policy.poll_timeout() == 8 + SENDER_REST_NS
    policy.handle_start(8 + SENDER_REST_NS)
    assert policy.poll_kill() is None
    # One that falls is not started again while it is stopped.
    policy.handle_end(9 + SENDER_REST_NS)
    policy.handle_wanted(False, 10 + SENDER_REST_NS)
    assert policy.poll_timeout() is None

    # After a stop on request only a sender rests.
    for stage, rest_ns in ((Stage.SOURCE, 0), (Stage.SENDER, SENDER_REST_NS)):
        policy = RestartPolicy(stage)
        lives(policy, [0, 0])
        policy.handle_start(7)
        policy.handle_stop(8)
        assert policy.poll_timeout() == 8 + rest_ns


@pytest.mark.parametrize(
    ("lives_s", "hopeless"), [([1] * 2, False), ([1] * 3, True), ([1, 1, 6, 1], False)]
)
def test_three_short_lives_in_a_row_that_nothing_mends_are_the_last(lives_s, hopeless):
    policy = RestartPolicy(Stage.LINK)
    for life_s in lives_s:
        policy.handle_start(0)
        policy.handle_end(life_s * NS_PER_S, broken=True)
    assert policy.hopeless is hopeless
