"""What a user's part returns, converted and checked at one door. A core.

A driver may return numbers of any library, such as those of numpy, a plain tuple, or nonsense. What
comes out here has the types that the interface names, or it is a `PartError` of one line.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from math import isfinite
from operator import index
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from kontur_av.errors import ConfigError

#: Longer words of a part are cut.
_MOST_CHARACTERS = 200

T = TypeVar("T")
_Convert = Callable[[Any], Any]


class PartError(ConfigError):
    """A user's part cannot be used as it is. Its text is one line with the fix."""


class _UnfitError(Exception):
    """The value does not fit; the text says what would."""


def taken(kind: type[T], value: Any, what: str) -> T:
    """Return `value` as `kind`: a NamedTuple, or a frozen dataclass. Raises PartError.

    what: whose it is, such as "read()".
    """
    try:
        converted: T = _converter(cast(Any, kind))(value)
    except _UnfitError as unfit:
        raise PartError(f"{what} returned {unfit}") from None
    return converted


def one_line(words: object) -> str:
    """Return what a part says as one line that a terminal can show."""
    text = " ".join(str(words).split())
    return "".join(one if one.isprintable() else "?" for one in text)[:_MOST_CHARACTERS]


def fault_of(call: str, error: Exception) -> str:
    """Return, in one line, that a call of a part has failed, and how."""
    if isinstance(error, ConfigError):
        return one_line(error)
    return f"{call} failed: {one_line(f'{type(error).__name__}: {error}')}"


def _shown(value: object) -> str:
    try:
        return one_line(repr(value))
    except Exception:
        return f"a {type(value).__name__}"


def plain(value: Any) -> Any:
    """A scalar of numpy, or an array of one number, as Python has it."""
    item = getattr(value, "item", None)
    return value if item is None else item()


def _float(value: Any) -> float:
    if type(value) is float:
        return value
    try:
        if not isinstance(value, str | bytes | bytearray):
            return float(plain(value))
    except Exception:
        pass
    raise _UnfitError(f"{_shown(value)}: give a number")


def _int(value: Any) -> int:
    try:
        number = plain(value)
        whole = isinstance(number, float) and number.is_integer()
        return int(number) if whole else index(number)
    except Exception:
        raise _UnfitError(f"{_shown(value)}: give a whole number") from None


def _bool(value: Any) -> bool:
    try:
        flag = plain(value)
        if isinstance(flag, bool | int | float):
            return bool(flag)
    except Exception:
        pass
    raise _UnfitError(f"{_shown(value)}: give True or False")


def _str(value: Any) -> str:
    return "" if value is None else one_line(value)


#: Values of these types are converted in any case: what is in a tuple, and words.
_NESTED = (tuple, str)
_SCALARS: dict[type, _Convert] = {float: _float, int: _int, bool: _bool, str: _str}


@cache
def _converter(kind: Any) -> _Convert:
    """What converts a value to a kind."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind in _SCALARS:
        return _SCALARS[kind]
    if origin in (Union, UnionType) and NoneType in inner:
        (some,) = (_converter(one) for one in inner if one is not NoneType)
        return lambda value: None if value is None else some(value)
    if origin is tuple:
        each = _converter(inner[0])
        return lambda value: tuple(map(each, _items(value, "tuple")))
    if origin is Literal:
        return lambda value: _one_of(value, inner)
    if isinstance(kind, type) and issubclass(kind, tuple):
        return _record(kind)
    if is_dataclass(kind):
        return _capabilities(kind)
    if isinstance(origin, type):
        return lambda value: _instance(value, origin)
    return lambda value: value


def _instance(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise _UnfitError(f"{_shown(value)}: give a {kind.__name__}")
    return value


def _items(value: Any, wanted: str) -> list[Any]:
    if not isinstance(value, Iterable) or isinstance(value, str | bytes | Mapping):
        raise _UnfitError(f"{_shown(value)}: give a {wanted}")
    return list(value)


def _one_of(value: Any, choices: tuple[Any, ...]) -> Any:
    if isinstance(value, str) and value in choices:
        return value
    raise _UnfitError(f"{_shown(value)}: one of {', '.join(map(str, choices))}")


def _record(kind: Any) -> _Convert:
    """Of a NamedTuple, also from any other sequence of its fields."""
    hints = get_type_hints(kind)
    converters = [(name, _converter(one)) for name, one in hints.items()]
    types = tuple(get_origin(hint) or hint for hint in hints.values())
    least = len(converters) - len(kind._field_defaults)

    def convert(value: Any) -> Any:
        # Most readings are what the interface names.
        exact = type(value) is kind and tuple(map(type, value)) == types
        if exact and not any(one for one in value if type(one) in _NESTED):
            return value
        items = _items(value, kind.__name__)
        if not least <= len(items) <= len(converters):
            raise _UnfitError(f"{_shown(value)}: give a {kind.__name__}")
        return kind(*(_named(*one, item) for one, item in zip(converters, items, strict=False)))

    return convert


def _named(name: str, convert: _Convert, value: Any) -> Any:
    try:
        return convert(value)
    except _UnfitError as unfit:
        raise _UnfitError(f"{name} = {unfit}") from None


def _capabilities(kind: Any) -> _Convert:
    """Of a frozen dataclass of facts. A number is above 0; one that may be missing, at least 0."""
    hints = get_type_hints(kind)

    def convert(value: Any) -> Any:
        if not isinstance(value, kind):
            raise _UnfitError(f"a {type(value).__name__}: give {kind.__name__}")
        changes = {}
        for field in fields(kind):
            name, hint = field.name, hints[field.name]
            found = _named(name, _converter(hint), getattr(value, name))
            if hint in (float, int):
                # What may be missing, such as motors and buttons, has a default of 0.
                positive = field.default is MISSING or field.default > 0
                if not isfinite(found) or found < 0 or (positive and found == 0):
                    least = "above 0" if positive else "of at least 0"
                    raise _UnfitError(f"{name} = {found!r}: give a number {least}")
            elif hint is str and not found:
                raise _UnfitError(f"{name} = '': give a text")
            changes[name] = found
        return kind(**changes)

    return convert
