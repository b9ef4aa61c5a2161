"""The desk that hands the robot over: requests of terminals, and who drives."""

import json

import pytest

from pipelines.hand.hand_topics import ArmState, OwnerDesk
from telepresence.haptics.ownership import HapticOwnership, Owner


def ask(desk, line):
    desk.desk.handle_terminal(1)
    desk.desk.handle_octets(1, line, now_ns=0)
    reply = desk.desk.next_event()
    assert reply.last and desk.desk.asking == []
    return reply.octets


def test_an_order_stands_until_the_next_and_the_answer_says_who_drives():
    desk = OwnerDesk()
    answer = json.loads(ask(desk, b'{"owner": "partner"}\n'))
    assert desk.order is Owner.PARTNER
    assert answer["ok"] and answer["wanted"] == "partner" and "owner" not in answer
    ownership = HapticOwnership(None)
    ownership.handle_order(Owner.PARTNER, 0)
    for now_ns in (0, 10**9):
        ownership.handle_robot(0.0, now_ns)
    desk.handle_state(ArmState.unpack(ArmState.of(ownership.report(), waiting=True).pack()))
    answer = json.loads(ask(desk, b"{}\n"))
    assert answer["owner"] == "partner" and answer["waiting"]
    assert desk.order is Owner.PARTNER


@pytest.mark.parametrize("owner", ["bob", 7, None, ["iss"], {"owner": "iss"}])
def test_an_unknown_owner_changes_nothing(owner):
    desk = OwnerDesk(Owner.PARTNER)
    answer = json.loads(ask(desk, json.dumps({"owner": owner}).encode() + b"\n"))
    assert not answer["ok"] and answer["mistake"] and "take iss or partner" in answer["error"]
    assert desk.order is Owner.PARTNER


@pytest.mark.parametrize("line", [b"\n", b"[" * 4000 + b"\n", b"\xff\n", b"", b"x" * 9000])
def test_garbage_gets_no_answer(line):
    desk = OwnerDesk()
    assert ask(desk, line) == b""
    assert desk.order is Owner.ISS
