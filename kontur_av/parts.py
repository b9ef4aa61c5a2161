"""The door for a user's parts: a class named by `module:Class`, or by an entry point's name."""

import importlib
import re
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError

_NAMED = re.compile(r"(?P<module>[^\W\d][\w.]*):(?P<name>[^\W\d]\w*)(:(?P<argument>.*))?")


def names_part(spec: str, group: str) -> bool:
    """Whether `spec` has the form `module:Class`, or begins with an entry point's name."""
    return _NAMED.fullmatch(spec) is not None or _registered(spec.partition(":")[0], group)


def find_part(spec: str, group: str) -> tuple[Any, tuple[str, ...]]:
    """Return the class that `spec` names, and its last arguments: what follows as `:TEXT`, if so.

    spec: `module:Class`, or the name of an entry point of `group`. A module is looked for in the
    working directory, too.

    Raises ConfigError if there is no such class.
    """
    first, _, rest = spec.partition(":")
    named = _NAMED.fullmatch(spec)
    try:
        if _registered(first, group):
            (entry,) = entry_points(group=group, name=first)
            return entry.load(), (rest,) if rest else ()
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
        # The user's own code: whatever it raises is theirs to mend.
        raise ConfigError(f"{spec!r} cannot be loaded: {_words(error)}") from error
    known = ", ".join(sorted(one.name for one in entry_points(group=group)))
    raise ConfigError(
        f"{spec!r} is unknown: write module:Class" + (f", or one of {known}" if known else "")
    )


def make_part(spec: str, group: str, *arguments: Any) -> Any:
    """Return what `spec` names, made with these arguments and the one that stands in it.

    Raises ConfigError if there is no such class, or if it cannot be made.
    """
    made, last = find_part(spec, group)
    try:
        return made(*arguments, *last)
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(f"{spec!r} cannot be made: {_words(error)}") from error


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


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".partition("\n")[0]
