"""Chat, telecommands and telemetry at a seat: the same for all its people, refused by role."""

import json

import pytest
from msgspec.structs import asdict

from kontur_av.clock import NS_PER_S
from pipelines.mission.tmtc_messages import (
    CommandUpdate,
    K2aciArrived,
    K2aciUpdate,
    Reported,
    SendCommand,
    SendK2aci,
)
from pipelines.seats.mission_desk import MissionDesk, level_of, radio_text
from pipelines.seats.texts import ChatRequest, CommandRequest
from pipelines.session.access import Role
from pipelines.session.mission_messages import ExperimentShown, TaskListed
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

DICTIONARY = built_in_dictionary()
PAGE = 3


@pytest.fixture
def desk():
    made = MissionDesk(Segment.GROUND, DICTIONARY, client="page.1")
    made.poll_texts()
    return made


def requests(desk, now_ns=0):
    found = []
    while (request := desk.poll_transmit(now_ns)) is not None:
        found.append(request)
    return found


def lines(desk, kind, rows):
    return json.loads(desk.poll_texts()[kind])[rows]


def say(desk, text, role=Role.SUPERVISOR):
    return desk.handle_chat(role, ChatRequest(request=1, text=text), 0)


def command(desk, name="select", role=Role.EXPERIMENTER, request=7, now_ns=0):
    asked = CommandRequest(request=request, application="tasks", name=name, arguments=(2,))
    return desk.handle_command(PAGE, role, asked, now_ns)


def test_a_line_is_pending_until_the_other_end_has_it(desk):
    assert say(desk, "  Go  on ") == ""
    (sent,) = requests(desk)
    fields = {"sender": "supervisor", "text": "Go on"}
    assert sent == SendK2aci("page.1.chat", sent.id, "Chat", fields)
    (line,) = lines(desk, "chat", "lines")
    assert (line["sender"], line["text"], line["state"]) == ("supervisor", "Go on", "waiting")
    desk.handle_news(K2aciUpdate("another", sent.id, "delivered"), 0)
    assert "chat" not in desk.poll_texts()
    desk.handle_news(K2aciUpdate("page.1.chat", sent.id, "waiting"), 0)
    assert requests(desk, 5 * NS_PER_S) == []
    desk.handle_news(K2aciUpdate("page.1.chat", sent.id, "delivered", "", 80.0), 0)
    (line,) = lines(desk, "chat", "lines")
    assert (line["state"], line["round_trip_ms"]) == ("delivered", 80.0)


def test_what_the_end_did_not_take_is_repeated_and_then_given_up(desk):
    say(desk, "hello")
    sent = [requests(desk, second * NS_PER_S) for second in range(7)]
    assert [len(one) for one in sent] == [1, 1, 1, 1, 1, 0, 0]
    assert len({one[0].id for one in sent[:5]}) == 1
    (line,) = lines(desk, "chat", "lines")
    assert line["state"] == "refused" and "do not answer" in line["reason"]


def test_lines_of_the_others_come_in_order_and_other_messages_are_no_chat(desk):
    for number, text in enumerate(("one", "two")):
        fields = {"sender": "cosmonaut", "text": text}
        desk.handle_news(K2aciArrived(1, number, "Chat", fields), 0)
    desk.handle_news(K2aciArrived(1, 2, "StartTask", {"task": "aiming", "run": 1}), 0)
    assert [(line["text"], line["state"]) for line in lines(desk, "chat", "lines")] == [
        ("one", "received"),
        ("two", "received"),
    ]


def test_a_line_must_fit_and_a_viewer_writes_none(desk):
    assert "200" in say(desk, "ä" * 101)
    assert say(desk, "a\x07b") == say(desk, "  ") == "write one line of text"
    assert say(desk, "hello", Role.VIEWER) == "a viewer may watch only"
    assert requests(desk) == []


def test_a_telecommand_is_answered_when_it_is_verified(desk):
    assert command(desk) is None
    (sent,) = requests(desk)
    assert sent == SendCommand("page.1", sent.id, "tasks", "call", "select", (2,))
    desk.handle_news(CommandUpdate("page.1", sent.id, "tasks", "taken"), 0)
    desk.handle_news(CommandUpdate("page.1", sent.id, "tasks", "accepted", verified=True), 0)
    assert desk.next_event() is None
    (line,) = lines(desk, "commands", "commands")
    assert (line["who"], line["words"], line["stage"]) == (
        "experimenter",
        "tasks select 2",
        "accepted",
    )
    failed = CommandUpdate(
        "page.1", sent.id, "tasks", "failed", done=True, verified=True, reason="it is running"
    )
    desk.handle_news(failed, 0)
    assert desk.next_event() == (PAGE, 7, "it is running", 0.0, "")
    assert desk.next_event() is None


def test_the_experimenter_sets_the_robots_mode(desk):
    asked = CommandRequest(request=7, application="robot", name="set_mode", arguments=("torque",))
    assert desk.handle_command(PAGE, Role.EXPERIMENTER, asked, 0) is None
    (sent,) = requests(desk)
    assert sent == SendCommand("page.1", sent.id, "robot", "call", "set_mode", ("torque",))
    refused = desk.handle_command(PAGE, Role.SUPERVISOR, asked, 0)
    assert refused == "robot set mode: the experimenter may, not the supervisor"


def test_the_end_tells_a_line_and_a_telecommand_apart(desk):
    say(desk, "hello")
    command(desk)
    one, other = requests(desk)
    assert (one.client, one.id) != (other.client, other.id)


@pytest.mark.parametrize("role", [Role.VIEWER, Role.SUPERVISOR, Role.SYSTEMS, Role.COSMONAUT])
def test_a_telecommand_of_another_role_is_never_sent(desk, role):
    refused = command(desk, role=role)
    assert refused and "may" in refused
    assert requests(desk) == [] and desk.next_event() is None


def test_telecommands_that_nobody_acknowledges_are_told(desk):
    desk.handle_signal(True)
    for number in range(2):
        command(desk, request=number)
        (sent,) = requests(desk)
        desk.handle_news(
            CommandUpdate("page.1", sent.id, "tasks", "failed", done=True, reason="no report"), 0
        )
    assert "2 telecommands were not acknowledged" in json.loads(desk.poll_texts()["radio"])["words"]
    command(desk)
    (sent,) = requests(desk)
    done = CommandUpdate("page.1", sent.id, "tasks", "completed", done=True, ok=True, verified=True)
    desk.handle_news(done, 0)
    assert json.loads(desk.poll_texts()["radio"])["level"] == "good"


def test_each_dead_direction_is_said_in_words():
    ground = Segment.GROUND
    down = radio_text(ground, hears=False, heard=True, unverified=3)
    assert down.level == "bad" and "Nothing arrives from space" in down.words
    assert "last 3" in down.words
    up = radio_text(ground, hears=True, heard=False, unverified=0)
    assert up.level == "bad" and "Space does not hear us" in up.words
    assert radio_text(ground, hears=True, heard=None, unverified=0).level == "good"


def test_the_other_gateway_says_at_once_that_it_does_not_hear_us(desk):
    desk.handle_signal(True)
    desk.handle_news(Reported("housekeeping", "space_gateway", 0, "link", "", {"signal": True}), 0)
    assert json.loads(desk.poll_texts()["radio"])["level"] == "good"
    desk.handle_news(Reported("event", "space_gateway", 0, "signal_lost", "low"), 0)
    assert "does not hear us" in json.loads(desk.poll_texts()["radio"])["words"]
    desk.handle_news(Reported("housekeeping", "ground_gateway", 0, "link", "", {"signal": True}), 0)
    assert json.loads(desk.poll_texts()["radio"])["level"] == "bad"
    desk.handle_news(Reported("event", "space_gateway", 0, "signal_acquired", "info"), 0)
    assert json.loads(desk.poll_texts()["radio"])["level"] == "good"


def test_values_have_the_colour_of_their_limit(desk):
    joystick = DICTIONARY.application("joystick")
    (temperature,) = [one for one in joystick.parameters if one.name == "temperature"]
    levels = [level_of(joystick, temperature, value) for value in (20.0, 70.0, 90.0)]
    assert levels == ["good", "warn", "bad"]
    values = {"temperature": 90.0, "state": "halted"}
    desk.handle_news(Reported("housekeeping", "joystick", 0, "state", "", values), 5_000)
    assert lines(desk, "values", "values") == [
        {
            "application": "joystick",
            "name": "temperature",
            "value": 90.0,
            "level": "bad",
            "at_us": 5,
        },
        {
            "application": "joystick",
            "name": "state",
            "value": "halted",
            "level": "none",
            "at_us": 5,
        },
    ]


def test_who_joins_sees_what_the_others_see(desk):
    say(desk, "hello")
    desk.handle_news(
        Reported("event", "joystick", 0, "off_nominal", "medium", {"state": "halted"}), 0
    )
    fresh = desk.poll_texts()
    assert {"chat", "events"} <= set(fresh)
    assert desk.poll_texts() == {}
    assert {kind: desk.texts[kind] for kind in fresh} == fresh
    assert set(desk.texts) == {"chat", "commands", "events", "radio", "values"}


def test_what_the_mission_shows_comes_by_name_and_only_when_it_changes(desk):
    listed = TaskListed("aiming", "Aim.")
    shown = ExperimentShown(phase="idle", task="", run=0, elemop="", panel="", tasks=(listed,))
    desk.handle_shown("experiment", shown)
    told = json.loads(desk.poll_texts()["experiment"])
    assert (told["kind"], told["phase"]) == ("experiment", "idle")
    assert told["tasks"] == [{"name": "aiming", "text": "Aim.", "lacks": ""}]
    desk.handle_shown("experiment", ExperimentShown(**asdict(shown)))
    assert desk.poll_texts() == {}
