"""Records of figures: typed dataclasses, each declared where it is counted. A core.

A `#:` comment above a field says what it is, and its name ends with its unit. Reports, recordings
and documents derive from these records. A process that was started again counts from 0; `plus`
joins its starts:

- integers add up, also those by name in a mapping;
- texts, booleans, numbers that are not integers, and sequences have their newest value;
- `Newest`, `Most` and `Least` say otherwise;
- a record in a mapping that has a `plus` of its own joins itself;
- None is a figure that is not known or does not exist: the other start decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")
_NEWEST, _MOST, _LEAST, _FLAT = "newest", "most", "least", "flat"

#: A value of the present, not a count: the later one holds, even if it is None.
Newest = Annotated[T, _NEWEST]
#: The largest value of all starts, and the smallest.
Most = Annotated[T, _MOST]
Least = Annotated[T, _LEAST]
#: A record whose figures stand among those of the record that holds it.
Flat = Annotated[T, _FLAT]


def plus(one: T, later: T) -> T:
    """Return the figures of both starts together."""
    found = {
        name: _joined(getattr(one, name), getattr(later, name), marks)
        for name, marks in marks_of(_kind(later)).items()
    }
    return replace(later, **found)  # type: ignore[type-var]


def over(told: T, earlier: T) -> T:
    """Return the newest figures of one start.

    What they do not know (None), or no longer tell (a record in a mapping), is as it was before.
    """
    found: dict[str, object] = {}
    for name, marks in marks_of(_kind(told)).items():
        value, before = getattr(told, name), getattr(earlier, name)
        if value is None and before is not None and _NEWEST not in marks:
            found[name] = before
        elif isinstance(value, Mapping) and any(hasattr(one, "plus") for one in value.values()):
            found[name] = _joined(before, value)
    return replace(told, **found) if found else told  # type: ignore[type-var]


def metrics_of(kind: type[T], owner: object) -> T:
    """Return the record of this kind whose figures `owner` has as attributes of their names."""
    record: Any = kind
    return kind(**{name: getattr(owner, name) for name in marks_of(record)})


def counts(record: object) -> dict[str, int]:
    """Return what adds up, by name; of a mapping its values that are not 0."""
    found: dict[str, int] = {}
    for name, value, adds_up in _flat_items(record):
        if isinstance(value, Mapping):
            counted = {key: count for key, count in value.items() if _is_count(count) and count}
            found |= {f"{name}_{key}": count for key, count in counted.items()}
        elif adds_up:
            found[name] = value
    return found


def newest(record: object) -> dict[str, int | float | str | bool]:
    """Return all other numbers and texts that are known, by name."""
    return {
        name: value.value if isinstance(value, Enum) else value
        for name, value, adds_up in _flat_items(record)
        if not adds_up and isinstance(value, int | float | str | Enum)
    }


def _flat_items(record: Any) -> Iterator[tuple[str, Any, bool]]:
    """Names and values, with those of flat records, and whether each adds up."""
    for name, marks in marks_of(_kind(record)).items():
        value = getattr(record, name)
        if _FLAT not in marks:
            yield name, value, _is_count(value) and not {_NEWEST, _MOST, _LEAST} & marks
        elif value is not None:
            yield from _flat_items(value)


@cache
def marks_of(kind: Any) -> dict[str, frozenset[str]]:
    """Return the marks of each field of a record: what `Newest`, `Flat` and the others put there.

    Raises TypeError for a type that is not a record.
    """
    hints = get_type_hints(kind, include_extras=True)
    names = getattr(kind, "__struct_fields__", None) or [field.name for field in fields(kind)]
    return {name: frozenset(_marks(hints[name])) for name in names}


def _kind(record: Any) -> Any:
    return type(record)


def is_flat(kind: Any, name: str) -> bool:
    """Return whether a field holds a record whose figures stand among its own."""
    return _FLAT in marks_of(kind)[name]


def _marks(hint: object) -> Iterator[str]:
    if get_origin(hint) is Annotated:
        yield from (mark for mark in get_args(hint)[1:] if isinstance(mark, str))
    elif get_origin(hint) in (Union, UnionType):
        for arg in get_args(hint):
            yield from _marks(arg)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool | Enum)


def _joined(one: Any, later: Any, marks: frozenset[str] = frozenset()) -> Any:
    if _NEWEST in marks:
        return later
    if one is None or later is None:
        return one if later is None else later
    if _MOST in marks or _LEAST in marks:
        return max(one, later) if _MOST in marks else min(one, later)
    if isinstance(later, Mapping):
        return {key: _joined(one.get(key), later.get(key)) for key in {**one, **later}}
    if hasattr(later, "plus"):
        return later.plus(one)
    if is_dataclass(later):
        return plus(one, later)
    return one + later if _is_count(later) else later
