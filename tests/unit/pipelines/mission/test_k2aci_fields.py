"""Messages of K2ACI from plain fields, as other programs give them, and back."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.mission.tmtc_messages import k2aci_message, plain_fields
from telepresence.tmtc.k2aci import Chat, ChatRole, StartTask, TaskSelected

MESSAGES = [
    TaskSelected(task="aiming", run=3, start_um=(-45_000, 10), text="Aim."),
    StartTask(task="aiming", run=3),
    Chat(sender=ChatRole.SUPERVISOR, text="Well done."),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_a_message_is_the_same_after_its_way_through_plain_fields(message):
    assert k2aci_message(type(message).__name__, plain_fields(message)) == message


@pytest.mark.parametrize(
    ("kind", "given", "says"),
    [
        ("Dance", {}, r"K2ACI 'Dance' is unknown: choose one of TaskSelected, StartTask"),
        (
            "StartTask",
            {"task": "a", "run": 1, "who": "x"},
            "StartTask has no who: it has task, run",
        ),
        ("StartTask", {"task": "a"}, "StartTask: .*run"),
        ("StartTask", {"task": "a", "run": "one"}, "StartTask: .*int"),
    ],
)
def test_other_fields_are_refused_with_their_mend(kind, given, says):
    with pytest.raises(ConfigError, match=says):
        k2aci_message(kind, given)
