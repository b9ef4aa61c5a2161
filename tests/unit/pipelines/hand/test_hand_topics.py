"""What the operator's page and the joystick tell each other; the arbiter of control."""

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


def test_an_order_stands_until_the_next_and_the_answer_says_who_drives():
    arbiter = hand_topics.ControlArbiter()
    answer = arbiter.handle_request(hand_topics.AuthorityRequest(Authority.PARTNER), 0)
    assert arbiter.order is Authority.PARTNER
    assert (answer.authority, answer.wanted) == ("", "partner")
    ownership = ControlAuthority(None)
    ownership.handle_order(Authority.PARTNER, 0)
    for now_ns in (0, 10**9):
        ownership.handle_robot(0.0, now_ns)
    state = hand_topics.ArmState.of(ownership.report(), waiting=True)
    arbiter.handle_state(hand_topics.ArmState.unpack(state.pack()))
    answer = arbiter.handle_request(hand_topics.AuthorityRequest(), 0)
    assert answer.authority == "partner" and answer.waiting
    assert arbiter.order is Authority.PARTNER
