"""HELLOs of the stream that is followed: they answer questions, and their answers prove a peer.

The far end is a supervisor, too. Only its HELLOs arrive, with the numbers that a test gives them.
"""

import pytest
from link_supervision_pair import GROUND, MS, SPACE

from telepresence.link.supervision.message import MessageKind, pack_message, parse_message
from telepresence.link.supervision.record import PeerHears
from telepresence.link.supervision.supervisor import Encounter, Supervisor


class Near:
    """The ground's end, which follows a stream that could not prove itself: it hears nobody."""

    def __init__(self):
        options = {"now_ns": 0, "secret": 5}
        self.supervisor = Supervisor(master=True, configuration=GROUND, life=1, **options)
        far = Supervisor(master=False, configuration=SPACE, life=2, **options)
        self.supervisor.handle_local_check(None, 0)
        far.handle_local_check(None, 0)
        sent = (far.poll_transmit(slot * MS) for slot in range(100))
        self.template = parse_message(next(message for message in sent if message is not None))
        assert self.template.kind is MessageKind.HELLO
        self.now_ns = 0
        frames = 0
        found = Encounter.IGNORE
        while found is Encounter.IGNORE:
            self.run(1)
            frames += 1
            found = self.supervisor.handle_stranger(
                self.hello(), self.now_ns, frames=frames, lasts_ns=self.now_ns
            )
        assert frames > 1
        self.receive()

    def hello(self, **fields):
        return pack_message(self.template._replace(**{"number": 0, "echo": 0} | fields))

    def receive(self, **fields):
        self.supervisor.handle_message(self.hello(**fields), self.now_ns)

    def run(self, slots):
        """Return the HELLOs that go out; frames of the far end keep the signal."""
        sent = []
        for _ in range(slots):
            self.now_ns += MS
            if self.supervisor.signal:
                self.supervisor.handle_frame(self.now_ns)
            message = self.supervisor.poll_transmit(self.now_ns)
            if message is not None:
                sent.append(parse_message(message))
        return [message for message in sent if message.kind is MessageKind.HELLO]

    def asked(self):
        """Ask it something; return the HELLO that answers."""
        self.receive(number=77)
        return self.run(30)[0]

    def hears(self):
        events = iter(self.supervisor.next_event, None)
        return any(isinstance(event, PeerHears) for event in events)


def test_a_question_is_answered_with_its_number():
    near = Near()
    for number in (78, 79):
        near.receive(number=number)
        assert near.run(30)[0].echo == number


@pytest.mark.parametrize(("error", "proven"), [(0, True), (1, False)])
def test_an_echo_of_the_own_number_proves_the_peer_and_that_it_hears(error, proven):
    near = Near()
    number = near.asked().number
    assert number, "it asks, because the peer is not proven"
    near.hears()
    near.receive(echo=number ^ error, signal=True)
    assert near.hears() == proven
    assert (near.asked().number == 0) == proven


def test_an_echo_counts_only_as_long_as_a_round_trip_takes():
    near = Near()
    number = near.asked().number
    near.run(2 * near.supervisor.timing.round_trip_ns // MS + 1)
    near.receive(echo=number, signal=True)
    assert near.asked().number


def test_questions_without_end_are_answered_a_hundred_times_a_second():
    near, sent = Near(), []
    for number in range(1, 201):
        near.receive(number=number)
        sent += near.run(1)
    assert len(sent) in (20, 21)
