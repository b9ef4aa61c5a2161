"""Error classes, one for each party that can be at fault."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from operator import index
from typing import Any, TypeVar

from kontur_av.redaction import redacted

_Choice = TypeVar("_Choice", bound=str)


class ConfigError(Exception):
    """The user's mistake. Its message is one line that names the fix; commands exit with 2.

    No password of an address is in it.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(redacted(message))


class ProtocolError(Exception):
    """Garbage from the peer. Its receiver counts and drops it, and goes on."""


@contextmanager
def refused(
    what: object,
    *kinds: type[Exception],
    raising: type[ConfigError] | type[ProtocolError] = ConfigError,
) -> Iterator[None]:
    """Within it, an error of these kinds becomes one of `raising`, which says `what` and why.

    kinds: OSError if none is given.
    """
    caught = kinds or (OSError,)
    try:
        yield
    except caught as error:
        raise raising(f"{what}: {getattr(error, 'strerror', None) or error}") from None


def one_of(text: str, choices: Sequence[_Choice], what: str) -> _Choice:
    """Return the choice that `text` names; ConfigError, which begins with `what`, if none is."""
    for choice in choices:
        if choice == text:
            return choice
    raise ConfigError(f"{what} {text!r}: take one of {', '.join(choices)}")


def number(value: Any, what: str, *, least: float, most: float) -> float:
    """Return a number, an integer if it is whole. ConfigError begins with `what`."""
    with refused(f"{what} {value!r}: give a number", TypeError, ValueError):
        found = float(value + 0)
    if not least <= found <= most:
        raise ConfigError(f"{what} {found:g}: take {least:g} to {most:g}")
    return int(found) if found.is_integer() else found


def whole(value: Any, what: str, *, least: int, most: int) -> int:
    """Return a whole number, also of a float or of numpy. ConfigError begins with `what`."""
    try:
        number = int(value) if isinstance(value, float) and value.is_integer() else index(value)
    except TypeError:
        raise ConfigError(f"{what} {value!r}: give a whole number") from None
    if not least <= number <= most:
        raise ConfigError(f"{what} {number}: take {least} to {most}")
    return number
