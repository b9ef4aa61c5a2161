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
from pipelines.seats.seat import PageRequest, Seat
from pipelines.seats.texts import ExerciseRequest, FetchRequest, RecordingRequest
from pipelines.session.access import Role
from pipelines.session.session_switch import Order
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology import Segment
from pipelines.table import topology_of
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

DICTIONARY = built_in_dictionary()
SELECT_HEAD = {"application": "camera", "name": "select", "arguments": ["head"]}
NO_ANSWER = "select head: no acknowledgement came"
TOPOLOGY = topology_of(BUILT_IN["spacejustin"], pages=True)
KEY, DELTA = b"\0\0\0\1\x67s\0\0\0\1\x68p\0\0\0\1\x65i", b"\0\0\0\1\x41d"


def seat_of(segment=Segment.SPACE, topology=TOPOLOGY):
    return Seat(seat_plan(topology, segment, "spacejustin-1", DICTIONARY), first_command=100)


def sent(seat, page):
    found = []
    while (message := seat.poll_transmit(page)) is not None:
        found.append(message)
    return found


def texts(seat, page, kind):
    found = [json.loads(text) for text in sent(seat, page) if isinstance(text, str)]
    return [text for text in found if text["kind"] == kind]


def events(seat):
    found = []
    while (event := seat.next_event()) is not None:
        found.append(event)
    return found


def ask(seat, page, do, now_ns=0, **fields):
    seat.handle_text(page, json.dumps({"request": 7, "do": do} | fields), now_ns)


def hand(sequence, *, dead_man=True, x=0.0):
    return struct.pack("<BBHIffd", 0x82, dead_man, 0, sequence, x, 0.0, 1.0)


def give_unit(seat, number, *, key=False, damaged=False, stream=0):
    unit = CodedUnit(data=KEY if key else DELTA, key=key, damaged=damaged, width=64, height=48)
    stamp = CaptureStamp(number * NS_PER_MS, number, "uplink_video", rtp_timestamp=number)
    seat.media.handle_unit(stream, unit, stamp, number)


def units(messages):
    """(flags, number) of each unit."""
    return [(one[2], struct.unpack_from("<I", one, 4)[0]) for one in messages if one[0] == 1]


def test_a_page_is_told_first_where_it_is():
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 5 * NS_PER_MS)
    first, *_ = sent(seat, page)
    hello = json.loads(first)
    assert (hello["kind"], hello["seat"], hello["role"]) == ("hello", "space", "operator")
    assert (hello["page"], hello["now_us"]) == (page, 5000)
    streams = [(each["index"], each["name"], each["via"]) for each in hello["streams"]]
    assert streams == [(0, "uplink_video", "coded"), (1, "uplink_voice", "sound")]
    assert [each["name"] for each in hello["inputs"]] == ["iss_camera", "iss_mic"]
    assert hello["cameras"][0] == {"name": "stereo", "inputs": ["left", "right"]}


def test_ground_control_sees_what_comes_what_it_sends_and_all_cameras():
    seat = seat_of(Segment.GROUND)
    hello = json.loads(sent(seat, seat.handle_opened(Role.OPERATOR, 0))[0])
    streams = {(each["name"], each["via"]) for each in hello["streams"]}
    assert streams == {
        ("uplink_video", "sent"),
        ("downlink_video", "coded"),
        ("downlink_voice", "sound"),
    }
    assert [each["input"] for each in hello["previews"]] == ["left", "right", "static", "head"]
    assert [each["name"] for each in hello["inputs"]] == ["ground_mic"]


def test_who_joins_is_sent_the_units_since_the_key_and_draws_only_the_newest():
    seat = seat_of()
    for number in range(4):
        give_unit(seat, number, key=number == 0)
    page = seat.handle_opened(Role.VIEWER, 0)
    assert units(sent(seat, page)) == [(5, 0), (4, 1), (4, 2), (0, 3)]
    give_unit(seat, 4, damaged=True)
    assert units(sent(seat, page)) == [(2, 4)]
    give_unit(seat, 5, key=True)
    assert units(sent(seat, page)) == [(1, 5)]


def test_a_page_that_stalls_is_sent_a_replay_when_it_takes_again():
    seat = seat_of()
    give_unit(seat, 0, key=True)
    slow, quick = (seat.handle_opened(Role.VIEWER, 0) for _ in range(2))
    sent(seat, slow)
    sent(seat, quick)
    for number in range(1, 61):
        give_unit(seat, number)
        if number == 1:
            # It takes a message, and then no other.
            assert units([seat.poll_transmit(slow)]) == [(0, 1)]
        assert units(sent(seat, quick)) == [(0, number)]
    replay = units(sent(seat, slow))
    assert replay == [(5, 0), *((4, number) for number in range(1, 60)), (0, 60)]
    assert seat.left_out == 59
    give_unit(seat, 61)
    assert units(sent(seat, slow)) == [(0, 61)]


def test_without_a_beginning_a_decoded_picture_is_wanted_only_while_a_page_waits():
    seat = seat_of()
    give_unit(seat, 0, key=True)
    give_unit(seat, 5)
    assert seat.media.wanted_pictures() == []
    page = seat.handle_opened(Role.VIEWER, 0)
    assert units(sent(seat, page)) == []
    assert seat.media.wanted_pictures() == [0]
    assert not seat.media.handle_decoded(0, KEY, 4)
    give_unit(seat, 6)
    assert seat.media.handle_decoded(0, KEY, 5)
    assert seat.media.wanted_pictures() == []
    assert units(sent(seat, page)) == [(5, 5), (0, 6)]


def test_what_the_selected_camera_films_is_wanted_only_while_a_page_waits_for_it():
    seat = seat_of(Segment.GROUND)
    (stream,) = [each.index for each in seat.plan.streams if each.filmed_topics]
    give_unit(seat, 0, key=True, stream=stream)
    give_unit(seat, 5, stream=stream)
    seat.handle_camera("static", 0)
    assert seat.media.wanted_filmed(seat.camera) == {}
    page = seat.handle_opened(Role.VIEWER, 0)
    assert units(sent(seat, page)) == []
    assert seat.media.wanted_filmed(seat.camera) == {stream: TOPOLOGY.camera("static").topic}
    assert not seat.media.handle_filmed(stream, KEY, 4)
    assert seat.media.handle_filmed(stream, KEY, 5)
    assert seat.media.wanted_filmed(seat.camera) == {}
    give_unit(seat, 6, stream=stream)
    assert units(sent(seat, page))[-1] == (0, 6)


def test_every_page_gets_sound_haptics_and_previews():
    seat = seat_of(Segment.GROUND)
    pages = [seat.handle_opened(Role.VIEWER, 0) for _ in range(2)]
    for page in pages:
        sent(seat, page)
    seat.media.handle_sound(2, b"\1\0" * 960, CaptureStamp(5, 1, "x", Quality.CONCEALED))
    seat.media.handle_haptics(1, np.zeros(BLOCK_ROWS, ROW).tobytes())
    seat.media.handle_preview(3, empty_picture(160, 120), CaptureStamp(5, 1, "head"))
    for page in pages:
        assert [message[:3] for message in sent(seat, page)] == [
            *(b"\2\2\1", b"\3\1\x14", b"\4\3\xa0")
        ]


def test_the_hand_of_the_holder_alone_moves_and_lets_go_when_its_page_is_gone():
    seat = seat_of()
    one, other = (seat.handle_opened(Role.OPERATOR, 0) for _ in range(2))
    seat.handle_message(one, hand(1), 0)
    assert events(seat) == []
    ask(seat, one, "hand", action="take")
    seat.handle_message(one, hand(2, x=0.5), 10)
    seat.handle_message(other, hand(3, x=-0.5), 11)
    (moved,) = events(seat)
    assert (moved.dead_man, moved.x, moved.received_ns) == (True, 0.5, 10)
    seat.handle_closed(one, 12)
    (released,) = events(seat)
    assert (released.dead_man, released.received_ns) == (False, 12)
    (state,) = texts(seat, other, "state")
    free = {"holder": None, "you": False, "wanted_by": None, "who": "", "asks": ""}
    assert state["hand"] == free


def test_people_know_who_has_the_handle_and_who_asks_for_it():
    seat = seat_of()
    one, cosmonaut, other = map(
        seat.handle_opened, (Role.OPERATOR, Role.COSMONAUT, Role.OPERATOR), (0, 0, 0)
    )
    names = [texts(seat, page, "hello")[0]["name"] for page in (one, cosmonaut, other)]
    assert names == ["operator", "cosmonaut", "operator 2"]
    ask(seat, other, "hand", action="take")
    ask(seat, cosmonaut, "hand", action="ask")
    hand = texts(seat, other, "state")[-1]["hand"]
    assert (hand["who"], hand["asks"]) == ("operator 2", "cosmonaut")
    ask(seat, one, "hand", action="ask")
    assert texts(seat, one, "answer")[0]["error"] == "ask: cosmonaut has asked before"
    # A name is free again when its page is gone.
    seat.handle_closed(one, 1)
    again = seat.handle_opened(Role.OPERATOR, 2)
    assert texts(seat, again, "hello")[0]["name"] == "operator"


def test_a_viewer_watches_only():
    seat = seat_of()
    viewer = seat.handle_opened(Role.VIEWER, 0)
    sent(seat, viewer)
    ask(seat, viewer, "hand", action="take")
    ask(seat, viewer, "command", **SELECT_HEAD)
    ask(seat, viewer, "joystick", event="halt")
    seat.handle_message(viewer, hand(1), 0)
    assert events(seat) == []
    answers = texts(seat, viewer, "answer")
    assert {(each["ok"], each["error"]) for each in answers} == {(False, "a viewer may watch only")}
    seat.handle_message(viewer, struct.pack("<B7xd", 0x81, 2.5), 3000)
    assert sent(seat, viewer) == [struct.pack("<B7xdq", 5, 2.5, 3)]


def test_a_command_is_answered_when_the_joystick_has_carried_it_out():
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 0)
    ask(seat, page, "joystick", event="calibrate")
    ask(seat, page, "joystick", event="start")
    (first,) = events(seat)
    assert first == (101, JoystickEvent.CALIBRATE)
    assert texts(seat, page, "answer") == []

    def tell(answered, refusal):
        status = JoystickStatus(
            state=JoystickState.STANDBY,
            reason="",
            dead_man=False,
            force_limit_n=1.0,
            device="x",
            half_width_m=0.1,
            half_height_m=0.1,
            answered=answered,
            refusal=refusal,
        )
        seat.handle_status(status, 0)

    tell(101, "not now")
    (answer,) = texts(seat, page, "answer")
    assert (answer["request"], answer["ok"], answer["error"]) == (7, False, "not now")
    (second,) = events(seat)
    assert second == (102, JoystickEvent.START)
    seat.handle_time(NS_PER_S)
    (answer,) = texts(seat, page, "answer")
    assert answer["error"] == "the joystick does not answer"
    tell(102, "")
    assert texts(seat, page, "answer") == []


def test_the_operator_selects_the_camera():
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 0)
    ask(seat, page, "command", **SELECT_HEAD)
    (command,) = events(seat)
    assert (command.application, command.name, command.arguments) == ("camera", "select", ("head",))
    sent(seat, page)
    end = {"done": True, "ok": True, "verified": True, "round_trip_ms": 12.5}
    seat.handle_news(CommandUpdate(command.client, command.id, "camera", "completed", **end), 0)
    found = [json.loads(text) for text in sent(seat, page)]
    assert found[0]["round_trip_ms"] == 12.5
    assert found[1]["camera"] == "head"


def test_an_argument_that_does_not_fit_is_answered_and_the_page_stays_open():
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 0)
    ask(seat, page, "command", application="camera", name="select", arguments=[""])
    (answer,) = texts(seat, page, "answer")
    assert (answer["ok"], answer["error"]) == (
        False,
        "select: argument 1 is empty: write a value into each field",
    )
    assert events(seat) == []
    # What is typed goes to the end, which knows what fits.
    for typed in (1 << 40, -(1 << 40), 1e300, "x" * 64):
        ask(seat, page, "command", application="camera", name="select", arguments=[typed])
        (command,) = events(seat)
        assert command.arguments == (typed,)


@pytest.mark.parametrize(
    ("update", "error"),
    [
        ({"stage": "failed", "reason": "no verification came"}, NO_ANSWER),
        ({"stage": "failed", "reason": "its end was not verified"}, NO_ANSWER),
        (
            {"stage": "failed", "reason": "a later request came"},
            "select head: a later request came",
        ),
        ({"stage": "failed", "reason": "too late", "verified": True}, "too late"),
        (
            {"stage": "refused", "reason": "unknown camera head", "mistake": True},
            "unknown camera head",
        ),
    ],
)
def test_a_camera_that_is_not_selected(update, error):
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 0)
    ask(seat, page, "command", **SELECT_HEAD)
    (command,) = events(seat)
    sent(seat, page)
    seat.handle_news(CommandUpdate(command.client, command.id, "camera", done=True, **update), 0)
    (answer,) = texts(seat, page, "answer")
    assert not answer["ok"]
    assert answer["error"] == error


def test_each_seat_does_its_own():
    ground, space = seat_of(Segment.GROUND), seat_of()
    for seat in (ground, space):
        page = seat.handle_opened(Role.OPERATOR, 0)
        ask(seat, page, "session", action="stop")
        ask(seat, page, "command", **SELECT_HEAD)
        ask(seat, page, "hand", action="take")
        ask(seat, page, "record", action="start")
    assert events(ground) == [Order.STOP, PageRequest(1, RecordingRequest(7, "start"))]
    assert [type(event) for event in events(space)] == [Order, SendCommand]


def test_in_space_a_session_at_two_machines_is_not_stopped():
    seat = seat_of(topology=replace(TOPOLOGY, segments=(Segment.SPACE,)))
    page = seat.handle_opened(Role.OPERATOR, 0)
    ask(seat, page, "session", action="stop")
    assert events(seat) == []


@pytest.mark.parametrize("segment", list(Segment))
def test_only_the_trainer_gives_exercises_at_either_end(segment):
    seat = seat_of(segment, topology_of(BUILT_IN["spacejustin"], pages=True, trainer=True))
    for role in Role:
        page = seat.handle_opened(role, 0)
        if role is Role.TRAINER:
            (hello,) = texts(seat, page, "hello")
        ask(seat, page, "exercise", exercise="camera-lost", seconds=2, camera="head")
        found = events(seat)
        if role is Role.TRAINER:
            assert found == [PageRequest(page, ExerciseRequest(7, "camera-lost", 2.0, "head"))]
            seat.handle_answered(found[0], "no camera head is here")
        answers = [text["error"] for text in texts(seat, page, "answer")]
        assert found if role is Role.TRAINER else not found
        assert len(answers) == 1 and answers[0] != ""
        # Nor may a trainer do what other people do.
        ask(seat, page, "stop", action="stop")
        assert (events(seat) == []) is (role in (Role.TRAINER, Role.VIEWER))
    offered = [(one["name"], one["camera"]) for one in hello["exercises"]]
    assert ("los", "") in offered and ("camera-lost", "static") in offered


def test_a_role_does_what_is_its_own_and_is_told_who_may_the_rest():
    seat = seat_of(Segment.GROUND)
    page = seat.handle_opened(Role.SYSTEMS, 0)
    ask(seat, page, "session", action="stop")
    ask(seat, page, "command", application="tasks", name="abort")
    answers = [text["error"] for text in texts(seat, page, "answer")]
    assert answers == [
        "session: the cosmonaut or the supervisor may, not the systems operator",
        "tasks abort: the experimenter or the supervisor may, not the systems operator",
    ]
    ask(seat, page, "record", action="start")
    ask(seat, page, "fetch", inbox="joystick")
    ask(seat, page, "command", application="joystick", verb="ping")
    recording, fetched, asked = events(seat)
    assert recording == PageRequest(page, RecordingRequest(7, "start"))
    assert fetched == PageRequest(page, FetchRequest(7, "joystick"))
    assert (asked.application, asked.verb) == ("joystick", "ping")


def test_all_pages_of_a_seat_see_one_chat_and_a_plain_one_sees_nothing_else():
    seat = seat_of()
    page, plain = (
        seat.handle_opened(Role.COSMONAUT, 0),
        seat.handle_opened(Role.VIEWER, 0, plain=True),
    )
    hello = json.loads(sent(seat, plain)[0])
    assert hello["streams"] == [] and hello["applications"]
    sent(seat, page)
    ask(seat, page, "chat", text="hello")
    give_unit(seat, 0, key=True)
    seat.media.handle_haptics(0, np.zeros(BLOCK_ROWS, ROW).tobytes())
    seat.handle_time(NS_PER_S)
    seen, watched = sent(seat, page), sent(seat, plain)
    chats = [one for one in watched if '"chat"' in one]
    assert len(chats) == 1 and chats[0] in seen
    assert all(isinstance(one, str) for one in watched)
    late = seat.handle_opened(Role.VIEWER, NS_PER_S, plain=True)
    assert chats[0] in sent(seat, late)


def test_the_heartbeat_comes_ten_times_a_second_and_at_each_change():
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 0)
    sent(seat, page)
    for instant_ms, due in ((0, 1), (99, 0), (100, 1), (199, 0), (200, 1)):
        seat.handle_time(instant_ms * NS_PER_MS)
        assert len(texts(seat, page, "state")) == due, instant_ms
    seat.handle_signal(True, 201 * NS_PER_MS)
    (state,) = texts(seat, page, "state")
    assert (state["signal"], state["link"]) == (True, "connected")
    seat.handle_signal(False, 202 * NS_PER_MS)
    assert texts(seat, page, "state")[0]["link"] == "lost"


def figures(number, state="running", **values):
    events = [{"number": number, "at_us": 1, "what": "link", "text": "x"}]
    told = {"kind": "figures", "state": state, "figures": values, "events": events, "more": 1}
    return json.dumps(told).encode()


def test_figures_pass_unchanged_and_who_joins_gets_all_events():
    seat = seat_of()
    page = seat.handle_opened(Role.VIEWER, 0)
    assert texts(seat, page, "figures") == []
    for number in range(1, 251):
        seat.handle_figures(figures(number, **{"processes.selector.selected": "head"}), 0)
    assert [each["events"][0]["number"] for each in texts(seat, page, "figures")] == [
        *range(243, 251)
    ]
    late = seat.handle_opened(Role.VIEWER, 0)
    found = {text["kind"]: text for text in map(json.loads, sent(seat, late))}
    assert [each["number"] for each in found["figures"]["events"]] == [*range(51, 251)]
    assert (found["state"]["camera"], found["figures"]["more"]) == ("head", 1)
    with pytest.raises(ProtocolError):
        seat.handle_figures(b"{}", 0)


def test_ground_control_sees_who_holds_the_handle_in_space():
    seat = seat_of(Segment.GROUND)
    page = seat.handle_opened(Role.OPERATOR, 0)
    sent(seat, page)
    for number, holder in enumerate((None, 4), 1):
        seat.handle_figures(figures(number, **{"hand.holder": holder}), 0)
        seat.handle_time(number * NS_PER_S)
        assert texts(seat, page, "state")[-1]["hand"] == {
            "holder": holder,
            "you": False,
            "wanted_by": None,
            "who": "",
            "asks": "",
        }


def test_a_stopped_session_and_a_link_that_is_refused_are_lost():
    seat = seat_of()
    page = seat.handle_opened(Role.VIEWER, 0)
    seat.handle_signal(True, 0)
    link = "gateways.space.supervision.state"
    for second, (told, expected) in enumerate(
        (
            (figures(1, **{link: "connected"}), "connected"),
            (figures(2, **{link: "refused"}), "lost"),
            (figures(3, "stopped", **{link: "connected"}), "lost"),
        )
    ):
        seat.handle_figures(told, 0)
        seat.handle_time(second * NS_PER_S)
        assert texts(seat, page, "state")[-1]["link"] == expected


def test_too_much_of_anything_closes_the_page():
    seat = seat_of()
    page = seat.handle_opened(Role.OPERATOR, 0)
    cases = (
        (20, lambda: ask(seat, page, "hand", action="give")),
        (20, lambda: seat.handle_message(page, struct.pack("<B7xd", 0x81, 1.0), 0)),
        (1200, lambda: seat.handle_message(page, hand(1), 0)),
    )
    for most, send in cases:
        for _ in range(most):
            send()
        with pytest.raises(ProtocolError, match="too many"):
            send()
