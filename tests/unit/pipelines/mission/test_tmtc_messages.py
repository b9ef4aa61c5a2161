"""Telecommands from words, what `kontur-av tc` says, and K2ACI from plain fields."""

import pytest
from pus_ends import oven

from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.mission.tmtc_messages import (
    CommandUpdate,
    Reported,
    SendCommand,
    command_from_words,
    k2aci_message,
    plain_fields,
    report_words,
    update_words,
)
from telepresence.tmtc.k2aci import Chat, ChatRole, StartTask, TaskSelected

OVEN = oven().application("oven")


def command(*words):
    return command_from_words(OVEN, words, client="test", number=1)


def sent(verb, name="", **more):
    return SendCommand("test", 1, "oven", verb, name, **more)


@pytest.mark.parametrize(
    ("words", "request_"),
    [
        (["heat", "180.5"], sent("call", "heat", arguments=(180.5,))),
        (["off"], sent("call", "off")),  # a function goes before the short verb
        (["ping"], sent("ping")),
        (["report", "state"], sent("report", "state")),
        (["on", "light"], sent("housekeeping_on", "light")),
        (["get", "door", "lit"], sent("parameters", arguments=("door", "lit"))),
        (["set", "target=99.5"], sent("set", values={"target": 99.5})),
    ],
)
def test_words_become_a_telecommand(words, request_):
    assert command(*words) == request_


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["cook"], "oven does not know 'cook': choose one of heat, off, ping, report"),
        (["heat"], "oven heat takes target"),
        (["heat", "much"], "target is 'much': give a number"),
        (["report"], "report takes one name of a report"),
        (["ping", "twice"], "ping takes nothing"),
        (["get"], "get takes names of parameters"),
        (["set"], "set takes NAME=VALUE"),
        (["set", "door=open"], "oven has these to set: target"),
    ],
)
def test_other_words_are_refused_with_their_mend(words, says):
    with pytest.raises(ConfigError, match=says):
        command(*words)


def test_what_became_of_a_telecommand_is_said_in_a_line_and_a_report_has_units():
    def words(stage, **more):
        return update_words(CommandUpdate("test", 1, "oven", stage, **more))

    assert words("started") == "oven: started"
    assert words("unacknowledged", tries=2) == "oven: unacknowledged, sent 2 times"
    done = {"done": True, "round_trip_ms": 12.6, "tries": 1}
    assert words("completed", ok=True, verified=True, **done) == "oven: completed after 13 ms"
    done |= {"tries": 9, "reason": "no verification came"}
    assert words("failed", **done) == "oven: not verified, sent 9 times: no verification came"
    refused = words("refused", done=True, reason="too many telecommands are open")
    assert refused == "oven: refused: too many telecommands are open"
    report = Reported("housekeeping", "oven", 0, "state", "", {"temperature": 20.25, "lit": True})
    assert report_words(report, OVEN) == "oven state: temperature 20.25 degC, lit true"


def test_the_command_lists_what_there_is_and_refuses_the_rest(capsys):
    known = {"": "joystick (space)", "joystick": "\nhalt\n", "--xtce": "SpaceSystem"}
    for words, text in known.items():
        assert main(["tc", *words.split()]) == 0
        assert text in capsys.readouterr().out
    assert main(["tc", "joystik"]) == 2
    assert "choose one of joystick" in capsys.readouterr().err


def test_a_message_of_k2aci_goes_through_plain_fields_and_other_fields_are_refused():
    for message in (
        TaskSelected(task="aiming", run=3, start_um=(-45_000, 10), text="Aim."),
        StartTask(task="aiming", run=3),
        Chat(sender=ChatRole.SUPERVISOR, text="Well done."),
    ):
        assert k2aci_message(type(message).__name__, plain_fields(message)) == message
    for kind, fields, says in (
        ("Dance", {}, r"K2ACI 'Dance' is unknown: choose one of TaskSelected, StartTask"),
        ("StartTask", {"task": "a", "run": 1, "who": "x"}, "has no who: it has task, run"),
        ("StartTask", {"task": "a"}, "StartTask: .*run"),
        ("StartTask", {"task": "a", "run": "one"}, "StartTask: .*int"),
    ):
        with pytest.raises(ConfigError, match=says):
            k2aci_message(kind, fields)
