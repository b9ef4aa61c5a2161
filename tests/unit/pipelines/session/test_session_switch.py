"""Stop and start of a running session, on virtual time."""

import pytest

from pipelines.session.session_switch import (
    PATIENCE_NS,
    Activity,
    Order,
    SessionSwitch,
    SwitchAction,
)


@pytest.fixture
def switch():
    return SessionSwitch()


def actions(switch):
    return list(iter(switch.next_event, None))


def stopped(switch, at_ns=10, ended_ns=20):
    switch.handle_order(Order.STOP, at_ns)
    switch.handle_all_ended(ended_ns)
    assert actions(switch) == [SwitchAction.END]
    return switch


def test_a_stop_ends_all_and_a_start_begins_again(switch):
    stopped(switch)
    assert switch.activity is Activity.STOPPED
    switch.handle_order(Order.START, 50)
    assert (switch.activity, actions(switch)) == (Activity.RUNNING, [SwitchAction.START])
    assert switch.stops_ns == [(10, 50)]


def test_an_order_that_changes_nothing_is_ignored(switch):
    switch.handle_order(Order.START, 5)
    assert (switch.activity, actions(switch)) == (Activity.RUNNING, [])
    stopped(switch)
    switch.handle_order(Order.STOP, 30)
    assert (switch.activity, actions(switch)) == (Activity.STOPPED, [])
    switch.handle_order(Order.START, 40)
    switch.handle_order(Order.START, 41)
    assert actions(switch) == [SwitchAction.START]
    assert switch.stops_ns == [(10, 40)]


def test_a_start_waits_until_all_have_ended_and_a_later_stop_takes_it_back(switch):
    switch.handle_order(Order.STOP, 10)
    switch.handle_order(Order.START, 11)
    assert (switch.activity, actions(switch)) == (Activity.STOPPING, [SwitchAction.END])
    switch.handle_order(Order.STOP, 12)
    switch.handle_all_ended(15)
    assert (switch.activity, actions(switch)) == (Activity.STOPPED, [])
    switch.handle_order(Order.START, 20)
    switch.handle_order(Order.STOP, 21)
    switch.handle_order(Order.START, 22)
    switch.handle_all_ended(25)
    assert switch.activity is Activity.RUNNING
    assert actions(switch) == [SwitchAction.START, SwitchAction.END, SwitchAction.START]
    assert switch.stops_ns == [(10, 20), (21, 25)]


def test_what_does_not_end_by_itself_is_ended(switch):
    switch.handle_order(Order.STOP, 10)
    assert switch.poll_timeout() == 10 + PATIENCE_NS
    switch.handle_timeout(9 + PATIENCE_NS)
    assert actions(switch) == [SwitchAction.END]
    switch.handle_timeout(10 + PATIENCE_NS)
    assert actions(switch) == [SwitchAction.KILL]
    assert switch.poll_timeout() is None
    switch.handle_all_ended(11 + PATIENCE_NS)
    assert switch.activity is Activity.STOPPED


def test_processes_that_all_failed_do_not_stop_the_session(switch):
    switch.handle_all_ended(5)
    assert switch.activity is Activity.RUNNING


def test_a_session_may_end_while_it_is_stopped(switch):
    stopped(switch)
    assert switch.running_ns(4, 30) == 6
    switch.handle_end(30)
    assert switch.stops_ns == [(10, 30)]
    assert actions(switch) == []
    assert switch.running_ns(4, 30) == 6
