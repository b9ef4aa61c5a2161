"""The door for a user's parts: a class named by `module:Class`, or by an entry point's name."""

import importlib
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError


def load_part(spec: str, group: str) -> Any:
    """Return what `spec` names, made.

    spec: `module:Class`, or the name of an entry point of `group`. What follows in the form `:REST`
    is the class's one argument; without it there is none. A module is looked for in the working
    directory, too.

    Raises ConfigError if there is no such class, or if it cannot be made.
    """
    module, colon, rest = spec.partition(":")
    try:
        if colon and not _registered(module, group):
            name, _, argument = rest.partition(":")
            made = _class(module, name)
        else:
            (found,) = entry_points(group=group, name=module)
            made, argument = found.load(), rest
        return made(argument) if argument else made()
    except ConfigError:
        raise
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{spec!r}: there is no module {error.name!r}: install it, or run in its directory"
        ) from None
    except ValueError as error:
        if _registered(module, group) or colon:
            raise ConfigError(f"{spec!r} cannot be made: {error}") from error
        known = ", ".join(sorted(one.name for one in entry_points(group=group)))
        raise ConfigError(
            f"{spec!r} is unknown: write module:Class" + (f", or one of {known}" if known else "")
        ) from None
    except Exception as error:
        # The user's own code: whatever it raises is theirs to mend.
        raise ConfigError(f"{spec!r} cannot be made: {type(error).__name__}: {error}") from error


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
