"""The tables of a report's keys are made from its types."""

import msgspec
from report_keys import comments, keys_tables

from pipelines.report.model import SessionReport
from pipelines.session.session_metrics import Report


class Part(Report, frozen=True, kw_only=True):
    """A part."""

    #: How late,
    #: at most.
    late_ms: float = msgspec.field(name="p99.9")
    count: int | None = None


class Whole(Report, frozen=True, kw_only=True):
    """A whole."""

    #: Each one.
    parts: dict[str, Part | None]
    rate_bps_mean: int


class Heir(Part, frozen=True, kw_only=True):
    """More."""

    #: Another one.
    other: int


def test_each_type_has_a_list_with_types_and_comments_also_those_of_its_base():
    whole, part = keys_tables(Whole).split("\n\n**")
    assert "- `parts` (Part or null, by name): Each one." in whole
    assert "\n- `rate_bps_mean`" in whole
    assert "- `p99.9` (number): How late, at most.\n" in part
    assert "\n- `count`?\n" in part
    assert comments(Heir) == {"late_ms": "How late, at most.", "count": "", "other": "Another one."}
    text = keys_tables(SessionReport)
    assert "**SessionReport**: The report of" in text
    assert "**: \n" not in text
