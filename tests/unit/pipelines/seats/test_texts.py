"""What a page asks for in words, and the words that it has for what it is told."""

import re

import pytest

from kontur_av.errors import ProtocolError
from pipelines.seats import texts
from pipelines.session.web_site import STATIC
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.experiment import Phase, RunStep
from telepresence.tmtc.k2aci import PanelMode, TaskResult


def test_requests_of_a_seat():
    stop = texts.parse_seat_request('{"request": 3, "do": "session", "action": "stop"}')
    assert stop == texts.SessionRequest(request=3, action="stop")
    halt = texts.parse_seat_request('{"request": 4, "do": "joystick", "event": "halt"}')
    assert halt == texts.JoystickRequest(request=4, event="halt")
    on = texts.parse_media_request(
        '{"request": 5, "do": "input", "name": "operator_mic", "on": true}'
    )
    assert on == texts.InputRequest(request=5, name="operator_mic", on=True)


TAKEN = '{"request": 1, "do": '


@pytest.mark.rule("10")
@pytest.mark.parametrize(
    "text",
    [
        *("", "{}", "[" * 4000, TAKEN + '"session"}', TAKEN + '"quit"}'),
        '{"request": -1, "do": "command", "application": "a"}',
        '{"request": 1e400, "do": "command", "application": "a"}',
        *(TAKEN + '"command", "application": ""}', TAKEN + '"joystick", "event": "fault"}'),
        TAKEN + '"command", "application": "a", "more": 1}',
        TAKEN + '"input", "name": "operator_mic", "on": true}',
        TAKEN + '"command", "application": "\ud800"}',
    ],
)
def test_anything_else_is_refused(text):
    # tests/fuzz/test_page_fuzz.py has the rest.
    with pytest.raises(ProtocolError):
        texts.parse_seat_request(text)


def test_the_pages_have_words_for_each_state_and_the_steps_in_their_order():
    words = (STATIC / "mission_words.js").read_text(encoding="utf-8")

    def found(name, what):
        table = re.search(rf"export const {name} = [\[{{](.*?)[\]}}];", words, re.DOTALL)[1]
        return re.findall(what, table, re.MULTILINE)

    assert found("STEPS", '"(.*?)",') == [one.value for one in RunStep]
    for name, known in {
        "PANEL_WORDS": PanelMode,
        "PHASE_WORDS": Phase,
        "MODE_WORDS": ControlMode,
        "RESULT_WORDS": TaskResult,
    }.items():
        assert found(name, r"^\s*(\w+):") == [one.value for one in known]
