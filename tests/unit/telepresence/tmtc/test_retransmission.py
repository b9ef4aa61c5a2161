"""What is repeated arrives, or is given up: telecommands and K2ACI have this machine in common."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from telepresence.tmtc.k2aci import Arrived, Chat, ChatRole, Delivered, K2aciEndpoint
from telepresence.tmtc.pus.application import FunctionRequest, PusApplication
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import parse_packet
from telepresence.tmtc.pus.user import CommandResult, PusUser
from telepresence.tmtc.retransmission import Retransmission

MS = 1_000_000
TIMEOUT = 100 * MS
#: By packet: when each of its copies arrives, in steps of 50 ms; none: it is lost.
FATES = st.lists(st.lists(st.integers(1, 12), max_size=2), max_size=40)
STEP = 50 * MS


class Path:
    """Loses, repeats and reorders the first packets; later ones arrive at the next step."""

    def __init__(self, fates):
        self.fates = list(fates)
        self.flying = []

    def put(self, octets, step):
        for steps in self.fates.pop(0) if self.fates else [1]:
            self.flying.append((step + steps, octets))

    def arrivals(self, step):
        due = [octets for at, octets in self.flying if at <= step]
        self.flying = [one for one in self.flying if one[0] > step]
        return due


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
    machine = Retransmission(timeout_ns=TIMEOUT, most=2, patience_ns=3 * TIMEOUT)
    number = machine.handle_put("a", 0)
    assert machine.next_given_up(10 * TIMEOUT) is None
    machine.poll_transmit(0)
    machine.poll_transmit(TIMEOUT)
    assert machine.next_given_up(2 * TIMEOUT) is None
    assert machine.next_given_up(3 * TIMEOUT) == number


@given(there=FATES, back=FATES, restart=st.integers(0, 60))
def test_a_telecommand_is_carried_out_once_or_its_failure_is_reported(there, back, restart):
    dictionary = built_in_dictionary()
    table = dictionary.application("tasks")
    user = PusUser(
        dictionary, source=1, first_count=7, timeout_ns=TIMEOUT, patience_ns=40 * TIMEOUT
    )
    application = PusApplication(table, now_ns=0)
    paths, done, results = (Path(there), Path(back)), [], []
    lives, restarted = 1, False
    numbers = [user.call("tasks", "select", [task], now_ns=0) for task in range(3)]
    for step in range(200):
        now_ns = step * STEP
        if step == restart and restart % 2:
            # It forgets what it has carried out.
            application, lives, restarted = PusApplication(table, now_ns=now_ns), 2, True
        for octets in paths[0].arrivals(step):
            application.handle_telecommand(parse_packet(octets), now_ns)
        while (request := application.next_event()) is not None:
            if isinstance(request, FunctionRequest):
                done.append(request.arguments[0])
                application.handle_result(request.token, "", now_ns)
        while (octets := application.poll_transmit(now_ns)) is not None:
            paths[1].put(octets, step)
        for octets in paths[1].arrivals(step):
            user.handle_telemetry(parse_packet(octets), now_ns)
        while (octets := user.poll_transmit(now_ns)) is not None:
            paths[0].put(octets, step)
        while (event := user.next_event()) is not None:
            if isinstance(event, CommandResult):
                results.append(event)
    assert sorted(one.number for one in results) == numbers
    for one in results:
        times = done.count(one.number)
        assert times <= lives
        if one.ok:
            assert times >= 1
        assert one.verified or not one.ok
    assert restarted or len(done) == len(set(done))
    assert user.poll_timeout() is None


@given(there=FATES, back=FATES)
def test_messages_arrive_once_and_in_order(there, back):
    ends = K2aciEndpoint(life=1, timeout_ns=TIMEOUT), K2aciEndpoint(life=1, timeout_ns=TIMEOUT)
    paths = Path(there), Path(back)
    lines = [Chat(sender=ChatRole.OPERATOR, text=word) for word in "abcdefgh"]
    numbers = [ends[0].send(line, 0) for line in lines]
    arrived, delivered = [], []
    for step in range(400):
        now_ns = step * STEP
        for end, path, other in ((ends[0], paths[0], ends[1]), (ends[1], paths[1], ends[0])):
            while (octets := end.poll_transmit(now_ns)) is not None:
                path.put(octets, step)
            for octets in path.arrivals(step):
                other.handle_message(octets, now_ns)
        while (event := ends[1].next_event()) is not None:
            assert isinstance(event, Arrived)
            arrived.append(event.message)
        while (event := ends[0].next_event()) is not None:
            assert isinstance(event, Delivered)
            delivered.append(event.number)
    assert arrived == lines
    assert sorted(delivered) == numbers
    assert ends[0].waiting == ()
