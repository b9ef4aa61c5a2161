"""Who holds the handle, cameras and microphones: only the holder's inputs count."""

import json
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.seats.holders import Given, HandGate, HandleAuthority, HandleState, OwnInputs
from pipelines.seats.plan import seat_plan
from pipelines.session.access import Role
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.device.page import PageInput
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

#: Pages 1 to 3 may command; page 9 may only watch.
OPERATORS, VIEWER = (1, 2, 3), 9
pages = st.sampled_from([*OPERATORS, VIEWER])
deeds = st.tuples(
    pages,
    st.sampled_from(["joined", "gone", "take", "ask", "give", "refuse", "hand", "let go", "poll"]),
)


def joined(*pages):
    ownership = HandleAuthority()
    for page in pages:
        ownership.handle_joined(page, f"operator {page}")
    return ownership


@example(
    [(1, "joined"), (2, "joined"), (1, "take"), (1, "hand"), (1, "give"), (2, "take"), (2, "hand")]
)
@given(st.lists(deeds, max_size=60))
def test_only_the_one_holder_moves_the_handle_and_each_hand_begins_with_a_release(script):
    ownership = HandleAuthority()
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
    # A page that may only watch is refused.
    for deed in (ownership.handle_take, ownership.handle_ask):
        assert deed(VIEWER) == "take: this page may watch only"
    assert ownership.handle_give(VIEWER) and ownership.handle_refuse(VIEWER)
    assert not ownership.may_move(VIEWER)


def test_replayed_and_impossible_inputs_are_refused_and_too_much_closes_the_socket():
    ownership = joined(1)
    ownership.handle_take(1)
    gate, last = HandGate(ownership), 2**32 - 1
    for x, y, sequence, passes in (
        (0.0, 0.0, last, True),
        (0.0, 0.0, last, False),
        (float("nan"), 0.0, 0, False),
        (0.0, 1.01, 0, False),
        (0.0, 1.0, 0, True),
    ):
        passed = gate.handle_input(1, PageInput(True, x, y, 0, sequence))
        assert (passed is not None) is passes
    inputs = opened(Role.OPERATOR)
    ask(inputs, 0, "operator_camera")
    with pytest.raises(ProtocolError):
        for _ in range(200):
            inputs.handle_message(0, picture(0.0), NS_PER_S)
    for text in ("{", '{"request": 1, "do": "session", "action": "stop"}'):
        with pytest.raises(ProtocolError):
            inputs.handle_text(0, text, 0)
    with pytest.raises(ProtocolError, match="unknown type"):
        inputs.handle_message(0, bytes(24), 0)


PLAN = seat_plan(
    topology_of(BUILT_IN["spacejustin"], pages=True), Segment.SPACE, "x", built_in_dictionary()
)
CAMERA, MICROPHONE = PLAN.inputs


def picture(page_ms, index=CAMERA.index):
    width, height = CAMERA.size
    octets = bytes(width * height * 3 // 2)
    return struct.pack("<BBHHxxd", 0x83, index, width, height, page_ms) + octets


def opened(*roles):
    inputs = OwnInputs(PLAN)
    for link, role in enumerate(roles):
        inputs.handle_opened(link, role)
    return inputs


def ask(inputs, link, name, *, on=True):
    text = json.dumps({"request": 1, "do": "input", "name": name, "on": on})
    return json.loads(inputs.handle_text(link, text, 0))["error"]


def test_an_input_belongs_to_one_page_until_it_is_given_back_or_gone():
    inputs = opened(Role.OPERATOR, Role.OPERATOR)
    assert ask(inputs, 0, "operator_camera") == ask(inputs, 0, "operator_camera") == ""
    assert ask(inputs, 1, "operator_camera") == "operator_camera: operator has it at another page"
    assert (
        ask(inputs, 1, "operator_camera", on=False) == "operator_camera: this page does not have it"
    )
    assert ask(inputs, 1, "operator_mic") == ""
    assert inputs.owners == {"operator_camera": 0, "operator_mic": 1}
    assert inputs.handle_message(1, picture(0.0), 0) is None
    assert ask(inputs, 0, "operator_camera", on=False) == ""
    assert ask(inputs, 1, "operator_camera") == ""
    inputs.handle_closed(1)
    assert inputs.owners == {"operator_camera": None, "operator_mic": None}
    # Only inputs of this seat, and no viewer.
    inputs = opened(Role.OPERATOR, Role.VIEWER)
    assert ask(inputs, 0, "head") == "head: no page can give this input here"
    assert ask(inputs, 1, "operator_camera") == "a viewer may watch only"
    assert inputs.handle_message(1, picture(0.0), 0) is None


def test_what_is_given_is_dated_by_the_ping_that_took_least_time():
    inputs = opened(Role.OPERATOR)
    ask(inputs, 0, "operator_camera")
    ask(inputs, 0, "operator_mic")

    def capture_ms(page_ms, now_ms):
        given = inputs.handle_message(0, picture(page_ms), now_ms * NS_PER_MS)
        assert isinstance(given, Given) and given.input is CAMERA
        return given.stamp.capture_ns / NS_PER_MS

    assert capture_ms(1e9, 1000) == 1000
    for page_ms, now_ms in ((100.0, 1150), (200.0, 1201), (300.0, 1390)):
        ping = struct.pack("<B7xd", 0x81, page_ms)
        assert inputs.handle_message(0, ping, now_ms * NS_PER_MS)[:1] == b"\5"
    assert capture_ms(390.0, 1400) == 1391
    assert capture_ms(500.0, 1400) == 1400
    assert capture_ms(-1e9, 1400) == 900
    sound = struct.pack("<BBHId", 0x84, MICROPHONE.index, 960, 5, 390.0) + bytes(1920)
    given = inputs.handle_message(0, sound, 1400 * NS_PER_MS)
    assert (given.input, given.stamp.sequence, len(given.data)) == (MICROPHONE, 5, 1920)
