"""When a process that has ended is started again, on virtual time."""

from itertools import pairwise

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.session_switch import SENDER_REST_NS, RestartPolicy
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
