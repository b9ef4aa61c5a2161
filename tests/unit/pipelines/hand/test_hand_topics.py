"""What the operator's page and the joystick tell each other; the arbiter of control."""

from pipelines.hand import hand_topics
from telepresence.haptics.authority import Authority, ControlAuthority


def test_an_order_stands_until_the_next_and_the_answer_says_who_drives():
    arbiter = hand_topics.ControlArbiter()
    answer = arbiter.handle_request(hand_topics.AuthorityRequest(Authority.PARTNER), 0)
    assert arbiter.order is Authority.PARTNER
    assert (answer.authority, answer.wanted) == ("", "partner")
    ownership = ControlAuthority(None)
    ownership.handle_order(Authority.PARTNER, 0)
    for now_ns in (0, 10**9):
        ownership.handle_robot(0.0, now_ns)
    arbiter.handle_state(hand_topics.ArmState.of(ownership.report(), waiting=True))
    answer = arbiter.handle_request(hand_topics.AuthorityRequest(), 0)
    assert answer.authority == "partner" and answer.waiting
    assert arbiter.order is Authority.PARTNER
