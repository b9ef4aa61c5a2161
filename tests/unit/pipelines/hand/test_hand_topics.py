"""What the operator's page and the joystick tell each other; the desk that hands the robot over."""

import json

from pipelines.hand import hand_topics
from telepresence.haptics.authority import Authority, ControlAuthority


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
    service.handle_state(hand_topics.ArmState.of(ownership.report(), waiting=True))
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
