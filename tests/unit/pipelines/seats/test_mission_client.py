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
from pipelines.seats.mission_client import MissionClient, level_of, radio_text
from pipelines.seats.texts import ChatRequest, CommandRequest
from pipelines.session.access import Role
from pipelines.session.mission_messages import ExperimentShown, TaskListed
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

DICTIONARY = built_in_dictionary()
PAGE = 3


class Desk:
    """The desk of ground control, with what it asks for and what its pages are told."""

    def __init__(self):
        self.core = MissionClient(Segment.GROUND, DICTIONARY, client="page.1")
        self.core.poll_texts()

    def requests(self, now_ns=0):
        return list(iter(lambda: self.core.poll_transmit(now_ns), None))

    def told(self, kind):
        return json.loads(self.core.poll_texts()[kind])

    def line(self, kind, rows):
        (line,) = self.told(kind)[rows]
        return line

    def say(self, text, role=Role.SUPERVISOR):
        return self.core.handle_chat(role, ChatRequest(request=1, text=text), 0)

    def command(self, role=Role.EXPERIMENTER, application="tasks", name="select", arguments=(2,)):
        asked = CommandRequest(
            request=7, application=application, name=name, arguments=tuple(arguments)
        )
        return self.core.handle_command(PAGE, role, asked, 0)

    def update(self, sent, stage, **more):
        self.core.handle_news(CommandUpdate("page.1", sent.id, "tasks", stage, **more), 0)

    def report(self, kind, source, name, level="", values=None):
        self.core.handle_news(Reported(kind, source, 5_000, name, level, values or {}), 5_000)


@pytest.fixture
def service():
    return Desk()


def test_a_line_is_pending_until_the_other_end_has_it(service):
    assert service.say("  Go  on ") == ""
    (sent,) = service.requests()
    fields = {"sender": "supervisor", "text": "Go on"}
    assert sent == SendK2aci("page.1.chat", sent.id, "Chat", fields)
    line = service.line("chat", "lines")
    assert (line["sender"], line["text"], line["state"]) == ("supervisor", "Go on", "waiting")
    service.core.handle_news(K2aciUpdate("another", sent.id, "delivered"), 0)
    assert "chat" not in service.core.poll_texts()
    service.core.handle_news(K2aciUpdate("page.1.chat", sent.id, "waiting"), 0)
    assert service.requests(5 * NS_PER_S) == []
    service.core.handle_news(K2aciUpdate("page.1.chat", sent.id, "delivered", "", 80.0), 0)
    line = service.line("chat", "lines")
    assert (line["state"], line["round_trip_ms"]) == ("delivered", 80.0)


def test_what_the_end_did_not_take_is_repeated_and_then_given_up(service):
    service.say("hello")
    sent = [service.requests(second * NS_PER_S) for second in range(7)]
    assert [len(one) for one in sent] == [1, 1, 1, 1, 1, 0, 0]
    assert len({one[0].id for one in sent[:5]}) == 1
    line = service.line("chat", "lines")
    assert line["state"] == "refused" and "do not answer" in line["reason"]


def test_lines_of_others_come_in_order_a_line_must_fit_and_a_viewer_writes_none(service):
    for number, text in enumerate(("one", "two")):
        fields = {"sender": "cosmonaut", "text": text}
        service.core.handle_news(K2aciArrived(1, number, "Chat", fields), 0)
    service.core.handle_news(K2aciArrived(1, 2, "StartTask", {"task": "aiming", "run": 1}), 0)
    lines = [(line["text"], line["state"]) for line in service.told("chat")["lines"]]
    assert lines == [("one", "received"), ("two", "received")]
    assert "200" in service.say("ä" * 101)
    assert service.say("a\x07b") == service.say("  ") == "write one line of text"
    assert service.say("hello", Role.VIEWER) == "a viewer may watch only"
    assert service.requests() == []


def test_a_telecommand_is_answered_when_it_is_verified(service):
    assert service.command() is None
    (sent,) = service.requests()
    assert sent == SendCommand("page.1", sent.id, "tasks", "call", "select", (2,))
    service.update(sent, "taken")
    service.update(sent, "accepted", verified=True)
    assert service.core.next_event() is None
    line = service.line("commands", "commands")
    told = {"who": "experimenter", "words": "tasks select 2", "stage": "accepted"}
    assert line | told == line
    service.update(sent, "failed", done=True, verified=True, reason="it is running")
    assert service.core.next_event() == (PAGE, 7, "it is running", 0.0, "")
    assert service.core.next_event() is None
    # The end tells a line and a telecommand apart.
    service.say("hello")
    service.command()
    one, other = service.requests()
    assert (one.client, one.id) != (other.client, other.id)


@pytest.mark.parametrize("role", Role)
def test_a_telecommand_of_another_role_is_never_sent(service, role):
    mode = {"application": "robot", "name": "set_mode", "arguments": ("torque",)}
    refused = service.command(role, **mode)
    sent = service.requests()
    if role in (Role.EXPERIMENTER, Role.OPERATOR):
        assert refused is None
        assert sent == [SendCommand("page.1", sent[0].id, "robot", "call", "set_mode", ("torque",))]
        return
    assert "may" in refused and "may" in service.command(role)
    assert sent == [] and service.core.next_event() is None
    if role is Role.SUPERVISOR:
        assert refused == "robot set mode: the experimenter may, not the supervisor"


def test_telecommands_that_nobody_acknowledges_are_told(service):
    service.core.handle_signal(True)
    for _ in range(2):
        service.command()
        (sent,) = service.requests()
        service.update(sent, "failed", done=True, reason="no report")
    assert "2 telecommands were not acknowledged" in service.told("radio")["words"]
    service.command()
    (sent,) = service.requests()
    service.update(sent, "completed", done=True, ok=True, verified=True)
    assert service.told("radio")["level"] == "good"


def test_each_dead_direction_is_said_in_words_and_at_once(service):
    ground = Segment.GROUND
    down = radio_text(ground, hears=False, heard=True, unverified=3)
    assert down.level == "bad"
    assert "Nothing arrives from space: telecommands go out unacknowledged." in down.words
    assert "last 3" in down.words
    up = radio_text(ground, hears=True, heard=False, unverified=0)
    assert up.level == "bad" and "Space does not hear us" in up.words
    well = radio_text(ground, hears=True, heard=None, unverified=0)
    assert (well.level, well.words) == ("good", "Both directions carry.")
    # A red LOST has no green beside it.
    lost = radio_text(ground, hears=True, heard=True, unverified=0, connected=False)
    assert (lost.level, lost.words) == ("bad", "The link is not connected.")
    fault = "space: this machine does not send the frames: Network is unreachable"
    none = radio_text(ground, hears=True, heard=True, unverified=0, obstacle=fault)
    assert (none.level, none.words) == ("bad", f"No link: {fault}.")
    # The other gateway says that it does not hear us.
    service.core.handle_signal(True)
    for kind, source, name, values, level in (
        ("housekeeping", "space_gateway", "link", {"signal": True}, "good"),
        ("event", "space_gateway", "signal_lost", {}, "bad"),
        ("housekeeping", "ground_gateway", "link", {"signal": True}, "bad"),
        ("event", "space_gateway", "signal_acquired", {}, "good"),
    ):
        service.report(kind, source, name, "low", values)
        told = service.told("radio")
        assert told["level"] == level
        assert ("does not hear us" in told["words"]) is (level == "bad")


def test_values_have_the_colour_of_their_limit_and_what_is_shown_comes_when_it_changes(service):
    joystick = DICTIONARY.application("joystick")
    (temperature,) = [one for one in joystick.parameters if one.name == "temperature"]
    levels = [level_of(joystick, temperature, value) for value in (20.0, 70.0, 90.0)]
    assert levels == ["good", "warn", "bad"]
    values = {"temperature": 90.0, "state": "halted"}
    service.report("housekeeping", "joystick", "state", values=values)
    assert service.told("values")["values"] == [
        {"application": "joystick", "name": name, "value": values[name], "level": level, "at_us": 5}
        for name, level in (("temperature", "bad"), ("state", "none"))
    ]
    listed = TaskListed("aiming", "Aim.")
    shown = ExperimentShown(phase="idle", task="", run=0, elemop="", panel="", tasks=(listed,))
    service.core.handle_shown("experiment", shown)
    told = service.told("experiment")
    assert (told["kind"], told["phase"]) == ("experiment", "idle")
    assert told["tasks"] == [{"name": "aiming", "text": "Aim.", "lacks": ""}]
    service.core.handle_shown("experiment", ExperimentShown(**asdict(shown)))
    assert service.core.poll_texts() == {}
    assert set(service.core.texts) == {
        "chat",
        "commands",
        "events",
        "experiment",
        "radio",
        "values",
    }
