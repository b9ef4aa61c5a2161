"""A radio profile by its name, or a user's own from TOML; docs/radio.md has every field.

What the file gets wrong is a ConfigError that names the field and the mend.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError
from telepresence.link.radio.contact import Contact
from telepresence.link.radio.profile import (
    BUILT_IN,
    Blackout,
    Bursts,
    RadioProfile,
    RandomBlackouts,
)

_TABLES: dict[str, type[Bursts] | type[RandomBlackouts] | type[Contact]] = {
    "bursts": Bursts,
    "random_blackouts": RandomBlackouts,
    "contact": Contact,
}

#: By the type of a field, something that has it; other fields are numbers.
_SAMPLES: dict[Any, object] = {str: "", bool: False, Path: Path()}


def load_radio(name_or_file: str) -> RadioProfile:
    """A built-in profile by its name, or a user's own from a TOML file; ConfigError otherwise."""
    if name_or_file in BUILT_IN:
        return BUILT_IN[name_or_file]
    path = Path(name_or_file)
    if path.suffix != ".toml":
        raise ConfigError(
            f"unknown radio {name_or_file}: take {', '.join(BUILT_IN)}, or a file NAME.toml"
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read radio {path}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"radio {path} is not TOML: {error}") from None
    try:
        return radio_from_table({"name": path.stem, **table}, path.parent)
    except ConfigError as error:
        raise ConfigError(f"radio {path}: {error}") from None


def delayed(profile: RadioProfile, delay_ms: float) -> RadioProfile:
    """The same profile with a fixed delay one way, in ms, whatever delay it had."""
    contact = profile.contact and replace(profile.contact, light_time=False)
    return replace(profile, delay_ms=float(delay_ms), delay_swing_ms=0.0, contact=contact)


def radio_from_table(table: Mapping[str, Any], folder: Path) -> RadioProfile:
    """A profile from the table that a TOML file in `folder` holds."""
    values = dict(table)
    base = BUILT_IN["cable"]
    if "base" in values:
        name = values.pop("base")
        if not isinstance(name, str) or name not in BUILT_IN:
            raise ConfigError(f"base must be one of {', '.join(BUILT_IN)}, not {name!r}")
        base = BUILT_IN[name]
    else:
        base = replace(base, description="")
    changes: dict[str, Any] = {}
    known = [field.name for field in fields(RadioProfile)]
    for key, value in values.items():
        if key not in known:
            raise ConfigError(_unknown(key, [*known, "base"], ""))
        if key in _TABLES:
            changes[key] = _table(key, value, getattr(base, key), folder)
        elif key == "blackouts":
            if not isinstance(value, list):
                raise ConfigError("blackouts must be tables [[blackouts]]")
            changes[key] = tuple(_made(Blackout, key, entry, {}) for entry in value)
        else:
            changes[key] = _checked(key, value, getattr(base, key))
    return replace(base, **changes)


def _table(key: str, value: object, base: Any, folder: Path) -> Any:
    if value is False:
        return None
    inherited: dict[str, Any] = {}
    if base is not None:
        inherited = {field.name: getattr(base, field.name) for field in fields(base)}
    made = _made(_TABLES[key], key, value, inherited)
    if isinstance(made, Contact):
        # The stored set has an absolute path, so it stays what it is.
        made = replace(made, elements=folder / made.elements)
    return made


def _made(kind: Any, name: str, table: object, inherited: Mapping[str, Any]) -> Any:
    """A `kind` from its table; what the table leaves out is inherited, or its default."""
    known = {field.name: field for field in fields(kind)}
    if not isinstance(table, Mapping):
        raise ConfigError(f"{name} must be a table with {', '.join(known)}")
    values = dict(inherited)
    for key, value in table.items():
        if key not in known:
            raise ConfigError(_unknown(key, list(known), f"{name}."))
        values[key] = _checked(f"{name}.{key}", value, _SAMPLES.get(known[key].type, 0.0))
    for key, field in known.items():
        if key not in values and field.default is MISSING:
            raise ConfigError(f"{name} needs {key}")
    return kind(**values)


def _checked(name: str, value: Any, sample: object) -> Any:
    """A value of the kind that `sample` has."""
    if isinstance(sample, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} must be true or false")
        return value
    if isinstance(sample, str | Path):
        if not isinstance(value, str):
            like = f', like "{sample}"' if str(sample) else ""
            raise ConfigError(f"{name} must be a text in quotes{like}")
        return type(sample)(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{name} must be a number")
    if not isfinite(value):
        raise ConfigError(f"{name} is {value}: it must be a finite number")
    return float(value)


def _unknown(key: str, known: list[str], prefix: str) -> str:
    from difflib import get_close_matches

    nearest = get_close_matches(key, known, n=1, cutoff=0.0)[0]
    return f"unknown field {prefix}{key}: the nearest one is {prefix}{nearest}"
