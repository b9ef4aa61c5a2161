"""When a process that has ended is started again, on virtual time."""

from itertools import pairwise

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.session_switch import PATIENCE_NS, SENDER_REST_NS, RestartPolicy
from pipelines.session.topology import Stage


def pauses_ms(policy, lives_s, now_ns=0):
    """Live so long each time; the pauses after each life."""
    found = []
    for life_s in lives_s:
        policy.handle_start(now_ns)
        assert policy.poll_timeout() is None
        ended_ns = now_ns + round(life_s * NS_PER_S)
        policy.handle_end(ended_ns)
        now_ns = policy.poll_timeout()
        found.append((now_ns - ended_ns) // NS_PER_MS)
    return found


def test_the_pause_doubles_up_to_a_second_while_lives_are_short():
    assert pauses_ms(RestartPolicy(Stage.RELAY), [0.1] * 7) == [50, 100, 200, 400, 800, 1000, 1000]


def test_after_a_good_life_the_pauses_begin_anew():
    lives_s = [0, 0, 4.999, 5, 0]
    assert pauses_ms(RestartPolicy(Stage.SOURCE), lives_s) == [50, 100, 200, 50, 100]


@pytest.mark.parametrize("life_s", [0, 0.3, 60])
def test_no_second_holds_packets_of_two_lives_of_a_sender(life_s):
    policy, now_ns, lives = RestartPolicy(Stage.SENDER), 0, []
    for _ in range(8):
        policy.handle_start(now_ns)
        ended_ns = now_ns + round(life_s * NS_PER_S)
        policy.handle_end(ended_ns)
        lives.append((now_ns, ended_ns))
        now_ns = policy.poll_timeout()
    # The last packet of a life leaves at its end, the first of the next at its start.
    assert all(start_ns - end_ns > NS_PER_S for (_, end_ns), (start_ns, _) in pairwise(lives))


def test_before_the_first_life_nothing_is_due():
    assert RestartPolicy(Stage.LINK).poll_timeout() is None


@pytest.mark.parametrize(("stage", "rest_ns"), [(Stage.SOURCE, 0), (Stage.SENDER, SENDER_REST_NS)])
def test_after_a_stop_on_request_only_a_sender_rests(stage, rest_ns):
    policy = RestartPolicy(stage)
    pauses_ms(policy, [0, 0])
    policy.handle_start(7)
    policy.handle_stop(8)
    assert policy.poll_timeout() == 8 + rest_ns


def test_a_stopped_process_stays_stopped_until_it_is_started():
    policy = RestartPolicy(Stage.SENDER)
    policy.handle_start(0)
    policy.handle_wanted(False, 5)
    # One that does not end by itself is killed.
    assert (policy.poll_timeout(), policy.poll_kill()) == (None, 5 + PATIENCE_NS)
    policy.handle_stop(8)
    assert policy.poll_timeout() is None
    policy.handle_wanted(True, 10)
    # A sender rests after its end, not after the order.
    assert policy.poll_timeout() == 8 + SENDER_REST_NS
    policy.handle_start(8 + SENDER_REST_NS)
    assert policy.poll_kill() is None


def test_one_that_falls_is_not_started_again_while_it_is_stopped():
    policy = RestartPolicy(Stage.LINK)
    policy.handle_start(0)
    policy.handle_end(1)
    policy.handle_wanted(False, 2)
    assert policy.poll_timeout() is None
