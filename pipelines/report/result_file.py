"""The JSON file of a bench."""

from collections.abc import Sequence
from pathlib import Path

from pipelines.report.report_file import write_report
from pipelines.report.result import Headline, as_json


def write_result(
    path: Path | None, result: object, headlines: Sequence[Headline], *, digits: int | None = None
) -> None:
    """Write `result`, a dataclass or a mapping, and its `headlines` as one JSON object.

    path: None writes nothing.
    """
    if path is None:
        return
    body = as_json(result, digits=digits)
    assert isinstance(body, dict)
    write_report(path, {**body, "headlines": as_json(headlines, digits=6)})
