"""A site file: the options of a session as TOML, and where each value of a session comes from.

A file wins over those that it includes, the command line over all. `false` takes back what an
included file says.
"""

import re
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from os.path import normpath
from pathlib import Path
from typing import Any, get_origin

from kontur_av.errors import ConfigError, refused
from pipelines.session.options import StreamOptions, declared, flag, hint_of, is_given, row_of
from pipelines.session.setup.setup_file import BUILT_IN, table_of_setup
from pipelines.session.setup.setup_text import setup_table
from pipelines.session.setup.table import Setup
from telepresence.toml_file import check_known, read_toml, typed
from telepresence.world import DEFAULT_SCENES

COMMAND_LINE = "command line"
#: A SPEC with the name of a file at its end.
_WITH_FILE = re.compile(r"((?:pipe|mcap):|udp:(?:\[[^\]]+\]|[^:]+):\d+:)(.+)")
_PASSWORD = re.compile(r"(?<=://)[^/@\s]*(?=@)")
#: The options that change a field of the setup, where they have another name.
_CHANGES = {
    "radio": ("radio", "radio_delay_ms"),
    "radio_delay_ms": ("radio_delay_ms", "radio"),
    "sources": ("source",),
    "tasks": (),
}

#: Of an option, and of a field of its table, such as ("setup", "axes").
Name = tuple[str, ...]


@dataclass(frozen=True)
class Setting:
    """A value, and what has set it: a file, or the command line."""

    value: Any
    origin: str


@dataclass(frozen=True)
class SiteOptions:
    """The options of a session, and by name what has set them."""

    options: StreamOptions
    settings: Mapping[Name, Setting]

    def explained(self, setup: Setup) -> str:
        """Each value and where it comes from. Options that are off, and in no file, are left out.

        setup: as the options have changed it.
        """
        rows = [row for name in declared() for row in self._option_rows(name)]
        rows += [
            (f"setup.{'.'.join(path)}", _shown(value), self._setup_origin(path, value))
            for path, value in _leaves(setup_table(setup))
            if value != {}
        ]
        wide, long = (max(len(row[at]) for row in rows if len(row[at]) < 50) for at in (0, 1))
        return "\n".join(
            f"{name:<{wide}}  {value:<{long}}  {origin}" for name, value, origin in rows
        )

    def _option_rows(self, name: str) -> Iterator[tuple[str, str, str]]:
        own = {path: setting for path, setting in self.settings.items() if path[0] == name}
        for path, setting in own.items():
            if name != "setup" or len(path) == 1:
                yield ".".join(path), _shown(setting.value), setting.origin
        if not own and is_given(self.options, name):
            yield name, _shown(getattr(self.options, name)), "default"

    def _setup_origin(self, path: Name, value: object) -> str:
        """What has set a field of the setup."""
        options = _CHANGES.get(path[0], path[:1])
        keys = [(option, *rest) for option in options for rest in (path[1:], ())]
        name, own = self.options.setup, ("setup", *path)
        in_setup = isinstance(name, str) and path in dict(_leaves(table_of_setup(name)))
        for key in [own, *keys] if path[0] == "rtc" else [*keys, own]:
            if (setting := self.settings.get(key)) and setting.value is not False:
                return setting.origin
        if path[0] == "sources" and value != DEFAULT_SCENES.get(path[1]):
            return "setup" if in_setup and name not in BUILT_IN else "robot"
        return "setup" if in_setup else "default"

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Within it, a ConfigError about a value of a site file begins with file and field."""
        try:
            yield
        except ConfigError as error:
            said = re.findall(r"[^\s=,;'\"()]*[^\s=,;'\"():]", str(error))
            about = [
                (rank, said.index(word), setting.origin, ".".join(shown))
                for path, setting in self.settings.items()
                if setting.origin != COMMAND_LINE and (len(path) == 1 or setting.value is not False)
                for rank, (word, shown) in enumerate(_words(path, setting.value))
                if word in said
            ]
            if not about:
                raise
            *_, origin, shown = min(about)
            raise ConfigError(f"{origin}: {shown}: {error}") from None


def _words(path: Name, value: object) -> Iterator[tuple[str, Name]]:
    """By which words a message is about a setting, the surest first, and what it is about."""
    yield flag(path[0]), path
    yield ".".join(path[1:]), path
    yield path[1 if path[0] == "setup" and path[1:] else -1], path
    yield path[-1], path
    yield str(value), path
    yield path[0], path[:1]


def _shown(value: object) -> str:
    """A value in one line, without the password of an address."""
    if isinstance(value, bool):
        return "on" if value else "off"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value, list | tuple):
        text = " ".join(map(str, value))
    return _PASSWORD.sub("…", text) or "on"


def site_options(args: Namespace) -> SiteOptions:
    """What the command line and its site file, if it has one, ask for; ConfigError."""
    settings: dict[Name, Setting] = {}
    if args.site is not None:
        if str(args.site) in BUILT_IN:
            raise ConfigError(f"{args.site} is a setup: give it as --setup {args.site}")
        settings = _read(args.site)
    given = {name: value for name, value in vars(args).items() if name in declared()}
    _put(settings, {path: Setting(value, COMMAND_LINE) for path, value in _paths(given)})
    site = SiteOptions(StreamOptions(), settings)
    with site.blamed():
        return SiteOptions(_options(settings, args.site), settings)


def _options(settings: Mapping[Name, Setting], site: Path | None) -> StreamOptions:
    values: dict[str, Any] = {}
    for (name, *inner), setting in settings.items():
        value = setting.value
        in_setup = name == "setup" and inner
        if value is False and not in_setup and bool not in hint_of(name):
            continue
        if not inner:
            values[name] = value
        elif not in_setup:
            text = inner[0] if value is None else f"{inner[0]}={value}"
            values[name] = (*values.get(name, ()), text)
        else:
            table = values.setdefault(name, {"name": site.stem if site else ""})
            for key in inner[:-1]:
                table = table.setdefault(key, {})
            table[inner[-1]] = value
    return StreamOptions(**values)


def _read(path: Path, including: tuple[Path, ...] = ()) -> dict[Name, Setting]:
    """The settings of a site file, and of those that it includes; ConfigError."""
    table = dict(read_toml(path, "site file"))
    names = table.pop("include", [])
    names = [names] if isinstance(names, str) else names
    settings: dict[Name, Setting] = {}
    including = (*including, path.resolve())
    with refused(path, ConfigError):
        if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
            raise ConfigError(f"include must be a file or a list of files in quotes, not {names!r}")
        files = [Path(normpath(path.parent / Path(name).expanduser())) for name in names]
        for file in files:
            if file.resolve() in including:
                raise ConfigError(f"include {file}: it includes this file; take one of them out")
            if not file.is_file():
                raise ConfigError(f"include {file}: there is no such file")
        own = {key: Setting(value, str(path)) for key, value in _checked(table, path.parent)}
    for file in files:
        _put(settings, _read(file, including))
    _put(settings, own)
    return settings


def _put(settings: dict[Name, Setting], newer: Mapping[Name, Setting]) -> None:
    """Set newer values. One of a table replaces that of the whole, and the other way round."""
    for path, setting in newer.items():
        on = setting.value is not False
        rivals = declared()[path[0]].metadata.get("rivals", ()) if on else ()
        inside = [old for old in settings if old[: len(path)] == path]
        if setting.value == {} and inside:
            continue
        for old in [*settings]:
            if old in inside or path[: len(old)] == old or old[0] in rivals:
                del settings[old]
    settings |= {
        path: setting
        for path, setting in newer.items()
        if setting.value != {} or not any(old[: len(path)] == path for old in settings)
    }


def _checked(table: Mapping[str, Any], folder: Path) -> Iterator[tuple[Name, Any]]:
    """The values of a file by name, its paths from `folder` on; ConfigError."""
    for key in table:
        if key in {one.name for one in fields(Setup)} - declared().keys():
            raise ConfigError(
                f"{key} is of a setup: write it in [setup], or give a file as --setup"
            )
        if key.startswith("no_") and key[3:] in declared():
            raise ConfigError(f"unknown field {key}: write {key[3:]} = false")
    check_known(table, StreamOptions)
    plain = {name: _plain(name, value) for name, value in table.items()}
    on = {name: value for name, value in plain.items() if value is not False}
    entry = typed(on, StreamOptions, "a site file")
    for path, value in _paths({**plain, **{name: getattr(entry, name) for name in on}}):
        yield path, _placed(path, value, folder)
    for name, value in table.items():
        if isinstance(value, Mapping) and name != "setup":
            yield from (((name, key), False) for key, one in value.items() if one is False)


def _plain(name: str, value: Any) -> Any:
    """A value of a file as the command line has it; one that does not fit stays."""
    option, kind = declared()[name], hint_of(name)[0]
    what, _ = row_of(option)
    if value is True and "bare" in option.metadata:
        return option.metadata["bare"]
    if isinstance(value, Mapping) and what.startswith("NAME="):
        for key, text in value.items():
            if not isinstance(text, str | int) or text is True:
                raise ConfigError(f"{name}.{key} must be a text in quotes, not {text!r}")
        return [f"{key}={text}" for key, text in value.items() if text is not False]
    if type(value) is int and what.endswith("PORT"):
        return str(value)
    if isinstance(value, list) and "," in what:
        return ",".join(map(str, value))
    return [value] if isinstance(value, str) and get_origin(kind) is tuple else value


def _paths(values: Mapping[str, Any]) -> Iterator[tuple[Name, Any]]:
    """Each value by its name, those of tables by field."""
    seen: set[Name] = set()
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from (((name, *path), one) for path, one in _leaves(value))
        elif value is not False and row_of(declared()[name])[0].startswith("NAME="):
            for text in value:
                key, equals, spec = text.partition("=")
                path: Name = (name, key)
                while path in seen:  # whose option may be repeated is not decided here
                    path += ("",)
                seen.add(path)
                yield path, spec if equals else None
        else:
            value = tuple(value) if isinstance(value, list) else value
            yield (name,), None if value is True and bool is not hint_of(name)[0] else value


def _leaves(table: Mapping[str, Any]) -> Iterator[tuple[Name, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from (((key, *path), one) for path, one in _leaves(value))
        else:
            yield (key,), value


def _placed(path: Name, value: Any, folder: Path) -> Any:
    """A value whose relative path begins at `folder`."""
    if isinstance(value, tuple):
        return tuple(_placed(path, one, folder) for one in value)
    if isinstance(value, Path):
        return folder / value.expanduser()
    what, _ = row_of(declared()[path[0]])
    in_setup = path[0] != "setup" or path[1:2] in ((), ("sources",), ("radio",))
    if not (isinstance(value, str) and in_setup and what.endswith(("NAME", "SPEC", "PROFILE"))):
        return value
    if match := _WITH_FILE.fullmatch(value):
        return match[1] + str(folder / Path(match[2]).expanduser())
    is_file = ":" not in value and (Path(value).suffix or "/" in value)
    return str(folder / Path(value).expanduser()) if is_file else value
