"""What is repeated arrives, or is given up: telecommands and K2ACI have this machine in common."""

from telepresence.tmtc.retransmission import Retransmission

TIMEOUT = 100_000_000


def test_what_took_too_long_is_given_up_once_it_was_sent():
    machine = Retransmission(timeout_ns=TIMEOUT, most=2, give_up_ns=3 * TIMEOUT)
    number = machine.handle_put("a", 0)
    assert machine.next_given_up(10 * TIMEOUT) is None
    machine.poll_transmit(0)
    machine.poll_transmit(TIMEOUT)
    assert machine.next_given_up(2 * TIMEOUT) is None
    assert machine.next_given_up(3 * TIMEOUT) == number
