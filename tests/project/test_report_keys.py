"""A report's schema and the list of its keys are made from its types."""

import msgspec
from report_keys import report_keys

from pipelines.report.schema import comments, schema_of
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


def test_the_schema_has_types_and_comments_also_those_of_a_base():
    defs = schema_of(Whole)["$defs"]
    assert defs["Whole"]["properties"]["parts"]["description"] == "Each one."
    assert defs["Whole"]["required"] == ["parts", "rate_bps_mean"]
    part = defs["Part"]
    assert part["properties"]["p99.9"] == {"description": "How late, at most.", "type": "number"}
    assert part["properties"]["count"] == {"type": "integer"}
    assert part["required"] == ["p99.9"]
    assert comments(Heir) == {"late_ms": "How late, at most.", "count": "", "other": "Another one."}
    assert "- `failures`: What broke" in report_keys()
