"""Loads a radio profile by name or from a TOML file; docs/simulation.md has every field. A shell.

An error in the file is a ConfigError that names the field and the fix.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError, refused
from telepresence.link.radio.orbit import parse_elements
from telepresence.link.radio.profile import BUILT_IN, RadioProfile, built_in_radio
from telepresence.toml_file import check_known, read_toml, typed

#: Tables that `false` switches off.
_TABLES = ("bursts", "random_blackouts", "contact", "network")


def load_radio(name_or_file: str) -> RadioProfile:
    """Return a built-in profile, or the one in a TOML file; ConfigError otherwise."""
    path = Path(name_or_file)
    if path.suffix != ".toml":
        return built_in_radio(name_or_file)
    table = read_toml(path, "radio")
    with refused(f"radio {path}", ConfigError):
        return radio_from_table({"name": path.stem, **table}, path.parent)


def radio_from_table(table: Mapping[str, Any], folder: Path) -> RadioProfile:
    """Return the profile for the table of a TOML file in `folder`; ConfigError."""
    check_known(table, RadioProfile, also=("base",))
    values = dict(table)
    base = replace(BUILT_IN["cable"], description="")
    if "base" in values:
        name = values.pop("base")
        if not isinstance(name, str) or name not in BUILT_IN:
            raise ConfigError(f"base must be one of {', '.join(BUILT_IN)}, not {name!r}")
        base = BUILT_IN[name]
    inherited = asdict(base)
    for key in _TABLES:
        if values.get(key) is False:
            values[key] = None
        elif isinstance(values.get(key), Mapping):
            values[key] = {**(inherited[key] or {}), **values[key]}
    # Elements that the file does not name are inherited, and are text already.
    own = table.get("contact")
    if isinstance(own, Mapping) and isinstance(own.get("elements"), str):
        values["contact"]["elements"] = _read_elements(folder / own["elements"])
    return typed({**inherited, **values}, RadioProfile, "a radio")


def _read_elements(path: Path) -> str:
    with refused(f"cannot read elements {path}", OSError, UnicodeDecodeError):
        text = path.read_text(encoding="utf-8-sig")
    with refused(f"elements {path}", ConfigError):
        parse_elements(text)
    return text
