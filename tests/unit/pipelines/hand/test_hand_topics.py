"""What the operator's page and the joystick tell each other; the desk that hands the robot over."""

import json

from hypothesis import example, given
from hypothesis import strategies as st

from pipelines.hand import hand_topics
from telepresence.haptics.authority import Authority, ControlAuthority
from telepresence.haptics.axes import AXIS_NAMES
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import REQUESTS


@given(
    st.builds(
        PageInput,
        st.booleans(),
        *[st.floats(allow_nan=False)] * 2,
        *[st.integers(0, 2**32 - 1)] * 2,
        *[st.integers(0, 2**63 - 1)] * 2,
        st.lists(st.floats(-1, 1), max_size=5).map(tuple),
    ),
    st.sampled_from(sorted(REQUESTS, key=lambda one: one.value)),
)
def test_an_input_and_a_request_are_read_back(hand, event):
    data = hand_topics.pack_input(hand)
    assert len(data) <= hand_topics.INPUT_OCTETS
    assert hand_topics.unpack_input(data) == hand
    request = hand_topics.HandRequest(hand.received_ns, event)
    assert len(hand_topics.pack_request(request)) <= hand_topics.REQUEST_OCTETS
    assert hand_topics.unpack_request(hand_topics.pack_request(request)) == request


@given(st.binary(max_size=96))
@example(bytes(hand_topics.INPUT_OCTETS))
@example(bytes(hand_topics.INPUT_OCTETS + 8))
def test_other_octets_are_nothing(data):
    request, status = hand_topics.unpack_request(data), hand_topics.unpack_status(data)
    assert request is None or request.event in REQUESTS
    assert status is None or len(data) > 20
    assert (hand_topics.unpack_input(data) is None) == (
        len(data)
        not in range(
            hand_topics.INPUT_OCTETS - 8 * len(AXIS_NAMES), hand_topics.INPUT_OCTETS + 1, 8
        )
    )


def ask(service, line):
    service.service.handle_terminal(1)
    service.service.handle_octets(1, line, now_ns=0)
    reply = service.service.next_event()
    assert reply.last and service.service.asking == []
    return reply.octets


def test_an_order_stands_until_the_next_and_the_answer_says_who_drives():
    service = hand_topics.ControlArbiter()
    answer = json.loads(ask(service, b'{"authority": "partner"}\n'))
    assert service.order is Authority.PARTNER
    assert answer["ok"] and answer["wanted"] == "partner" and "authority" not in answer
    ownership = ControlAuthority(None)
    ownership.handle_order(Authority.PARTNER, 0)
    for now_ns in (0, 10**9):
        ownership.handle_robot(0.0, now_ns)
    service.handle_state(
        hand_topics.ArmState.unpack(
            hand_topics.ArmState.of(ownership.report(), waiting=True).pack()
        )
    )
    answer = json.loads(ask(service, b"{}\n"))
    assert answer["authority"] == "partner" and answer["waiting"]
    assert service.order is Authority.PARTNER


def test_an_unknown_owner_changes_nothing_and_garbage_gets_no_answer():
    service = hand_topics.ControlArbiter(Authority.PARTNER)
    for authority in ("bob", 7, None, ["operator"], {"authority": "operator"}):
        answer = json.loads(ask(service, json.dumps({"authority": authority}).encode() + b"\n"))
        assert not answer["ok"] and answer["mistake"]
        assert "take operator or partner" in answer["error"]
    for line in (b"\n", b"[" * 4000 + b"\n", b"\xff\n", b"", b"x" * 9000):
        assert ask(service, line) == b""
    assert service.order is Authority.PARTNER
