"""What a seat says of hand and robot agrees with the state, and leads on to motion."""

import argparse
import re
from functools import cache
from itertools import product
from random import Random

import msgspec.structs
import pytest

from pipelines.commands import stop, task
from pipelines.mission.tmtc_messages import command_from_words
from pipelines.session.access import PEOPLE, Role
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import (
    SIMULATED,
    Known,
    Next,
    Terminal,
    Why,
    at_terminal,
    situation,
)
from telepresence.haptics.envelope import Hold
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

SPACE, GROUND = Segment.SPACE, Segment.GROUND
REQUESTS = {
    "standby": "calibrate",
    "calibrated": "start",
    "halted": "resume",
    "calibration error": "acknowledge",
    "recoverable error": "acknowledge",
}
AFTER = {"calibrate": "calibrated", "start": "application", "resume": "calibrated"}
CHOICES = {
    "orders": (True, False),
    "runs": (True, True, True, False),
    "connected": (True, True, True, False),
    "stopped": (False, False, False, True),
    "answered": (True, False),
    "joystick": ("application",) * 8 + (None, "init", *REQUESTS),
    "asked": (True, False),
    "testing": (False, False, False, True),
    "held": (True, False),
    "taken_up": (True, True, False),
    "russian": (False, False, False, True),
    "device": ("page", "page", "gamepad", SIMULATED),
    "holder": ("", "", "", "operator 2"),
    "drive": ("hand", "hand", "hand", "off", "own", ""),
    "telepresence": (True, False),
    "fault": ("", "", "", "force above 28 N"),
    "barred": (Hold.NONE, Hold.NONE, Hold.NONE, Hold.PICTURE, Hold.AGE, Hold.NO_COMMAND),
    "waits": (True, True, False),
    "partner": (False, False, False, True),
    "tasks": (False, True),
    "offered": ("aiming", ""),
    "terminal": (None, None, Terminal(), Terminal("lab-1")),
}
DICTIONARY = built_in_dictionary()


def known_of(values, seat, role):
    """A state that can be: what one process says agrees with itself."""
    given = dict(values)
    asked, tasks = given.pop("asked"), given.pop("tasks")
    state = given["joystick"]
    given["request"] = REQUESTS.get(state, "") if asked else ""
    given["testing"] = given["testing"] and state == "calibrated"
    if given["testing"]:
        given |= {"request": "", "says": "hold the dead-man button"}
    if tasks:
        phases = ("idle", "preparing", "offered", "running", "ending")
        given["panel"] = (
            "wait_task" if seat is SPACE else phases[len(given["device"] + role.value) % 5]
        )
        given["panel_words"] = "Wait for a task."
    if seat is SPACE:
        given |= {"fault": "", "partner": False}
    if given["drive"] != "hand" or given["barred"] is not Hold.NONE or not given["held"]:
        given["waits"] = True
    if given["fault"]:
        given["drive"] = "off"
    given["cause"] = "" if not given["waits"] else Hold.RELEASED.value
    return Known(seat=seat, role=role, **given)


def moves_by_press(known):
    """Whether the robot would follow a hand that lets go and presses anew: the truth."""
    ready = known.runs and known.connected and not known.stopped and known.drive == "hand"
    joystick = known.seat is GROUND or (known.joystick == "application" and not known.testing)
    return ready and joystick and known.barred is Hold.NONE and not known.partner


def follow(known, told):
    """What becomes of the state when somebody does what the advice says."""
    change = dict[Why, dict[str, object]]
    gone: change = {
        Why.STOPPED: {"stopped": False},
        Why.SESSION: {"runs": True},
        Why.LINK: {"connected": True},
        Why.JOYSTICK_SILENT: {"joystick": "init"},
        Why.TEST: {"testing": False, "request": "start"},
        Why.ROBOT_SILENT: {"drive": "off"},
        Why.FAULT: {"fault": ""},
        Why.PARTNER: {"partner": False},
        Why.PICTURE: {"barred": Hold.NONE},
        Why.AGE: {"barred": Hold.NONE},
        Why.NO_COMMAND: {"barred": Hold.NONE},
        Why.PRESS: {"held": True, "waits": False, "cause": ""},
    }
    if told.why is Why.STOPPED and told.next is Next.WAIT:
        return msgspec.structs.replace(known, connected=True)
    if told.why in gone:
        return msgspec.structs.replace(known, **gone[told.why])
    if told.why is Why.JOYSTICK:
        after = AFTER.get(known.request, "standby") if known.request else "application"
        return msgspec.structs.replace(known, joystick=after, request=REQUESTS.get(after, ""))
    if told.why in (Why.OFF, Why.MODE):
        return msgspec.structs.replace(known, drive="hand", telepresence=True)
    if told.next is Next.TAKE:
        return msgspec.structs.replace(known, holder="")
    return msgspec.structs.replace(known, held=True, waits=False, holder="", cause="")


def states(number):
    random = Random(1)
    people = [
        (end, role) for end in Segment for role in (*PEOPLE[end], *list(Role)[-2:], Role.OPERATOR)
    ]
    for seat, role in people:
        for _ in range(number // len(people)):
            values = {name: random.choice(of) for name, of in CHOICES.items()}
            yield known_of(values, seat, role)


def test_no_sentence_contradicts_the_state_and_each_leads_on_to_motion():
    kinds = set()
    for known in states(100_000):
        told = situation(known)
        kinds.add((told.why, told.next))
        assert not check_lines(told.advice) or known.terminal, (known, told)
        truth = moves_by_press(known)
        # "Press" is said if, and only if, a press would move the robot.
        asks = told.may or told.why is Why.PRESS
        assert asks is truth, (known, told)
        assert truth or told.next not in (Next.PRESS, Next.LET_GO), (known, told)
        assert (told.advice == "") is (told.why is Why.FOLLOWS), (known, told)
        followed = []
        for _ in range(12):
            if told.why is Why.FOLLOWS:
                break
            followed.append(told)
            known = follow(known, told)
            told = situation(known)
            assert told != followed[-1], (known, told)
        assert told.why is Why.FOLLOWS, (known, followed)
    assert {why for why, _ in kinds} == set(Why)
    assert {one for _, one in kinds} == set(Next) - {Next.RESTART}


@cache
def check_lines(advice):
    """What a terminal advises is a command that its parser takes."""
    lines = re.findall("`kontur-av (.*?)( --session lab-1)?`", advice)
    for words in (line.split() for line, _ in lines):
        if words[0] == "tc":
            application = DICTIONARY.application(words[1])
            command_from_words(application, words[2:], client="", number=0)
        else:
            parser = argparse.ArgumentParser()
            {"stop": stop, "task": task}[words[0]].add_arguments(parser)
            parser.parse_args(words[1:])
    return bool(lines)


def test_a_terminal_of_both_ends_says_what_one_of_them_says_and_its_lines_lead_on():
    random, given = Random(2), 0
    for _ in range(10_000):
        values = {name: random.choice(of) for name, of in CHOICES.items()} | {"orders": True}
        ends = {seat: known_of(values, seat, Role.OPERATOR) for seat in Segment}
        for _ in range(15):
            told = at_terminal(ends.values(), Terminal())
            said = {seat: situation(known) for seat, known in ends.items()}
            # Another seat has the same reason, and a hand that may move is barred at neither.
            by = [seat for seat in Segment if (said[seat].why, said[seat].reason) == told[:2]]
            assert by, (said, told)
            others = [each for each in said.values() if each.why is not Why.PARTNER]
            assert not told.may or all(each.may for each in others), (said, told)
            if told.why is Why.FOLLOWS:
                break
            given += check_lines(told.advice)
            # What one end learns of the robot the other one hears.
            ends = {seat: follow(known, told) for seat, known in ends.items()}
        assert told.may, (said, told)
    assert given > 5_000


def test_who_may_not_do_it_is_told_whom_to_ask():
    stop = Known(seat=GROUND, role=Role.EXPERIMENTER, stopped=True, by="the cosmonaut")
    assert situation(stop).advice == "Ask the supervisor or the cosmonaut: release the stop."
    off = Known(seat=GROUND, role=Role.SUPERVISOR, drive="off")
    assert situation(off).advice == "Ask the experimenter: switch the robot on."
    broken = Known(seat=SPACE, role=Role.COSMONAUT, joystick="fatal error", says="it is gone")
    assert situation(broken).next is Next.RESTART


@pytest.mark.parametrize("state", REQUESTS)
@pytest.mark.parametrize("panel", [None, "wait_task", "press_deadman"])
def test_with_the_robot_off_nobody_is_told_to_press(state, panel):
    for held, joystick in product((True, False), ("application", state)):
        known = Known(
            seat=SPACE,
            role=Role.COSMONAUT,
            drive="off",
            held=held,
            joystick=joystick,
            request="" if joystick == "application" else REQUESTS[state],
            panel=panel,
        )
        told = situation(known)
        assert told.why is (Why.OFF if joystick == "application" else Why.JOYSTICK)
        assert "dead-man" not in told.advice
