"""The pages' words and the names that the server knows are the same."""

import re

import pytest

from pipelines.session import access
from pipelines.session.web_site import STATIC
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.experiment import Phase, RunStep
from telepresence.tmtc.k2aci import PanelMode, TaskResult
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

WORDS = (STATIC / "mission_words.js").read_text(encoding="utf-8")


def table(name):
    """The text of a constant of the module."""
    return re.search(rf"export const {name} = [\[{{](.*?)[\]}}];", WORDS, re.DOTALL)[1]


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("PANEL_WORDS", PanelMode),
        ("PHASE_WORDS", Phase),
        ("MODE_WORDS", ControlMode),
        ("RESULT_WORDS", TaskResult),
    ],
)
def test_the_pages_have_words_for_each_state(name, known):
    assert re.findall(r"^\s*(\w+):", table(name), re.MULTILINE) == [one.value for one in known]


def test_the_pages_have_the_steps_in_their_order():
    assert re.findall(r'"(.*?)",', table("STEPS")) == [one.value for one in RunStep]


@pytest.mark.parametrize("deed", [one for one in access._MAY if "." in one])
def test_each_telecommand_that_a_role_may_give_exists(deed):
    application, _, function = deed.partition(".")
    known = built_in_dictionary().application(application).functions
    assert function in {one.name for one in known}
