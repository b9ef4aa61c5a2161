"""A site file: the options of a session as TOML, and where each value of a session comes from.

A file wins over those that it includes, the command line over all. `false` takes back what an
included file says.
"""

import re
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_origin

from kontur_av.errors import ConfigError, refused
from pipelines.session.options import StreamOptions, declared, flag, hint_of, row_of
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
        ]
        name_width, width = (
            max(len(row[at]) for row in rows if len(row[at]) < 50) for at in (0, 1)
        )
        return "\n".join(f"{row[0]:<{name_width}}  {row[1]:<{width}}  {row[2]}" for row in rows)

    def _option_rows(self, name: str) -> Iterator[tuple[str, str, str]]:
        own = {path: one for path, one in self.settings.items() if path[0] == name}
        for path, setting in own.items():
            if name != "setup" or len(path) == 1:
                yield ".".join(path), _shown(setting.value), setting.origin
        default = declared()[name].default
        if not own and default not in (None, False, ()):
            yield name, _shown(default), "default"

    def _setup_origin(self, path: Name, value: object) -> str:
        options = [
            setting.origin
            for option in _CHANGES.get(path[0], (path[0],))
            for key in ((option, *path[1:]), (option,))
            if (setting := self.settings.get(key)) and setting.value is not False
        ]
        name, own = self.options.setup, self.settings.get(("setup", *path))
        in_setup = isinstance(name, str) and path in dict(_leaves(table_of_setup(name)))
        if options and not (path[0] == "rtc" and (own or in_setup)):
            return options[0]
        if own is not None:
            return own.origin
        if path[0] == "sources" and value != DEFAULT_SCENES.get(path[1]):
            return "setup" if in_setup and name not in BUILT_IN else f"robot {self.options.robot}"
        return "setup" if in_setup else "default"

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Within it, a ConfigError about a value of a site file begins with file and field."""
        try:
            yield
        except ConfigError as error:
            said = [word.strip("'\"()") for word in re.findall(r"[^\s=,;]+", str(error))]
            said = [word.removesuffix(":") for word in said]
            about = [
                (*rank, path, setting.origin)
                for path, setting in self.settings.items()
                if setting.origin != COMMAND_LINE
                for rank in _ranks(said, path, setting.value)
            ]
            if not about:
                raise
            *_, path, origin = min(about)
            raise ConfigError(f"{origin}: {'.'.join(path)}: {error}") from None


def _ranks(said: list[str], path: Name, value: object) -> Iterator[tuple[int, int]]:
    """How closely these words are about a setting, and where; small is near."""
    names = [
        flag(path[0]),
        ".".join(path[1:]),
        path[-1 if path[0] != "setup" else min(1, len(path) - 1)],
    ]
    for rank, word in enumerate([*names, value]):
        if word and word in said:
            yield rank, said.index(str(word))


def _shown(value: object) -> str:
    """A value in one line, without the password of an address."""
    if isinstance(value, bool):
        return "on" if value else "off"
    text = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
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
        if value is False and name != "setup" and bool not in hint_of(name):
            continue
        if not inner:
            values[name] = value
        elif name != "setup":
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
        files = [path.parent / Path(name).expanduser() for name in names]
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
        texts = {key: one for key, one in value.items() if one is not False}
        if all(isinstance(one, str | int) and one is not True for one in texts.values()):
            return [f"{key}={one}" for key, one in texts.items()]
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
    in_setup = path[:2] in (("setup", "sources"), ("setup", "radio"))
    if not isinstance(value, str) or not (in_setup or declared()[path[0]].metadata.get("spec")):
        return value
    if match := _WITH_FILE.fullmatch(value):
        return match[1] + str(folder / Path(match[2]).expanduser())
    is_file = ":" not in value and (Path(value).suffix or "/" in value)
    return str(folder / Path(value).expanduser()) if is_file else value
