"""The handle has at most one holder, and only the holder's inputs move it."""

from hypothesis import example, given
from hypothesis import strategies as st

from pipelines.seats.holders import HandGate, HandleOwnership, HandleState
from telepresence.haptics.device.page import PageInput

#: Pages 1 to 3 may command; page 9 may only watch.
OPERATORS, VIEWER = (1, 2, 3), 9
pages = st.sampled_from([*OPERATORS, VIEWER])
deeds = st.tuples(
    pages,
    st.sampled_from(["joined", "gone", "take", "ask", "give", "refuse", "hand", "let go", "poll"]),
)


def joined(*pages):
    ownership = HandleOwnership()
    for page in pages:
        ownership.handle_joined(page, f"operator {page}")
    return ownership


@example(
    [(1, "joined"), (2, "joined"), (1, "take"), (1, "hand"), (1, "give"), (2, "take"), (2, "hand")]
)
@given(st.lists(deeds, max_size=60))
def test_only_the_one_holder_moves_the_handle_and_each_hand_begins_with_a_release(script):
    ownership = HandleOwnership()
    gate = HandGate(ownership)
    here: set[int] = set()
    told: list[tuple[int | None, PageInput]] = []
    for number, (page, deed) in enumerate(script):
        before = ownership.state
        if deed in ("hand", "let go"):
            passed = gate.handle_input(page, PageInput(deed == "hand", 0.5, 0.5, 0, number, number))
            if passed is not None:
                assert page == before.holder
                assert passed.dead_man <= (deed == "hand")
                told.append((page, passed))
        elif deed == "joined":
            if page != VIEWER:
                ownership.handle_joined(page, f"operator {page}")
                here.add(page)
        elif deed == "gone":
            ownership.handle_gone(page)
            here.discard(page)
        elif deed != "poll":
            getattr(ownership, f"handle_{deed}")(page)
        # Also when the process did not notice the change of the holder.
        release = gate.poll_release(number) if deed == "poll" else None
        if release is not None:
            assert not release.dead_man
            told.append((None, release))
        holder, wanted_by = ownership.state
        assert holder is None or holder in here
        assert wanted_by is None or (wanted_by in here and wanted_by != holder is not None)
        # A holder changes only by its own deed, or by going.
        if before.holder is not None and holder != before.holder:
            assert page == before.holder and deed in ("give", "gone")
        assert ownership.next_event() == (None if before == ownership.state else ownership.state)
    hands = [hand for _, hand in told]
    assert [hand.sequence for hand in hands] == list(range(1, len(hands) + 1))
    holding = None
    for page, hand in told:
        assert holding in (None, page) or not hand.dead_man
        holding = page if hand.dead_man else None


def test_the_handle_is_handed_over_by_its_holder_or_free_when_that_is_gone():
    ownership = joined(1, 2, 3)
    assert ownership.handle_take(1) == ""
    assert ownership.handle_take(2) == "take: operator 1 has the handle: ask for it"
    assert ownership.handle_ask(2) == ""
    assert ownership.state == HandleState(1, 2)
    assert ownership.handle_ask(3) == "ask: operator 2 has asked before"
    assert ownership.handle_refuse(1) == ""
    assert ownership.handle_ask(3) == ""
    assert ownership.handle_give(1) == ""
    assert ownership.state == HandleState(3)
    ownership.handle_gone(3)
    assert ownership.state == HandleState()
    assert ownership.handle_ask(2) == ""
    assert ownership.state == HandleState(2)
    assert ownership.handle_give(2) == ""
    assert ownership.state == HandleState()


def test_a_page_that_may_only_watch_is_refused():
    ownership = joined(1)
    for deed in (ownership.handle_take, ownership.handle_ask):
        assert deed(VIEWER) == "take: this page may watch only"
    assert ownership.handle_give(VIEWER) and ownership.handle_refuse(VIEWER)
    assert not ownership.may_move(VIEWER)


def test_replayed_and_impossible_inputs_are_refused():
    ownership = joined(1)
    ownership.handle_take(1)
    gate = HandGate(ownership)
    assert gate.handle_input(1, PageInput(True, 0.0, 0.0, 0, 2**32 - 1)) is not None
    assert gate.handle_input(1, PageInput(True, 0.0, 0.0, 0, 2**32 - 1)) is None
    assert gate.handle_input(1, PageInput(True, float("nan"), 0.0, 0, 0)) is None
    assert gate.handle_input(1, PageInput(True, 0.0, 1.01, 0, 0)) is None
    assert gate.handle_input(1, PageInput(True, 0.0, 1.0, 0, 0)) is not None
