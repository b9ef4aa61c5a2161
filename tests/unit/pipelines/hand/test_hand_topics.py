"""What the operator's page and the joystick tell each other; the desk that hands the robot over."""

import json
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from pipelines.hand.desks import JoystickStatusTeller
from pipelines.hand.hand_topics import (
    INPUT_OCTETS,
    REQUEST_OCTETS,
    STATUS_OCTETS,
    ArmState,
    HandRequest,
    OwnerDesk,
    pack_input,
    pack_request,
    unpack_input,
    unpack_request,
    unpack_status,
)
from pipelines.hand.process_ends import _hand
from telepresence.haptics.axes import AXIS_NAMES
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import REQUESTS, JoystickEvent, JoystickState
from telepresence.haptics.figures import HandInputFigures
from telepresence.haptics.hand import Hand
from telepresence.haptics.ownership import HapticOwnership, Owner


@given(
    st.builds(
        PageInput,
        st.booleans(),
        st.floats(allow_nan=False),
        st.floats(allow_nan=False),
        st.integers(0, 2**32 - 1),
        st.integers(0, 2**32 - 1),
        st.integers(0, 2**63 - 1),
        st.lists(st.floats(-1, 1), max_size=5).map(tuple),
    )
)
def test_an_input_is_read_back(hand):
    data = pack_input(hand)
    assert len(data) <= INPUT_OCTETS
    assert unpack_input(data) == hand


@given(st.integers(0, 2**63 - 1), st.sampled_from(sorted(REQUESTS, key=lambda one: one.value)))
def test_a_request_is_read_back(number, event):
    data = pack_request(HandRequest(number, event))
    assert len(data) <= REQUEST_OCTETS
    assert unpack_request(data) == HandRequest(number, event)


@given(st.binary(max_size=96))
@example(bytes(INPUT_OCTETS))
@example(bytes(INPUT_OCTETS + 8))
def test_other_octets_are_nothing(data):
    request, status = unpack_request(data), unpack_status(data)
    assert request is None or request.event in REQUESTS
    assert status is None or len(data) > 20
    assert (unpack_input(data) is None) == (
        len(data) not in range(INPUT_OCTETS - 8 * len(AXIS_NAMES), INPUT_OCTETS + 1, 8)
    )


class Desk:
    """An operated handle on virtual time, with what its process tells."""

    def __init__(self):
        self.handle = OperatedHandle(SimulatedDevice(hand=Hand()))
        self.teller = JoystickStatusTeller(self.handle)
        self.told = []

    def run(self, milliseconds):
        for _ in range(milliseconds):
            self.handle.step(0.0, 0.0, NS_PER_MS)
            if self.handle.now_ns % (10 * NS_PER_MS) == 0:
                data = self.teller.poll_status(self.handle.now_ns)
                if data is not None:
                    assert len(data) <= STATUS_OCTETS
                    self.told.append(unpack_status(data))

    def request(self, number, event):
        self.told.clear()
        self.teller.handle_request(pack_request(HandRequest(number, event)))
        self.run(20)
        return self.told[0]


def test_a_command_is_answered_with_the_state_that_it_led_to():
    desk = Desk()
    desk.teller.handle_watched(True)
    desk.run(4000)
    assert desk.told[-1].state == JoystickState.APPLICATION
    assert desk.told[-1].answered is None and desk.told[-1].force_limit_n == 12.0
    status = desk.request(7, JoystickEvent.HALT)
    assert (status.state, status.answered, status.refusal) == (JoystickState.HALTED, 7, "")
    assert status.reason == "by a person's command"
    status = desk.request(8, JoystickEvent.ACKNOWLEDGE)
    assert status.answered == 8 and "not in the state halted" in status.refusal
    status = desk.request(9, JoystickEvent.START)
    assert (status.state, status.answered, status.refusal) == (JoystickState.APPLICATION, 9, "")
    desk.told.clear()
    desk.teller.handle_request(b"nonsense")
    desk.run(1000)
    # Nothing has changed but the hand that took the handle.
    assert 10 <= len(desk.told) <= 13 and {one.answered for one in desk.told} == {9}


def test_the_state_is_told_only_while_somebody_reads():
    desk = Desk()
    desk.run(500)
    assert desk.told == []
    desk.teller.handle_watched(True)
    desk.run(10)
    assert [one.state for one in desk.told] == [JoystickState.STANDBY]


def test_inputs_of_a_page_that_move_nothing_are_told():
    told, flushes = [], []
    inputs = [PageInput(False, x, 0.0, 0, number) for number, x in enumerate((0.5, 0.5, 7.0))]
    octets = iter([pack_input(one) for one in (*inputs, inputs[1])])
    reader = SimpleNamespace(latest_octets=lambda: next(octets))
    context = SimpleNamespace(
        on_flush=flushes.append, probe=SimpleNamespace(tell=lambda figures: told.append(figures))
    )
    bus = SimpleNamespace(reader=lambda _topic: reader)
    take = _hand(context, bus, PageDevice(start_m=(0.0, 0.0)), "input")
    for _ in range(4):
        take(0)
    flushes[0]()
    # One out of range, and one that came again.
    assert told == [HandInputFigures(inputs_ignored=2)]


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
