"""What a seat's pages are sent, and what comes of what they send."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, Quality, empty_picture
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import JoystickStatus
from pipelines.hand.haptic_trace import BLOCK_ROWS, ROW
from pipelines.mission.tmtc_messages import CommandUpdate, SendCommand
from pipelines.seats.plan import seat_plan
from pipelines.seats.seat import MOST_ACTING, MOST_VIEWERS, PageRequest, Seat, StopAsked
from pipelines.seats.texts import ExerciseRequest, RecordingRequest
from pipelines.session.access import Role
from pipelines.session.mission_messages import RobotStatus
from pipelines.session.session_metrics import Event, SessionNews
from pipelines.session.session_switch import Order
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

DICTIONARY = built_in_dictionary()
SELECT_HEAD = {"application": "camera", "name": "select", "arguments": ["head"]}
TOLD = "emergency stop by a telecommand: the robot is off"
WATCH_ONLY = "a viewer may watch only"
TOPOLOGY = topology_of(BUILT_IN["spacejustin"], pages=True, joystick="page")
KEY, DELTA = b"\0\0\0\1\x67s\0\0\0\1\x68p\0\0\0\1\x65i", b"\0\0\0\1\x41d"
FREE = {"holder": None, "you": False, "wanted_by": None, "who": "", "asks": "", "policy": ""}
HAPTICS = np.zeros(BLOCK_ROWS, ROW).tobytes()


class Page:
    """An open page: what it is sent, and what it sends."""

    def __init__(self, seat, role, now_ns, **options):
        self.seat = seat
        self.number = seat.handle_opened(role, now_ns, **options)

    def sent(self):
        return list(iter(lambda: self.seat.poll_transmit(self.number), None))

    def texts(self, kind):
        found = [json.loads(text) for text in self.sent() if isinstance(text, str)]
        return [text for text in found if text["kind"] == kind]

    def errors(self):
        return [text["error"] for text in self.texts("answer")]

    def units(self):
        """(flags, number) of each unit."""
        return [units_of(one) for one in self.sent() if one[0] == 1]

    def ask(self, do, **fields):
        self.seat.handle_text(self.number, json.dumps({"request": 7, "do": do} | fields), 0)

    def send(self, octets, now_ns=0):
        self.seat.handle_message(self.number, octets, now_ns)

    def close(self, now_ns):
        self.seat.handle_closed(self.number, now_ns)


def units_of(message):
    return message[2], struct.unpack_from("<I", message, 4)[0]


class Room:
    """A seat with its pages, and what comes of them."""

    def __init__(self, segment=Segment.SPACE, topology=TOPOLOGY):
        plan = seat_plan(topology, segment, "spacejustin-1", DICTIONARY)
        self.seat = Seat(plan, first_command=100)

    def open(self, role=Role.OPERATOR, now_ns=0, *, unread=True, **options):
        page = Page(self.seat, role, now_ns, **options)
        if not unread:
            page.sent()
        return page

    def events(self):
        return list(iter(self.seat.next_event, None))

    def give_unit(self, number, *, key=False, stream=0, **fields):
        unit = CodedUnit(data=KEY if key else DELTA, key=key, width=64, height=48, **fields)
        stamp = CaptureStamp(number * NS_PER_MS, number, "uplink_video", rtp_timestamp=number)
        self.seat.media.handle_unit(stream, unit, stamp, number)


@pytest.fixture
def space():
    return Room()


@pytest.fixture
def ground():
    return Room(Segment.GROUND)


def hand(sequence, *, dead_man=True, x=0.0):
    return struct.pack("<BBHIffd", 0x82, dead_man, 0, sequence, x, 0.0, 1.0)


def test_a_page_is_told_first_where_it_is_and_what_it_sees(space, ground):
    page = space.open(now_ns=5 * NS_PER_MS)
    hello = json.loads(page.sent()[0])
    assert (hello["kind"], hello["seat"], hello["role"]) == ("hello", "space", "operator")
    assert (hello["page"], hello["now_us"]) == (page.number, 5000)
    streams = [(each["index"], each["name"], each["via"]) for each in hello["streams"]]
    assert streams == [(0, "uplink_video", "coded"), (1, "uplink_voice", "sound")]
    assert [each["name"] for each in hello["inputs"]] == ["operator_camera", "operator_mic"]
    stereo = {"name": "stereo", "inputs": ["left", "right"], "layout": "merged"}
    assert hello["cameras"][0] == stereo
    # Ground control sees what comes, what it sends, and all cameras.
    (hello,) = ground.open().texts("hello")
    assert {each["name"]: each["via"] for each in hello["streams"]} == {
        "uplink_video": "sent",
        "downlink_video": "coded",
        "downlink_voice": "sound",
    }
    assert [each["input"] for each in hello["previews"]] == ["left", "right", "static", "head"]
    assert [each["name"] for each in hello["inputs"]] == ["ground_mic"]


def test_who_joins_is_sent_a_key_picture_and_the_units_since_and_draws_only_the_newest(
    space, ground
):
    for number in range(4):
        space.give_unit(number, key=number == 0)
    assert space.seat.media.poll_asks(0) == []
    page = space.open(Role.VIEWER)
    assert space.seat.media.poll_asks(0) == space.seat.media.lanes
    space.give_unit(4)
    assert page.units() == []
    space.give_unit(3, key=True, added=True)
    assert page.units() == [(5, 3), (0, 4)]
    space.give_unit(5, damaged=True)
    assert page.units() == [(2, 5)]
    space.give_unit(6, key=True)
    assert page.units() == [(1, 6)]
    # The seat itself has missed some.
    space.give_unit(9)
    assert page.units() == [] and 0 in space.seat.media.poll_asks(0)
    space.give_unit(9, key=True, added=True)
    space.give_unit(10)
    assert page.units() == [(1, 9), (0, 10)]

    # Every page gets sound, haptics and previews.
    pages = [ground.open(Role.VIEWER, unread=False) for _ in range(2)]
    media = ground.seat.media
    media.handle_sound(2, b"\1\0" * 960, CaptureStamp(5, 1, "x", Quality.CONCEALED))
    media.handle_haptics(1, HAPTICS)
    media.handle_preview(3, empty_picture(160, 120), CaptureStamp(5, 1, "head"))
    for page in pages:
        assert [one[:3] for one in page.sent()] == [b"\2\2\1", b"\3\1\x14", b"\4\3\xa0"]


@pytest.mark.rule("4")
def test_a_page_that_stalls_begins_with_a_key_picture_when_it_takes_again(space):
    slow, quick = (space.open(Role.VIEWER, unread=False) for _ in range(2))
    space.give_unit(0, key=True)
    assert quick.units() == [(1, 0)]
    for number in range(1, 61):
        space.give_unit(number)
        if number == 1:
            # It takes a message, and then no other.
            assert units_of(space.seat.poll_transmit(slow.number)) == (1, 0)
        assert quick.units() == [(0, number)]
    media = space.seat.media
    assert 0 not in media.poll_asks(0)
    assert slow.units() == []
    assert 0 in media.poll_asks(0)
    space.give_unit(61)
    space.give_unit(60, key=True, added=True)
    assert slow.units() == [(5, 60), (0, 61)] and quick.units() == [(0, 61)]
    assert space.seat.left_out == 60
    # The key picture itself may be the newest that there is.
    late = space.open(Role.VIEWER, unread=False)
    space.give_unit(61, key=True, added=True)
    assert late.units() == [(1, 61)]


@pytest.mark.rule("10")
def test_the_hand_of_the_holder_alone_moves_and_lets_go_when_its_page_is_gone(space):
    one, other = space.open(), space.open()
    one.send(hand(1))
    assert space.events() == []
    one.ask("hand", action="take")
    one.send(hand(2, x=0.5), 10)
    other.send(hand(3, x=-0.5), 11)
    (moved,) = space.events()
    assert (moved.dead_man, moved.x, moved.received_ns) == (True, 0.5, 10)
    one.close(12)
    (released,) = space.events()
    assert (released.dead_man, released.received_ns) == (False, 12)
    (state,) = other.texts("state")
    assert state["hand"] == FREE


def test_people_know_who_has_the_handle_and_who_asks_for_it(space):
    people = [space.open(role) for role in (Role.OPERATOR, Role.COSMONAUT, Role.OPERATOR)]
    one, cosmonaut, other = people
    names = [page.texts("hello")[0]["name"] for page in people]
    assert names == ["operator", "cosmonaut", "operator 2"]
    other.ask("hand", action="take")
    cosmonaut.ask("hand", action="ask")
    shown = other.texts("state")[-1]["hand"]
    assert (shown["who"], shown["asks"]) == ("operator 2", "cosmonaut")
    one.ask("hand", action="ask")
    assert one.errors() == ["ask: cosmonaut has asked before"]
    # A name is free again when its page is gone.
    one.close(1)
    assert space.open(now_ns=2).texts("hello")[0]["name"] == "operator"


@pytest.mark.rule("4")
@pytest.mark.rule("10")
def test_a_viewer_watches_only(space):
    viewer = space.open(Role.VIEWER, unread=False)
    viewer.ask("hand", action="take")
    viewer.ask("command", **SELECT_HEAD)
    viewer.ask("joystick", event="halt")
    viewer.send(hand(1))
    assert space.events() == []
    assert viewer.errors() == [WATCH_ONLY] * 3
    viewer.send(struct.pack("<B7xd", 0x81, 2.5), 3000)
    assert viewer.sent() == [struct.pack("<B7xdq", 5, 2.5, 3)]

    # Viewers are bounded and keep nobody out who may act.
    viewer.close(0)
    for role, most in ((Role.VIEWER, MOST_VIEWERS), (Role.OPERATOR, MOST_ACTING)):
        for _ in range(most):
            assert not space.seat.is_full(role)
            space.open(role)
        assert space.seat.is_full(role)


def test_a_command_is_answered_when_the_joystick_has_carried_it_out(space):
    def publish(answered, refusal):
        sizes = dict.fromkeys(("force_limit_n", "half_width_m", "half_height_m"), 0.1)
        known = {"state": JoystickState.STANDBY, "reason": "", "dead_man": False, "device": "x"}
        status = JoystickStatus(**known, **sizes, answered=answered, refusal=refusal)
        space.seat.handle_status(status, 0)

    page = space.open()
    page.ask("joystick", event="calibrate")
    page.ask("joystick", event="start")
    assert space.events() == [(101, JoystickEvent.CALIBRATE)]
    assert page.texts("answer") == []
    publish(101, "not now")
    (answer,) = page.texts("answer")
    assert (answer["request"], answer["ok"], answer["error"]) == (7, False, "not now")
    assert space.events() == [(102, JoystickEvent.START)]
    space.seat.handle_time(NS_PER_S)
    assert page.errors() == ["the joystick does not answer"]
    publish(102, "")
    assert page.errors() == []


PING = struct.pack("<B7xd", 0x81, 1.0)
NO_ANSWER, LATER = "select head: no acknowledgement came", "a later request came"


@pytest.mark.parametrize(
    ("update", "error"),
    [
        ({"stage": "completed", "ok": True, "verified": True, "round_trip_ms": 12.5}, ""),
        ({"stage": "failed", "reason": "no verification came"}, NO_ANSWER),
        ({"stage": "failed", "reason": "its end was not verified"}, NO_ANSWER),
        ({"stage": "failed", "reason": LATER}, f"select head: {LATER}"),
        ({"stage": "failed", "reason": "too late", "verified": True}, "too late"),
        ({"stage": "refused", "reason": "unknown camera", "mistake": True}, "unknown camera"),
    ],
)
def test_the_operator_selects_the_camera_or_is_told_why_not(space, update, error):
    page = space.open()
    page.ask("command", **SELECT_HEAD)
    (command,) = space.events()
    assert (command.application, command.name, command.arguments) == ("camera", "select", ("head",))
    page.sent()
    space.seat.handle_news(
        CommandUpdate(command.client, command.id, "camera", done=True, **update), 0
    )
    found = [json.loads(text) for text in page.sent()]
    (answer,) = [text for text in found if text["kind"] == "answer"]
    assert (answer["ok"], answer["error"]) == (not error, error)
    if not error:
        assert answer["round_trip_ms"] == 12.5
        assert [text["camera"] for text in found if text["kind"] == "state"] == ["head"]


def test_an_argument_that_does_not_fit_is_answered_and_the_page_stays_open(space):
    page = space.open()
    page.ask("command", **SELECT_HEAD | {"arguments": [""]})
    assert page.errors() == ["select: argument 1 is empty: write a value into each field"]
    assert space.events() == []
    # What is typed goes to the end, which knows what fits.
    for typed in (1 << 40, -(1 << 40), 1e300, "x" * 64):
        page.ask("command", **SELECT_HEAD | {"arguments": [typed]})
        (command,) = space.events()
        assert command.arguments == (typed,)


def test_each_seat_does_its_own_and_one_of_two_machines_stops_no_session(ground, space):
    alone = Room(topology=replace(TOPOLOGY, segments=(Segment.SPACE,)))
    for room in (ground, space, alone):
        page = room.open()
        page.ask("session", action="stop")
        if room is not alone:
            page.ask("command", **SELECT_HEAD)
            page.ask("hand", action="take")
            page.ask("record", action="start")
    assert ground.events() == [Order.STOP, PageRequest(1, RecordingRequest(7, "start"))]
    assert [type(event) for event in space.events()] == [Order, SendCommand]
    assert alone.events() == []


@pytest.mark.rule("S6")
def test_a_seat_shows_what_the_robot_answered_and_releases_it_across_the_radio(space):
    alone = Room(topology=replace(TOPOLOGY, segments=(Segment.SPACE,)))
    by = "the operator at the page of space"
    for room in (space, alone):
        page = room.open()
        for action in ("stop", "release"):
            page.ask("stop", action=action)
        *asked, last = room.events()
        if room is alone:
            assert (last.application, last.name) == ("robot", "release_stop")
            asked, last = asked[:1], asked[1]
        assert [*asked, last] == [StopAsked(True, by), StopAsked(False, by)]
        # The release is answered when the robot has answered.
        assert len(page.texts("answer")) == (1 if room is alone else 2)
        ground = Room(Segment.GROUND)
        page, now_ns = ground.open(unread=False), 0
        for ordered, status, shown in (
            (by, {}, (True, by, f"emergency stop by {by}: the robot has not answered")),
            (by, {"stopped": True}, (True, by, f"emergency stop by {by}: the robot is off")),
            ("", {"stopped": True, "stopped_by": "a telecommand"}, (True, "a telecommand", TOLD)),
            ("", {}, (False, "", "the radio link is lost")),
        ):
            kept = {"boot_id": 1, "powered": True, "mode": "telepresence"}
            robot = RobotStatus(**kept, x_m=0.0, y_m=0.0, push_n=0.0, **status)
            ground.seat.handle_shown("robot", robot)
            ground.seat.handle_stop(bool(ordered), ordered, 0)
            now_ns += NS_PER_S
            ground.seat.handle_time(now_ns)
            state = page.texts("state")[-1]
            safety, reason = state["safety"], state["situation"]["reason"]
            assert (safety["stopped"], safety["by"], reason) == shown


def test_a_page_is_told_one_situation_of_joystick_robot_and_picture(space):
    page, status = space.open(unread=False), {"reason": "", "dead_man": False, "force_limit_n": 6.0}
    status |= {"device": "page", "half_width_m": 0.1, "half_height_m": 0.08, "robot_waits": True}
    space.seat.handle_signal(True, 0)
    hold = "press and hold the dead-man button"
    for state, more, why, says in (
        (3, {"drive": "off"}, "robot off", "Ask the ground"),
        (6, {"drive": "off", "request": "acknowledge"}, "joystick state", "Press “Acknowledge”"),
        (2, {"held": True, "test": "running", "reason": hold}, "functional test", "Press and hold"),
        (3, {"drive": "hand", "frozen": True}, "picture too old", "Wait for a fresh picture"),
        (3, {"drive": "hand", "held": True, "robot_waits": False}, "follows", ""),
    ):
        space.seat.handle_status(JoystickStatus(**status | {"state": state} | more), 0)
        space.seat.handle_time(NS_PER_S)
        shown = page.texts("state")[-1]
        assert shown["situation"]["why"] == why
        assert shown["situation"]["advice"].startswith(says)
        # The button of a test is held, too; and half a frozen picture is known.
        assert shown["joystick"]["dead_man"] is more.get("held", False)
        assert shown["safety"]["frozen"] is more.get("frozen", False)


@pytest.mark.parametrize("segment", list(Segment))
def test_only_the_trainer_gives_exercises_at_either_end(segment):
    room = Room(segment, topology_of(BUILT_IN["spacejustin"], pages=True, trainer=True))
    for role in Role:
        page = room.open(role)
        (hello,) = page.texts("hello")
        page.ask("exercise", exercise="camera-lost", seconds=2, camera="head")
        found = room.events()
        if role is Role.TRAINER:
            exercise = ExerciseRequest(7, "camera-lost", 2.0, "head")
            assert found == [PageRequest(page.number, exercise)]
            room.seat.handle_answered(found[0], "no camera head is here")
            offered = [(one["name"], one["camera"]) for one in hello["exercises"]]
            assert ("los", "") in offered and ("camera-lost", "static") in offered
        else:
            assert not found
        (error,) = page.errors()
        assert error
        # Nor may a trainer do what other people do.
        page.ask("stop", action="stop")
        assert (room.events() == []) is (role in (Role.TRAINER, Role.VIEWER))


def test_all_pages_of_a_seat_see_one_chat_and_a_plain_one_sees_nothing_else(space):
    page = space.open(Role.COSMONAUT, unread=False)
    plain = space.open(Role.VIEWER, plain=True)
    hello = json.loads(plain.sent()[0])
    assert hello["streams"] == [] and hello["applications"]
    page.ask("chat", text="hello")
    space.give_unit(0, key=True)
    space.seat.media.handle_haptics(0, HAPTICS)
    space.seat.handle_time(NS_PER_S)
    watched = plain.sent()
    (chat,) = [one for one in watched if '"chat"' in one]
    assert chat in page.sent()
    assert all(isinstance(one, str) for one in watched)
    assert chat in space.open(Role.VIEWER, NS_PER_S, plain=True).sent()


def test_the_heartbeat_comes_ten_times_a_second_and_at_each_change(space):
    page = space.open(unread=False)
    for instant_ms, due in ((0, 1), (99, 0), (100, 1), (199, 0), (200, 1)):
        space.seat.handle_time(instant_ms * NS_PER_MS)
        assert len(page.texts("state")) == due, instant_ms
    space.seat.handle_signal(True, 201 * NS_PER_MS)
    (state,) = page.texts("state")
    assert (state["signal"], state["link"]) == (True, "connected")
    space.seat.handle_signal(False, 202 * NS_PER_MS)
    assert page.texts("state")[0]["link"] == "lost"


def metrics(number, state="running", **values):
    events = [Event(number=number, at_us=1, what="link", text="x")]
    return SessionNews(at_us=number, state=state, figures=values, events=events)


def test_metrics_pass_unchanged_and_who_joins_gets_all_events(space):
    page = space.open(Role.VIEWER)
    assert page.texts("figures") == []
    for number in range(1, 251):
        space.seat.handle_session(metrics(number, **{"processes.selector.selected": "head"}), 0)
    newest = [each["events"][0]["number"] for each in page.texts("figures")]
    assert newest == list(range(243, 251))
    found = {text["kind"]: text for text in map(json.loads, space.open(Role.VIEWER).sent())}
    assert [each["number"] for each in found["figures"]["events"]] == list(range(51, 251))
    assert (found["state"]["camera"], found["figures"]["at_us"]) == ("head", 250)


def test_pages_see_who_holds_the_handle_at_the_other_end_and_that_a_stopped_session_is_lost(
    ground, space
):
    page = ground.open(unread=False)
    for number, holder in enumerate((None, 4), 1):
        told = {"hand.holder": holder, "processes.selector.selected": "head"}
        ground.seat.handle_session(metrics(number, **told), 0)
        # The camera is told by its own selector.
        assert ground.seat.camera != "head"
        ground.seat.handle_time(number * NS_PER_S)
        assert page.texts("state")[-1]["hand"] == FREE | {"holder": holder}
    page = space.open(Role.VIEWER)
    space.seat.handle_signal(True, 0)
    cases = (("running", "connected", 1), ("running", "refused", 0), ("stopped", "connected", 0))
    for second, (state, told, connected) in enumerate(cases):
        link = {"gateways.space.supervision.state": told}
        space.seat.handle_session(metrics(second + 1, state, **link), 0)
        space.seat.handle_time(second * NS_PER_S)
        assert page.texts("state")[-1]["link"] == ("connected" if connected else "lost")


@pytest.mark.rule("10")
@pytest.mark.parametrize(("most", "octets"), [(20, None), (20, PING), (1200, hand(1))])
def test_too_much_of_anything_closes_the_page(space, most, octets):
    def send(page):
        return page.send(octets) if octets else page.ask("hand", action="give")

    page = space.open()
    for _ in range(most):
        send(page)
    with pytest.raises(ProtocolError, match="too many"):
        send(page)
