"""A telecommand is repeated until acknowledged, and executed once, over a lossy path."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from telepresence.tmtc import (
    Housekeeping,
    SelectAck,
    SelectCamera,
    SelectDone,
    SelectFailed,
    TelecommandReceiver,
    TelecommandSender,
    pack_packet,
    parse_packet,
)

MS = 1_000_000


def answer(receiver: TelecommandReceiver, packet: bytes, now_ns: int, ok: bool = True) -> bytes:
    """Pass `packet` to the receiver, execute its telecommand, and return the answer."""
    receiver.handle_packet(packet, now_ns)
    if request := receiver.next_event():
        receiver.handle_result(
            request, ok=ok, selected=request.name if ok else "left", now_ns=now_ns
        )
    reply = receiver.poll_transmit(now_ns)
    assert reply is not None
    return reply


def test_a_selection_and_its_acknowledgement() -> None:
    sender, receiver = TelecommandSender(first_token=65535), TelecommandReceiver()
    assert sender.poll_timeout() is None
    assert sender.select("static", 0) == 65535
    assert sender.poll_timeout() == 0
    packet = sender.poll_transmit(0)
    assert packet is not None
    assert sender.poll_transmit(0) is None
    sender.handle_packet(answer(receiver, packet, 20 * MS), 40 * MS)
    assert sender.next_event() == SelectDone("static", 65535, ok=True, round_trip_ns=40 * MS)
    assert sender.poll_timeout() is None
    assert sender.select("left", 50 * MS) == 0


def test_a_refusal_names_the_selected_camera() -> None:
    sender, receiver = TelecommandSender(first_token=7), TelecommandReceiver()
    sender.select("nowhere", 0)
    packet = sender.poll_transmit(0)
    assert packet is not None
    sender.handle_packet(answer(receiver, packet, 0, ok=False), 0)
    assert sender.next_event() == SelectDone("left", 7, ok=False, round_trip_ns=0)
    assert receiver.executed == 0


def test_three_tries_half_a_second_apart_then_it_gives_up() -> None:
    sender = TelecommandSender(first_token=1)
    sender.select("static", 0)
    sent_at = []
    now_ns = 0
    counts = []
    while (deadline_ns := sender.poll_timeout()) is not None:
        now_ns = deadline_ns
        if packet := sender.poll_transmit(now_ns):
            sent_at.append(now_ns)
            counts.append(parse_packet(packet).count)
    assert sent_at == [0, 500 * MS, 1000 * MS]
    assert counts == [0, 1, 2]
    assert now_ns == 1500 * MS
    assert sender.next_event() == SelectFailed("static", 1, tries=3, superseded=False)
    sender.handle_packet(pack_packet(SelectAck("static", 1, ok=True), 0), 1600 * MS)
    assert (sender.unexpected, sender.next_event()) == (1, None)


def test_a_repetition_is_executed_once_and_answered_again() -> None:
    sender, receiver = TelecommandSender(first_token=1), TelecommandReceiver()
    sender.select("static", 0)
    first, second = sender.poll_transmit(0), sender.poll_transmit(500 * MS)
    assert first is not None
    assert second is not None
    replies = [answer(receiver, first, 10 * MS), answer(receiver, second, 510 * MS)]
    assert (receiver.executed, receiver.duplicates, receiver.next_event()) == (1, 1, None)
    assert [parse_packet(reply).count for reply in replies] == [0, 1]
    assert parse_packet(replies[0]).message == parse_packet(replies[1]).message


def test_a_later_selection_supersedes_an_open_one() -> None:
    sender = TelecommandSender(first_token=1)
    sender.select("static", 0)
    sender.poll_transmit(0)
    sender.select("head", 100 * MS)
    assert sender.next_event() == SelectFailed("static", 1, tries=1, superseded=True)
    packet = sender.poll_transmit(100 * MS)
    assert packet is not None
    assert parse_packet(packet).message == SelectCamera("head", 2)
    sender.handle_packet(pack_packet(SelectAck("static", 1, ok=True), 0), 120 * MS)
    assert (sender.unexpected, sender.poll_timeout()) == (1, 600 * MS)


def test_a_token_is_forgotten_after_some_time() -> None:
    receiver = TelecommandReceiver(memory_ns=1_000 * MS)
    packet = pack_packet(SelectCamera("static", 5), 0)
    answer(receiver, packet, 0)
    answer(receiver, packet, 1_000 * MS)
    assert receiver.executed == 1
    answer(receiver, packet, 2_001 * MS)
    assert receiver.executed == 2
    answer(receiver, pack_packet(SelectCamera("head", 5), 0), 2_001 * MS)
    assert receiver.executed == 3


def test_waiting_answers_are_bounded() -> None:
    receiver = TelecommandReceiver()
    for token in range(1000):
        receiver.handle_packet(pack_packet(SelectCamera("static", token), 0), 0)
        request = receiver.next_event()
        assert request is not None
        receiver.handle_result(request, ok=True, selected="static", now_ns=0)
    receiver.handle_housekeeping(Housekeeping("left", contact=False, force_n=0.0), 0)
    receiver.handle_housekeeping(Housekeeping("static", contact=True, force_n=1.0), 0)
    messages = []
    while packet := receiver.poll_transmit(0):
        messages.append(parse_packet(packet).message)
    assert receiver.dropped_answers == 984
    assert [m.token for m in messages if isinstance(m, SelectAck)] == list(range(984, 1000))
    assert messages[16:] == [Housekeeping("static", contact=True, force_n=1.0)]


def test_housekeeping_reaches_the_sender() -> None:
    sender = TelecommandSender(first_token=0)
    message = Housekeeping("static", contact=True, force_n=-3.5)
    sender.handle_packet(pack_packet(message, 0), 0)
    assert sender.next_event() == message


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(ConfigError, match="1 to 10"):
        TelecommandSender(first_token=0).select("the-overhead-camera", 0)
    with pytest.raises(ConfigError, match="at least one try"):
        TelecommandSender(first_token=0, tries=0)


@given(
    st.lists(st.tuples(st.booleans(), st.booleans(), st.integers(0, 3)), min_size=3, max_size=3),
    st.integers(0, 65535),
)
def test_a_command_is_executed_at_most_once_and_done_means_executed(
    ways: list[tuple[bool, bool, int]], token: int
) -> None:
    """ways: for each try, whether the command and the answer pass, and how often it doubles."""
    sender, receiver = TelecommandSender(first_token=token), TelecommandReceiver()
    sender.select("static", 0)
    handed_out = 0
    for there, back, copies in ways:
        now_ns = sender.poll_timeout()
        packet = None if now_ns is None else sender.poll_transmit(now_ns)
        if packet is None or now_ns is None:
            break
        if not there:
            continue
        for _ in range(1 + copies):
            receiver.handle_packet(packet, now_ns)
        while request := receiver.next_event():
            handed_out += 1
            receiver.handle_result(request, ok=True, selected=request.name, now_ns=now_ns)
        while reply := receiver.poll_transmit(now_ns):
            if back:
                sender.handle_packet(reply, now_ns)
    if (now_ns := sender.poll_timeout()) is not None:
        assert sender.poll_transmit(now_ns) is None
    assert handed_out == any(there for there, _, _ in ways)
    event = sender.next_event()
    assert isinstance(event, SelectDone if any(t and b for t, b, _ in ways) else SelectFailed)
    assert sender.next_event() is None
