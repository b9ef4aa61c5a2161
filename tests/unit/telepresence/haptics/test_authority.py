"""One robot, two who may drive it: the port has one owner, and changes hands at rest."""

import pytest
from haptic_pair import MS

from telepresence.haptics.authority import Authority, ControlAuthority, PartnerBoard
from telepresence.haptics.sample import (
    Command,
    Feedback,
    Greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
)

OURS = pack_command(1, Command(0.01, 0.0, 0), session=3)
THEIRS = pack_feedback(1, Feedback(2.0, 0.0, 0, True), session=3)


def test_an_order_that_is_given_again_changes_nothing_and_rest_is_needed():
    ownership = ControlAuthority()
    ownership.handle_order(Authority.OPERATOR, 0)
    assert ownership.authority is Authority.OPERATOR and ownership.report().events == ()
    ownership.handle_order(Authority.PARTNER, 0)
    for ms in range(1000):
        assert not ownership.handle_robot(0.0051, ms * MS)
    # At rest from the last motion on, at 999 ms.
    found = [ms for ms in range(1000, 1700) if ownership.handle_robot(0.005, ms * MS)]
    assert found == [1299]
    metrics = ownership.report()
    assert (metrics.authority, metrics.turns) == (Authority.PARTNER, 1)
    assert [event.what for event in metrics.events] == ["handing over to partner", "partner drives"]
    # While nobody drives, an order changes who will, and rest goes on.
    ownership.handle_order(Authority.OPERATOR, 2000 * MS)
    for ms in range(2000, 2200):
        ownership.handle_robot(0.0, ms * MS)
    ownership.handle_order(Authority.PARTNER, 2200 * MS)
    found = [ms for ms in range(2200, 2500) if ownership.handle_robot(0.0, ms * MS)]
    assert found == [2300] and ownership.authority is Authority.PARTNER
    assert (ownership.takes(Authority.PARTNER), ownership.takes(Authority.OPERATOR)) == (
        True,
        False,
    )
    assert ownership.report().refused == {"partner": 0, "operator": 1}


def rest(board, now_ns):
    """The robot at hand rests for as long as a handover takes."""
    for ms in range(301):
        board.ownership.handle_robot(0.0, now_ns + ms * MS)
    return now_ns + 301 * MS


@pytest.mark.parametrize("more", [0, 2])
def test_a_joystick_drives_one_of_two_robots(more):
    board, axes = PartnerBoard(ControlAuthority()), bytes(5 * more)
    asks = [
        pack_greeting(Greeting(0, 9, 0, who), feedback=False, holding=True) + axes for who in (0, 1)
    ]
    ours, theirs = OURS + axes, THEIRS + axes
    assert (board.left_out, board.state(0), board.is_there(0)) == (False, "absent", False)
    assert board.handle_joystick(ours, 0) and board.handle_joystick(asks[0], 0)
    board.handle_partner(theirs, 0)
    # It is there, and neither of the two hears of the other.
    assert [board.state(ms * MS) for ms in (0, 500, 501)] == ["ready", "ready", "absent"]
    assert board.poll_joystick() is None and board.poll_partner(stopped=False) is None
    # The first request for the other ends what was; the samples of neither are taken meanwhile.
    assert not board.handle_joystick(asks[1], MS) and board.left_out
    assert not board.handle_joystick(ours, MS) and board.poll_partner(stopped=False) is None
    assert board.ownership.report().refused == {"operator": 2, "partner": 0}
    now_ns = rest(board, MS)
    assert board.left_out and board.ownership.authority is Authority.PARTNER
    for data in (asks[1], ours):
        assert not board.handle_joystick(data, now_ns)
    # The newest alone goes on, and once; an emergency stop holds it back.
    assert board.poll_partner(stopped=False) == ours and board.poll_partner(stopped=False) is None
    board.handle_joystick(ours, now_ns)
    assert board.poll_partner(stopped=True) is None and board.poll_partner(stopped=False) is None
    board.handle_partner(theirs, now_ns)
    assert board.state(now_ns) == "driven"
    seen = board.seen(now_ns + 2 * MS)
    assert seen[:4] == pytest.approx((0.01, 0.0, 2.0, 0.0), abs=2e-3)
    assert (seen.contact, seen.age_ns) == (True, 2 * MS)
    assert board.seen(now_ns + 501 * MS) is None
    assert board.poll_joystick() == theirs and board.poll_joystick() is None
    # A malformed greeting is ignored; the caller counts it.
    garbled = bytes([1]) + asks[0][1:]
    assert board.handle_joystick(garbled, now_ns) is False
    assert board.ownership.wanted is Authority.PARTNER
    assert not board.handle_joystick(asks[0], now_ns) and board.left_out
    rest(board, now_ns)
    assert not board.left_out and board.handle_joystick(garbled, now_ns)


@pytest.mark.rule("7")
@pytest.mark.parametrize("data", [b"", bytes(11), bytes(13), OURS])
def test_a_partner_that_sends_garbage_is_not_there(data):
    board = PartnerBoard(ControlAuthority(Authority.PARTNER))
    board.handle_partner(data, 0)
    assert (board.ownership.garbage, board.is_there(0)) == (1, False)
    assert board.poll_joystick() is None
