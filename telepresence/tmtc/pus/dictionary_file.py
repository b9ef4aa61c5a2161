"""Loads a dictionary from TOML: the built-in one, or a user's. A shell.

A table for each application, in it one for each parameter, structure, event, function and monitor,
under its name; and `[[NAME.action]]`. The fields are those of `dictionary` and `values`. A mistake
is a ConfigError of one line that names the table, the field and the fix.
"""

from collections.abc import Mapping
from dataclasses import fields
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from kontur_av.errors import ConfigError, refused
from telepresence.tmtc.pus.dictionary import (
    Action,
    Application,
    Dictionary,
    EventDefinition,
    FunctionDefinition,
    Monitor,
    Structure,
)
from telepresence.tmtc.pus.values import Parameter
from telepresence.toml_file import read_toml, typed

_Item = TypeVar("_Item", Parameter, Structure, EventDefinition, FunctionDefinition, Monitor)

_BUILT_IN = Path(__file__).with_name("dictionary.toml")
_KINDS = ("parameter", "structure", "event", "function", "monitor", "action")


@cache
def built_in_dictionary() -> Dictionary:
    """The dictionary of this project's applications."""
    return load_dictionary(_BUILT_IN)


def load_dictionary(path: Path) -> Dictionary:
    """Return the dictionary in a TOML file; ConfigError."""
    table = read_toml(path, "dictionary")
    with refused(f"dictionary {path}", ConfigError):
        return dictionary_from_table(table)


def dictionary_from_table(table: Mapping[str, Any]) -> Dictionary:
    """Return the dictionary for the table of a TOML file; ConfigError."""
    if not table:
        raise ConfigError("there is no application: begin one with [NAME] and its apid")
    return Dictionary(applications=tuple(_application(name, table[name]) for name in table))


def _application(name: str, table: object) -> Application:
    if not isinstance(table, Mapping):
        raise ConfigError(f"{name} is {table!r}: it must be a table [{name}] with an apid")
    known = {*_KINDS, "apid", "end", "text", "fresh_s"}
    for key in table:
        if key not in known:
            (nearest,) = get_close_matches(key, sorted(known), n=1, cutoff=0.0)
            raise ConfigError(f"unknown field {name}.{key}: the nearest one is {name}.{nearest}")
    apid, end, text = table.get("apid"), table.get("end", "space"), table.get("text", "")
    fresh_s = table.get("fresh_s", 0.0)
    if type(apid) is not int or not isinstance(end, str) or not isinstance(text, str):
        raise ConfigError(f"{name} needs apid, a whole number, and may have end and text in quotes")
    if type(fresh_s) is not float or fresh_s < 0:
        raise ConfigError(f"{name}.fresh_s is {fresh_s!r}: give seconds, like 15.0; 0.0 for ever")
    return Application(
        name=name,
        apid=apid,
        end=end,
        text=text,
        fresh_s=fresh_s,
        parameters=_items(f"{name}.parameter", table, Parameter),
        structures=_items(f"{name}.structure", table, Structure),
        events=_items(f"{name}.event", table, EventDefinition),
        functions=_items(f"{name}.function", table, FunctionDefinition),
        monitors=_items(f"{name}.monitor", table, Monitor),
        actions=_actions(name, table.get("action", [])),
    )


def _items(where: str, table: Mapping[str, Any], kind: type[_Item]) -> tuple[_Item, ...]:
    key = where.rpartition(".")[2]
    items = table.get(key, {})
    if not isinstance(items, Mapping):
        raise ConfigError(f"{where} must be tables [{where}.NAME]")
    return tuple(_item(f"{where}.{name}", name, items[name], kind) for name in items)


def _item(where: str, name: str, item: object, kind: type[_Item]) -> _Item:
    if not isinstance(item, Mapping):
        raise ConfigError(f"{where} must be a table [{where}]")
    if not name.isidentifier() or not name.isascii():
        raise ConfigError(f"{where}: give it a name of letters, digits and underscores")
    if "name" in item:
        raise ConfigError(f"{where}: its name is in the head of its table, leave the field out")
    try:
        return typed({"name": name, **item}, kind, where)
    except ConfigError as error:
        if str(error).startswith(where):
            raise
        raise ConfigError(f"{where}: {error}") from None


def _actions(name: str, items: object) -> tuple[Action, ...]:
    where = f"{name}.action"
    if not isinstance(items, list):
        raise ConfigError(f"{where} must be tables [[{where}]]")
    actions = []
    for item in items:
        if not isinstance(item, Mapping):
            needs = ", ".join(field.name for field in fields(Action))
            raise ConfigError(f"{where} must be tables [[{where}]] with {needs}")
        with refused(where, ConfigError):
            actions.append(typed(item, Action, where))
    return tuple(actions)
