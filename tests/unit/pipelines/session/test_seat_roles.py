"""Who may ask for what."""

import pytest

from pipelines.session.seat_roles import PEOPLE, Role, chat_role, refusal
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.k2aci import ChatRole


@pytest.mark.parametrize(
    ("role", "deed"),
    [
        (Role.COSMONAUT, "panel.button"),
        (Role.COSMONAUT, "hand"),
        (Role.EXPERIMENTER, "tasks.select"),
        (Role.EXPERIMENTER, "robot.reset_error"),
        (Role.EXPERIMENTER, "robot.set_mode"),
        (Role.SUPERVISOR, "joystick.halt"),
        (Role.SUPERVISOR, "session"),
        (Role.SYSTEMS, "housekeeping"),
        (Role.SYSTEMS, "fetch"),
    ],
)
def test_each_of_the_people_does_what_is_theirs(role, deed):
    segment = next(one for one, people in PEOPLE.items() if role in people)
    assert refusal(role, segment, deed) == ""
    assert refusal(Role.OPERATOR, segment, deed) == ""
    assert refusal(Role.VIEWER, segment, deed) == "a viewer may watch only"


def test_a_refusal_names_who_may():
    words = refusal(Role.SUPERVISOR, Segment.GROUND, "tasks.select")
    assert words == "tasks select: the experimenter may, not the supervisor"
    words = refusal(Role.OPERATOR, Segment.SPACE, "robot.power_off")
    assert words == "robot power off: the experimenter or the supervisor may, not people in space"
    words = refusal(Role.SYSTEMS, Segment.GROUND, "robot.melt")
    assert words == "robot melt: nobody may, not the systems operator"


def test_everybody_but_viewers_writes_in_the_chat_as_who_they_are():
    named = {
        chat_role(role, segment)
        for segment, people in PEOPLE.items()
        for role in people
        if refusal(role, segment, "chat") == ""
    }
    assert named == set(ChatRole)
    assert chat_role(Role.OPERATOR, Segment.SPACE) is ChatRole.COSMONAUT
