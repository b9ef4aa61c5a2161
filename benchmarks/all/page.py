"""From the records of `python -m benchmarks all` to `docs/measurements.md`. A core."""

import re
from collections.abc import Sequence
from itertools import groupby
from statistics import median

from benchmarks.all.records import Record
from pipelines.report.result import Headline, decimals

_HEAD = """# Measurements

For reviewers: which figures were measured, with which command, and on which code?

`python -m benchmarks all` wrote this page from the JSON files in `{folder}`, with all figures; here
are medians (least…largest). *Code* digests all modules; commit: `git log -1 {folder}/NAME-1.json`.
"""
#: By measurement: figures without a target that are on the page; of others, all if none has one.
_SHOWN = {
    "video": "clips that no.*: VMAF, mean",
    "voice": "at 8 .*: loss (none.*p99|5 %, random: PESQ)",
    "link": "live: ",
    "haptics": "(.*: )?(cells|unstable cells|energy made|felt stiffness)",
    **dict.fromkeys(("sync", "sync-live"), ".*p95"),
    "rtc": "(from a partner|to a browser).*p99",
}


def page(records: Sequence[Record], *, folder: str) -> str:
    """The page in Markdown. records: in the order of the sections; folder: of their files."""
    sections, before = [_HEAD.format(folder=folder)], ""
    for _, group in groupby(records, key=lambda record: record.name):
        runs = list(group)
        machine = "; ".join(dict.fromkeys(str(record.machine) for record in runs))
        sections.append(_section(runs, machine if machine != before else ""))
        before = machine
    return "\n".join(sections)


def _section(runs: Sequence[Record], machine: str) -> str:
    lines = [f"## {runs[0].title}", "", "```sh"]
    lines += [*dict.fromkeys(record.command for record in runs), "```", ""]
    dates = sorted({record.date[:10] for record in runs})
    codes = ", ".join(dict.fromkeys(record.code for record in runs))
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    lines.append(f"{len(runs)} run{'s' * (len(runs) > 1)}, {when}, code {codes}.")
    if machine:
        lines.append(f"Machine: {machine}.")
    for record in runs:
        if record.failure:
            lines.append(f"**Run {record.number} failed: {_safe(record.failure)}**")
    every = [headline for record in runs for headline in record.headlines]
    of_target = [one for one in every if one.target and "were tuned on" not in one.group]
    judged = {(one.group, one.what) for one in of_target}
    shown = _SHOWN.get(runs[0].name, "$" if judged else "")
    places = ((one, (one.group, one.what)) for one in every)
    found = [one for one, at in places if at in judged or re.match(shown, ": ".join(at))]
    for group in dict.fromkeys(headline.group for headline in found):
        lines += ["", *_table(group, [one for one in found if one.group == group])]
    return "\n".join([*lines, ""])


def _table(group: str, found: Sequence[Headline]) -> list[str]:
    columns = list(dict.fromkeys(one.who for one in found))
    judged = list(dict.fromkeys(one.who for one in found if one.target))
    heads = [group or "figure", *(who or "median" for who in columns)]
    if judged:
        heads.append("target" if judged == columns else f"target ({', '.join(judged)})")
    rows = []
    for what, unit in dict.fromkeys((one.what, one.unit) for one in found):
        row = [one for one in found if (one.what, one.unit) == (what, unit)]
        cells = [_cell([one.value for one in row if one.who == who]) for who in columns]
        named = f"{what}, {unit}" if unit else what
        rows.append([named, *cells, *[_verdict(row)] * bool(judged)])
    if len(columns) == 1:
        head = ", ".join(filter(None, (group, *columns)))
        lines = [f"{name}: {'; target '.join(filter(None, cells))}" for name, *cells in rows]
        return [*[f"{_safe(head)}:", ""] * bool(head), *(f"- {_safe(line)}" for line in lines)]
    rule = "|---" + "|--:" * len(columns) + "|---" * bool(judged) + "|"
    return [_line(heads), rule, *map(_line, rows)]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(_safe, cells))} |"


def _cell(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "–" if values else ""
    digits = decimals(known)
    middle, least, largest = (f"{of(known):.{digits}f}" for of in (median, min, max))
    return middle if least == largest else f"{middle} ({least}…{largest})"


def _verdict(row: Sequence[Headline]) -> str:
    judged = [one for one in row if one.met is not None]
    if not judged:
        return ""
    missed = sum(not one.met for one in judged)
    if not missed:
        return f"{judged[0].target}: met"
    part = "" if missed == len(judged) else f" in {missed} of {len(judged)} runs"
    return f"{judged[0].target}: **missed**{part}"


def _safe(text: str) -> str:
    return text.replace("|", "\\|")
