"""The doors by which parts come in, built-in ones and a user's: named by a SPEC, made by a class.

The built-in ones are a table, not entry points: no process reads the metadata of all installed
packages for them, and they are there in a source tree that is not installed.
"""

import importlib
import re
import sys
from collections.abc import Mapping
from importlib.metadata import entry_points
from inspect import Parameter, signature
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from kontur_av.errors import ConfigError
from kontur_av.returned import PartError

_NAMED = re.compile(r"(?P<module>[^\W\d][\w.]*):(?P<name>[^\W\d]\w*)(:(?P<argument>.*))?")


class PluginRegistry(NamedTuple):
    """Where the parts of one kind come in.

    what, forms: the kind, and how its SPECs are written, for messages.
    group: the entry points of users' packages.
    built_in: `module:Class` of each built-in part, loaded on demand, by the name in its SPEC.
    """

    what: str
    forms: str
    group: str
    built_in: Mapping[str, str] = MappingProxyType({})


def names_part(spec: str, registry: PluginRegistry) -> bool:
    """Whether `spec` begins with a part's name, or has the form `module:Class`."""
    first = spec.partition(":")[0]
    return (
        first in registry.built_in
        or _NAMED.fullmatch(spec) is not None
        or _registered(first, registry.group)
    )


def find_part(spec: str, registry: PluginRegistry) -> tuple[Any, tuple[str, ...]]:
    """Return the class that `spec` names, and its last arguments: what follows as `:TEXT`, if so.

    spec: the name of a built-in part or of an entry point, or `module:Class`. A module is looked
    for in the working directory, too.

    Raises ConfigError if there is no such class.
    """
    first, _, rest = spec.partition(":")
    text = (rest,) if rest else ()
    if (place := registry.built_in.get(first)) is not None:
        module, _, name = place.partition(":")
        return getattr(importlib.import_module(module), name), text
    named = _NAMED.fullmatch(spec)
    try:
        if _registered(first, registry.group):
            (entry,) = entry_points(group=registry.group, name=first)
            return entry.load(), text
        if named is not None:
            argument = named["argument"]
            return _class(named["module"], named["name"]), (argument,) if argument else ()
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{spec!r}: there is no module {error.name!r}: install it, or run in its directory"
        ) from None
    except ConfigError:
        raise
    except Exception as error:
        # The user's own code: whatever it raises is theirs to fix.
        raise ConfigError(f"{spec!r} cannot be loaded: {error_words(error)}") from error
    known = ", ".join(sorted(point.name for point in entry_points(group=registry.group)))
    raise ConfigError(
        f"{registry.what} {spec!r}: write {registry.forms}"
        + (f", or one of {known}" if known else "")
    )


def make_part(spec: str, registry: PluginRegistry, *arguments: object, **offers: object) -> Any:
    """Return what `spec` names, made with these arguments and the one that stands in it.

    offers: handed to a class that has keyword-only arguments of these names.

    Raises ConfigError if there is no such class, or if it cannot be made.
    """
    made, text = find_part(spec, registry)
    ours = spec.partition(":")[0] in registry.built_in
    try:
        taken = _taken(made, offers) if offers else {}
        if ours:
            signature(made).bind(*arguments, *text, **taken)
    except TypeError as error:
        raise _refused(spec, error) from error
    try:
        return made(*arguments, *text, **taken)
    except ConfigError:
        raise
    except Exception as error:
        if ours:
            raise
        raise _refused(spec, error) from error


def _taken(made: Any, offers: Mapping[str, object]) -> dict[str, object]:
    try:
        parameters = signature(made).parameters
    except ValueError:
        # A class that is written in C need not say what it takes.
        return {}
    return {
        name: value
        for name, value in offers.items()
        if name in parameters and parameters[name].kind is Parameter.KEYWORD_ONLY
    }


def _refused(spec: str, error: Exception) -> PartError:
    return PartError(f"{spec!r} cannot be made: {error_words(error)}")


def _registered(name: str, group: str) -> bool:
    return bool(entry_points(group=group, name=name))


def _class(module: str, name: str) -> Any:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    found = getattr(importlib.import_module(module), name, None)
    if not callable(found):
        raise ConfigError(f"{module}:{name}: the module has no class {name!r}")
    return found


def error_words(error: Exception) -> str:
    """Return kind and first line of an error."""
    return f"{type(error).__name__}: {error}".partition("\n")[0]
