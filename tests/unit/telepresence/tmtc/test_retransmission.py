"""What is repeated arrives, or is given up: telecommands and K2ACI have this machine in common."""

from itertools import pairwise

from telepresence.tmtc.retransmission import Retransmission

TIMEOUT = 100_000_000


def test_waits_double_up_to_eight_times_and_begin_anew_with_a_contact():
    machine = Retransmission(timeout_ns=TIMEOUT, most=2)
    number = machine.handle_put("a", 0)
    sent_ns = []
    for _ in range(7):
        now_ns = machine.poll_timeout()
        assert machine.poll_transmit(now_ns - 1) is None
        assert machine.poll_transmit(now_ns)[0] == number
        sent_ns.append(now_ns)
    waits = [(b - a) // TIMEOUT for a, b in pairwise(sent_ns)]
    assert waits == [1, 2, 4, 8, 8, 8]
    machine.handle_contact(sent_ns[-1] + 1)
    assert machine.poll_transmit(sent_ns[-1] + 1)[1].tries == 8
    assert machine.poll_timeout() == sent_ns[-1] + 1 + TIMEOUT
    assert (machine.sent, machine.repeated) == (8, 7)


def test_only_the_window_is_under_way_and_memory_is_bounded():
    machine = Retransmission(timeout_ns=TIMEOUT, most=3, window=2)
    first, second, third = (machine.handle_put(word, 0) for word in "abc")
    assert machine.full
    assert [machine.poll_transmit(0)[0], machine.poll_transmit(0)[0]] == [first, second]
    assert machine.poll_transmit(0) is None
    assert machine.get(third) is None
    assert machine.pop(first).item == "a"
    assert machine.poll_transmit(0)[0] == third
    assert not machine.full
    assert [machine.handle_put("d", 0, number=90), machine.pop(90).tries] == [90, 0]
    assert machine.handle_put("e", 0) == 91


def test_what_took_too_long_is_given_up_once_it_was_sent():
    machine = Retransmission(timeout_ns=TIMEOUT, most=2, give_up_ns=3 * TIMEOUT)
    number = machine.handle_put("a", 0)
    assert machine.next_given_up(10 * TIMEOUT) is None
    machine.poll_transmit(0)
    machine.poll_transmit(TIMEOUT)
    assert machine.next_given_up(2 * TIMEOUT) is None
    assert machine.next_given_up(3 * TIMEOUT) == number
