"""Reads TOML files of users and checks them against typed tables; errors are one line.

A dataclass defines the contents of a file. msgspec checks and converts. Its errors become a
ConfigError that names the field, its value and what would fit.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from kontur_av.errors import ConfigError

_Table = TypeVar("_Table")

#: msgspec's names of types, and the words for users.
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text in quotes",
    "bool": "true or false",
}
#: What is computed from smaller numbers stays finite.
_TOO_LARGE = 1 << 64
_MESSAGE = re.compile(r"(.*?)(?: - at `\$(.*)`)?")


def read_toml(path: Path, what: str) -> Mapping[str, Any]:
    """Return the table in a file; ConfigError. what: the kind of file, such as "radio"."""
    try:
        # Editors of other systems begin a text with a byte order mark.
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"cannot read {what} {path}: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{what} {path} is not TOML: octet {error.start} is no UTF-8: save it as UTF-8"
        ) from None
    except ValueError as error:
        raise ConfigError(f"{what} {str(path)!r} is not TOML: {error}") from None
    return parse_toml(text, f"{what} {path}")


def parse_toml(text: str, what: str) -> Mapping[str, Any]:
    """Return the table in a text; ConfigError. what: the text, for errors."""
    try:
        return tomllib.loads(text)
    # Also integers of thousands of digits, and arrays in arrays without end.
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{what} is not TOML: {error}") from None


def check_known(table: Mapping[str, Any], kind: type, *, also: tuple[str, ...] = ()) -> None:
    """Raise ConfigError for a field that `kind` (a dataclass) lacks, or for an infinite number.

    also: additional fields, which the caller handles itself.
    """
    _check_known("", table, kind, also)


def typed(table: Mapping[str, Any], kind: type[_Table], what: str) -> _Table:
    """Convert `table` to a `kind` (a dataclass whose fields may be dataclasses); ConfigError.

    A field's metadata "like" describes its values in words, if the type alone says too little.
    what: what the whole table is, for errors, such as "a setup".
    """
    check_known(table, kind)
    try:
        return msgspec.convert(table, kind, dec_hook=_path)
    except msgspec.ValidationError as error:
        match = _MESSAGE.fullmatch(str(error))
        assert match is not None
        wrong, path = match[1], match[2] or ""
        raise ConfigError(_told(wrong, path, table, kind, what)) from None


def _path(kind: type, value: object) -> object:
    if kind is not Path or not isinstance(value, str):
        raise ValueError("a path in quotes")
    return Path(value)


def _check_known(
    prefix: str, table: Mapping[str, Any], kind: type, also: tuple[str, ...] = ()
) -> None:
    known = get_type_hints(kind)
    for key, value in table.items():
        name = prefix + key
        if key not in known and key not in also:
            (nearest,) = get_close_matches(key, [*known, *also], n=1, cutoff=0.0)
            raise ConfigError(f"unknown field {name}: the nearest one is {prefix}{nearest}")
        for number in _numbers(value):
            if isinstance(number, float) and not isfinite(number):
                raise ConfigError(f"{name} is {number}: it must be a finite number")
            if abs(number) >= _TOO_LARGE:
                raise ConfigError(f"{name} is too large: it must be a number below 2**64")
        inner = _inner(known.get(key))
        if inner is not None:
            tables = [(name, one) for one in (value if isinstance(value, list) else [value])]
            if get_origin(known[key]) is Mapping and isinstance(value, Mapping):
                tables = [(f"{name}.{of}", one) for of, one in value.items()]
            for begin, each in tables:
                if isinstance(each, Mapping):
                    _check_known(f"{begin}.", each, inner)


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, list):
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, int | float):
        yield value


def _inner(hint: Any) -> type | None:
    """Return the dataclass in a field's type: alone, or in a union, tuple or mapping."""
    return next((each for each in (hint, *get_args(hint)) if is_dataclass(each)), None)  # type: ignore[return-value]


def _told(wrong: str, path: str, table: Any, kind: type, what: str) -> str:
    """Return msgspec's error at `path` in words for users."""
    name = re.sub(r"\[[^]]*\]", "", path).removeprefix(".")
    field: Field[Any] | None = None
    value, holder = table, kind
    for key, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", path):
        if key:
            field = next(each for each in fields(holder) if each.name == key)
            value = value[key]
            holder = _inner(get_type_hints(holder)[key]) or holder
        elif index == "...":
            # A value of a mapping; msgspec does not say which key it belongs to.
            name = path.partition("[...]")[0].removeprefix(".")
            for of, one in value.items() if is_dataclass(holder) and holder is not kind else ():
                if not isinstance(one, Mapping):
                    break
                try:
                    typed(one, holder, "")
                except ConfigError as error:
                    told = str(error)
                    return f"{name}.{of}{'' if told.startswith(' ') else '.'}{told}"
            return f"{name} must be {_wanted(wrong, name, field, holder)} throughout"
        else:
            value = value[int(index)]
    if wrong.startswith("Object missing"):
        needed = [
            each.name
            for each in fields(holder)
            if each.default is MISSING and each.default_factory is MISSING
            if each.name not in value
        ]
        return f"{name or what} needs {' and '.join(needed)}"
    return f"{name} must be {_wanted(wrong, name, field, holder)}, not {_shown(value)}"


def _wanted(wrong: str, name: str, field: Field[Any] | None, holder: type) -> str:
    if field is not None and "like" in field.metadata:
        return str(field.metadata["like"])
    if field is not None and wrong.startswith("Invalid enum value"):
        hint = field.type
        (choices,) = (arg for arg in (hint, *get_args(hint)) if get_origin(arg) is Literal)
        return f"one of {', '.join(get_args(choices))}"
    match = re.match(r"Expected `([a-z]+)", wrong)
    expected = match[1] if match else ""
    if expected == "object":
        known = ", ".join(each.name for each in fields(holder))
        return f"a table with {known}: a table [{name}]"
    if expected == "array":
        hint = None if field is None else field.type
        if any(get_args(each)[:1] in ((str,), (Path,)) for each in (hint, *get_args(hint))):
            return "a list of texts in quotes"
        return f"tables [[{name}]]"
    return _WORDS.get(expected, wrong)


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "a table" if isinstance(value, Mapping) else repr(value)
