"""What a person is told where people choose a page."""

import pytest

from pipelines.seats.plan import welcome_text
from pipelines.session.access import Role
from pipelines.session.setup.segments import Segment


@pytest.mark.parametrize("role", Role)
def test_only_the_owner_is_told_the_tokens_of_other_people(role):
    people = {one.value: "t" * 32 for one in Role if one is not Role.OPERATOR}
    text = welcome_text(role, Segment.GROUND, ports={"ground": 8271}, people=people, tasks=True)
    assert (text.role, text.seat, text.ports) == (role, Segment.GROUND, {"ground": 8271})
    assert text.people == (people if role is Role.OPERATOR else {})
