"""K2ACI: once and in order, over a path that loses, repeats and delays."""

from random import Random

import pytest

from kontur_av.errors import ConfigError
from telepresence.tmtc.k2aci import (
    Acknowledgement,
    Arrived,
    Chat,
    ChatRole,
    Delivered,
    K2aciEndpoint,
    Numbered,
    StartTask,
    TaskFinished,
    TaskResult,
    fitted_line,
    pack_body,
    parse_body,
)

MS = 1_000_000
START = StartTask(task="aiming", run=1)


def chat(text: str) -> Chat:
    return Chat(sender=ChatRole.SUPERVISOR, text=text)


def pass_on(sender: K2aciEndpoint, receiver: K2aciEndpoint, now_ns: int) -> None:
    """Hand over whatever `sender` has to send."""
    while (octets := sender.poll_transmit(now_ns)) is not None:
        receiver.handle_message(octets, now_ns)


def events(endpoint: K2aciEndpoint) -> list[Arrived | Delivered]:
    return list(iter(endpoint.next_event, None))


def test_a_message_arrives_and_its_sender_hears_so() -> None:
    ground, space = K2aciEndpoint(life=1), K2aciEndpoint(life=1)
    assert ground.poll_timeout() is None
    assert space.send(START, 0) == 0
    assert space.poll_timeout() == 0
    pass_on(space, ground, 10 * MS)
    assert events(ground) == [Arrived(1, 0, START)]
    pass_on(ground, space, 30 * MS)
    assert events(space) == [Delivered(0, START, 30 * MS)]
    assert (space.poll_timeout(), space.waiting) == (None, ())


def test_a_lost_message_is_repeated_ever_more_slowly_and_at_once_with_the_signal() -> None:
    space = K2aciEndpoint(life=1, timeout_ns=500 * MS)
    space.send(START, 0)
    sent_ms = []
    while len(sent_ms) < 7:
        now_ns = space.poll_timeout()
        assert now_ns is not None
        assert space.poll_transmit(now_ns) is not None
        assert space.poll_transmit(now_ns) is None
        sent_ms.append(now_ns // MS)
    assert sent_ms == [0, 500, 1500, 3500, 7500, 11500, 15500]
    space.handle_contact(16_000 * MS)
    assert space.poll_timeout() == 16_000 * MS
    space.poll_transmit(16_000 * MS)
    assert space.poll_timeout() == 16_500 * MS


def test_a_repetition_is_acknowledged_again_and_handed_out_once() -> None:
    ground, space = K2aciEndpoint(life=1), K2aciEndpoint(life=1)
    space.send(START, 0)
    for now_ns in (0, 500 * MS):
        octets = space.poll_transmit(now_ns)
        assert octets is not None
        ground.handle_message(octets, now_ns)
    assert len(events(ground)) == 1
    assert (ground.arrived, ground.duplicates, space.repeated) == (1, 1, 1)
    pass_on(ground, space, 600 * MS)
    assert [type(event) for event in events(space)] == [Delivered]
    assert space.unexpected == 1


def test_a_restarted_sender_is_heard_from_its_first_message_on_and_its_old_ones_no_more() -> None:
    ground, before, after = K2aciEndpoint(life=1), K2aciEndpoint(life=5), K2aciEndpoint(life=6)
    before.send(chat("one"), 0)
    pass_on(before, ground, 0)
    before.send(chat("two"), 0)
    late = before.poll_transmit(0)
    after.send(chat("three"), 0)
    pass_on(after, ground, 0)
    assert late is not None
    ground.handle_message(late, 0)
    assert [event.message for event in events(ground)] == [chat("one"), chat("three")]
    assert ground.unexpected == 1


def test_a_restarted_receiver_takes_up_where_the_sender_is() -> None:
    space, before = K2aciEndpoint(life=1), K2aciEndpoint(life=1)
    for text in "abc":
        space.send(chat(text), 0)
        pass_on(space, before, 0)
        pass_on(before, space, 0)
    after = K2aciEndpoint(life=2)
    space.send(chat("d"), 0)
    pass_on(space, after, 0)
    assert events(after) == [Arrived(1, 3, chat("d"))]


def test_waiting_messages_and_answers_are_bounded() -> None:
    space, ground = K2aciEndpoint(life=1), K2aciEndpoint(life=1)
    assert [space.send(chat("x"), 0) for _ in range(65)] == [*range(64), None]
    packets = list(iter(lambda: space.poll_transmit(0), None))
    assert len(packets) == 4
    for octets in packets * 10:
        ground.handle_message(octets, 0)
    assert len(list(iter(lambda: ground.poll_transmit(0), None))) == 16
    assert ground.dropped_answers == 24


@pytest.mark.parametrize("seed", range(20))
def test_each_message_arrives_once_and_in_order_over_a_bad_path(seed: int) -> None:
    """Loss, repetition, reordering, and minutes without a signal, both ways at once."""
    random = Random(seed)
    ends = (K2aciEndpoint(life=1), K2aciEndpoint(life=1))
    texts = [[f"{end} {number}" for number in range(30)] for end in (0, 1)]
    arrived: list[list[str]] = [[], []]
    flying: list[tuple[int, int, bytes]] = []
    for step in range(20_000):
        now_ns = step * 50 * MS
        for end, endpoint in enumerate(ends):
            if step % 20 == 0 and step // 20 < 30:
                endpoint.send(chat(texts[end][step // 20]), now_ns)
            for at_ns, to, octets in [packet for packet in flying if packet[1] == end]:
                if at_ns <= now_ns:
                    flying.remove((at_ns, to, octets))
                    endpoint.handle_message(octets, now_ns)
            while (body := endpoint.poll_transmit(now_ns)) is not None:
                silent = 200 <= step < 3000
                if not silent and random.random() < 0.6:
                    delays_ms = [random.randrange(3000) for _ in range(random.choice((1, 1, 2)))]
                    flying += [(now_ns + ms * MS, 1 - end, body) for ms in delays_ms]
            for event in events(endpoint):
                if isinstance(event, Arrived):
                    assert isinstance(event.message, Chat)
                    arrived[1 - end].append(event.message.text)
        if not any(endpoint.waiting for endpoint in ends) and step > 700:
            break
    assert arrived == texts


def test_unfit_arguments_are_refused() -> None:
    with pytest.raises(ConfigError, match="life is -1"):
        K2aciEndpoint(life=-1)
    with pytest.raises(ConfigError, match="timeout above 0"):
        K2aciEndpoint(life=0, timeout_ns=0)
    endpoint = K2aciEndpoint(life=0)
    endpoint.handle_message(b"\x80", 0)
    assert endpoint.garbage == 1
    endpoint.send(TaskFinished(task="a", run=0, result=TaskResult.FINISHED), 0)


def numbered(number: int, oldest: int = 0, life: int = 1) -> bytes:
    return pack_body(Numbered(life, number, oldest, chat(str(number))))


def numbers(endpoint: K2aciEndpoint) -> list[int]:
    return [event.number for event in events(endpoint)]


def test_what_comes_too_early_waits_for_what_the_sender_still_repeats() -> None:
    ground = K2aciEndpoint(life=1)
    for number in (1, 2, 2, 0):
        ground.handle_message(numbered(number), 0)
    assert (numbers(ground), ground.arrived, ground.duplicates) == ([0, 1, 2], 3, 1)
    # The sender repeats nothing below 5 any more: 3 will not come, and 4 is not handed out.
    ground.handle_message(numbered(4), 0)
    ground.handle_message(numbered(6, oldest=5), 0)
    ground.handle_message(numbered(5, oldest=5), 0)
    assert numbers(ground) == [5, 6]
    # An older word of the oldest turns nothing back.
    ground.handle_message(numbered(7, oldest=2), 0)
    assert numbers(ground) == [7]
    assert ground.duplicates == 1
    ground.handle_message(numbered(3), 0)
    assert ground.duplicates == 2


def test_a_number_64_or_more_ahead_is_out_of_reach() -> None:
    ground = K2aciEndpoint(life=1)
    ground.handle_message(numbered(0), 0)
    ground.handle_message(numbered(65), 0)
    assert ground.unexpected == 1
    ground.handle_message(numbered(64), 0)
    assert (ground.unexpected, numbers(ground)) == (1, [0])


def test_each_message_handed_out_is_acknowledged_with_its_life() -> None:
    ground = K2aciEndpoint(life=1)
    ground.handle_message(numbered(3, oldest=3, life=8), 0)
    ground.handle_message(numbered(3, oldest=3, life=8), 0)
    # A new life of the sender begins with its own oldest, and what it held before is gone.
    ground.handle_message(numbered(5, oldest=4, life=8), 0)
    ground.handle_message(numbered(4, oldest=4, life=9), 0)
    ground.handle_message(numbered(7, oldest=4, life=8), 0)
    answers = [parse_body(octets) for octets in iter(lambda: ground.poll_transmit(0), None)]
    assert answers == [Acknowledgement(8, 3), Acknowledgement(8, 3), Acknowledgement(9, 4)]
    assert [(e.life, e.number) for e in events(ground) if isinstance(e, Arrived)] == [
        (8, 3),
        (9, 4),
    ]
    assert ground.unexpected == 1


def test_an_acknowledgement_of_another_life_or_number_is_unexpected() -> None:
    space = K2aciEndpoint(life=2)
    space.send(START, 0)
    space.handle_message(pack_body(Acknowledgement(2, 0)), 0)  # it was not sent yet
    assert space.poll_transmit(0) is not None
    for life, number in ((1, 0), (2, 1)):
        space.handle_message(pack_body(Acknowledgement(life, number)), 0)
    assert (space.unexpected, space.waiting) == (3, (0,))
    space.handle_message(pack_body(Acknowledgement(2, 0)), 9)
    assert events(space) == [Delivered(0, START, 9)]


def test_a_message_names_its_life_its_number_and_the_oldest() -> None:
    space = K2aciEndpoint(life=2)
    for _ in range(3):
        space.send(START, 0)
    bodies = [parse_body(octets) for octets in iter(lambda: space.poll_transmit(0), None)]
    assert bodies == [Numbered(2, number, 0, START) for number in range(3)]
    space.handle_message(pack_body(Acknowledgement(2, 0)), 0)
    again = space.poll_transmit(500 * MS)
    assert again is not None and parse_body(again) == Numbered(2, 1, 1, START)
    assert (space.sent, space.repeated) == (4, 1)


def test_a_line_is_cut_to_whole_characters() -> None:
    assert fitted_line("a\nb") == "a b"
    assert fitted_line("x" + "ü" * 64) == "x" + "ü" * 63
    assert fitted_line("ü" * 64) == "ü" * 64
