"""A policy at the handle on virtual time: seat, page's joystick, channel and robot."""

import json
import struct
from itertools import count

import numpy as np
import pytest
from gamepads import Pad
from haptic_pair import MS, HapticPair

from kontur_av.returned import PartError
from pipelines.hand.robot_commands import JoystickStatusTeller
from pipelines.seats.plan import seat_plan
from pipelines.seats.seat import Seat
from pipelines.session.access import Role
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.guest import HandleGuest
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.policy import PolicyMessage, taken_action
from telepresence.haptics.device.states import JoystickEvent
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

TOPOLOGY = topology_of(BUILT_IN["taskboard"], pages=True, joystick="page")
PLAN = seat_plan(TOPOLOGY, Segment.SPACE, "s-1", built_in_dictionary())
PAD = topology_of(BUILT_IN["taskboard"], pages=True, joystick="evdev")
PLAN_OF_PAD = seat_plan(PAD, Segment.SPACE, "s-1", built_in_dictionary())
REST = {"x": 0.7, "y": 0.0}
ENDED = {"silent": "silent", "emergency stop": "stop", "halt": "application", "cut": "interrupted"}


class Session(HapticPair):
    """A seat with a page, a policy that wants the robot at `place`, joystick and robot."""

    def __init__(self, device=None):
        self.handle, self.envelope = OperatedHandle(device or PageDevice()), SafetyEnvelope()
        if device is not None:
            self.handle.guest = HandleGuest()
        space = JoystickSide(link=joystick_link(boot_id=1), handle=self.handle)
        ground = RobotSide(link=robot_link(boot_id=2), envelope=self.envelope)
        super().__init__(space, ground, delay_ms=20)
        self.teller = JoystickStatusTeller(self.handle)
        self.teller.handle_watched(True)
        self.seat = Seat(PLAN if device is None else PLAN_OF_PAD, first_command=1)
        self.page = self.seat.handle_opened(Role.OPERATOR, 0)
        self.numbers, self.hand, self.place, self.shadow = count(1), None, (0.0, 0.0), False
        self.run(4000)

    def step(self):
        now_ns, seat = self.now_ns, self.seat
        if self.place and now_ns % (30 * MS) == 0:
            wanted = (now_ns,), (self.place,), now_ns + 300 * MS
            said = PolicyMessage("reach", 1, (self.robot.x_m, self.robot.y_m), now_ns, *wanted)
            seat.handle_policy(said._replace(shadow=self.shadow), now_ns)
        if now_ns % (10 * MS) == 0:
            if (status := self.teller.poll_status(now_ns)) is not None:
                seat.handle_status(status, now_ns)
            if self.hand:
                row = struct.pack("<BBHIffd", 0x82, 1, 0, next(self.numbers), *self.hand, -1.0)
                seat.handle_message(self.page, row, now_ns)
            seat.handle_policy_time(now_ns)
        while (event := seat.next_event()) is not None:
            if isinstance(event, PageInput):
                (self.handle.guest or self.handle.device).handle_input(
                    event, now_ns - event.received_ns
                )
        self.handle.handle_feedback(self.space.link.latest(now_ns))
        super().step()

    def ask(self, action):
        """Ask for the handle at the page; return why it is refused."""
        words = json.dumps({"request": 1, "do": "hand", "action": action})
        self.seat.handle_text(self.page, words, self.now_ns)
        sent = iter(lambda: self.seat.poll_transmit(self.page), None)
        texts = [json.loads(text) for text in sent if isinstance(text, str)]
        return next(text["error"] for text in texts if text["kind"] == "answer")

    def at(self, *place):
        return place == pytest.approx((self.robot.x_m, self.robot.y_m), abs=0.003)

    @property
    def driver(self):
        return self.seat.policy.state


def test_it_reaches_and_any_person_takes_over_from_where_the_robot_is():
    session = Session()
    # Each press begins where the robot is: no offset adds up.
    for session.place in ((0.04, -0.03), (-0.05, 0.02), (0.0, -0.04)):
        assert session.ask("policy") == ""
        session.run(2500)
        assert session.at(*session.place) and session.driver.drives
        assert session.ask("take") == ""
        session.run(300)
        assert session.at(*session.place) and session.driver.who == "operator"
    for session.hand, place in (((0.5, 0.5), (0.0, -0.04)), ((0.7, 0.5), (0.03, -0.04))):
        session.run(1000)
        assert session.at(*place)
    refused = session.handle.handle_command(JoystickEvent.POLICY)
    assert refused == "policy: no policy is at the handle"
    session.hand, session.place = None, (0.0, 0.0)
    assert session.ask("give") == ""
    session.handle.operation.policy = session.driver.policy
    assert session.handle.handle_command(JoystickEvent.POLICY) == ""
    session.run(2500)
    assert session.at(0.0, 0.0) and session.driver.drives
    assert session.handle.handle_command(JoystickEvent.PERSON) == ""
    session.run(300)
    assert session.driver.who == ""


@pytest.mark.parametrize("cause", ENDED)
def test_after_an_interruption_nothing_moves_before_a_person_hands_over(cause):
    session = Session()
    session.place = (0.09, 0.0)
    assert session.ask("policy") == ""
    session.run(600)
    session.place, session.cut = () if cause == "silent" else session.place, cause == "cut"
    if cause == "halt":
        session.handle.handle_command(JoystickEvent.HALT)
    elif cause == "emergency stop":
        session.envelope.handle_stop(session.now_ns)
    session.run(1000)
    session.place, session.cut, rests = (-0.05, 0.0), False, session.robot.x_m
    session.envelope.handle_stop_released(session.now_ns)
    session.handle.handle_command(JoystickEvent.START)
    session.run(3000)
    assert abs(session.robot.x_m - rests) < 0.005
    assert not session.driver.drives and ENDED[cause] in session.seat.policy.events[-1].what
    assert session.ask("policy") == ""
    session.run(2500)
    assert session.at(-0.05, 0.0)


def test_at_a_device_the_policy_drives_and_the_persons_button_takes_over_at_once():
    session = Session(pad := Pad())
    session.place = (0.05, -0.03)
    assert session.ask("take") == "the joystick evdev steers"
    pad.stick.handle_event(1, 0x136, 1)
    session.run(300)
    assert session.driver.who == "the joystick evdev"
    assert "the joystick evdev has the handle" in session.ask("policy")
    pad.stick.handle_event(1, 0x136, 0)
    session.run(200)
    for end in ("person", "page", "button"):
        assert session.ask("policy") == ""
        session.run(1200)
        # The person's stick is deflected, and moves nothing.
        pad.stick.handle_event(3, 0, 255)
        session.run(200)
        assert session.at(0.05, -0.03) and session.driver.drives
        if end == "person":
            pad.stick.handle_event(1, 0x136, 1)
            session.run(500)
            assert session.at(0.05, -0.03) and session.driver.who == "the joystick evdev"
            # The same press counts, from where the robot is.
            pad.stick.handle_event(3, 0, 190)
            session.run(500)
            assert session.robot.x_m < 0.03
            pad.stick.handle_event(1, 0x136, 0)
        elif end == "page":
            assert session.ask("take") == ""
        else:
            session.handle.operation.policy, session.handle.operation.driver = "reach", "reach"
            pad.read = lambda: pad.stick.reading()._replace(hand_over=True)
        session.run(200)
        assert not session.driver.drives and session.driver.who == ""
        pad.stick.handle_event(3, 0, 128)
        session.run(300)


def test_a_shadow_is_told_and_never_obeyed():
    session = Session()
    session.shadow, session.place = True, (0.05, 0.0)
    session.run(100)
    assert session.ask("policy") == "policy: it only watches"
    assert session.driver.wanted == (0.05, 0.0) and not session.driver.drives


def test_what_a_policy_returns_is_converted_or_named_in_one_line():
    for nonsense in ([1.0], {"yaw": 0.1}, [float("nan"), 0.0], "far", object(), [[0, 0], "x"]):
        with pytest.raises(PartError, match=r"^step\(\) .+$"):
            taken_action(nonsense, REST, 0.1)
    chunk = taken_action(np.float32([[0.5, 0.25], [1, 1]]), REST, 0.1)
    assert chunk == [(0.0, (0.5, 0.25)), (0.1, (1.0, 1.0))]
    assert taken_action({0.2: {"y": np.int64(1)}, 9.0: [0, 0]}, REST, 0.1) == [(0.2, (0.7, 1.0))]
    assert taken_action(None, REST, 0.1) == []
