"""A site file: the options of a session as TOML, and where each value of a session comes from.

A file wins over those that it includes, the command line over all. `false` takes back what an
included file says.
"""

import re
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from os.path import isfile, normpath
from pathlib import Path
from typing import Any, NamedTuple, get_origin

from kontur_av.errors import ConfigError, refused
from kontur_av.redaction import shown_spec
from pipelines.session.options import OPTIONS, StreamOptions, flag, is_given, kinds_of
from pipelines.session.setup.setup_file import BUILT_IN, table_of_setup
from pipelines.session.setup.setup_text import setup_table
from pipelines.session.setup.table import Setup
from telepresence.toml_file import check_known, read_toml, typed
from telepresence.world import DEFAULT_SCENES

COMMAND_LINE = "command line"
#: A SPEC with the name of a file at its end.
_WITH_FILE = re.compile(r"((?:pipe|mcap):|udp:(?:\[[^\]]+\]|[^:]+):\d+:)(.+)")
#: The options that change a field of the setup, if not the one of its name.
_CHANGES = {
    "radio": ("radio", "radio_delay_ms"),
    "radio_delay_ms": ("radio_delay_ms", "radio"),
    "tasks": (),
    "rtc": (),
}

_FLAGS = {field.name for field in fields(Setup) if field.type is bool}

#: Of an option, or of a field in its table, such as ("setup", "axes"); "" says that there is one.
Name = tuple[str, ...]


class Setting(NamedTuple):
    """A value, and what has set it: a file, or the command line."""

    value: Any
    origin: str


Settings = dict[Name, Setting]


class SiteOptions(NamedTuple):
    """The options of a session, and what has set them."""

    options: StreamOptions
    settings: Settings

    def explained(self, setup: Setup) -> str:
        """Each value and where it comes from. Options that are off, and in no file, are left out.

        setup: as the options have changed it.
        """
        rows = [row for name in OPTIONS for row in self._option_rows(name)]
        for name, value in _leaves(setup_table(setup)):
            if name[-1]:
                row = ".".join(("setup", *name)), _shown(value), self._setup_origin(name, value)
                rows.append(row)
        wide, long = (max(len(row[at]) for row in rows if len(row[at]) < 50) for at in (0, 1))
        return "\n".join(f"{name:<{wide}}  {value:<{long}}  {by}" for name, value, by in rows)

    def _option_rows(self, option: str) -> Iterator[tuple[str, str, str]]:
        own = {name: setting for name, setting in self.settings.items() if name[0] == option}
        for name, setting in own.items():
            if option != "setup" or len(name) == 1:
                yield ".".join(name[:2]), _shown(setting.value), setting.origin
        if not own and is_given(self.options, option):
            yield option, _shown(getattr(self.options, option)), "default"

    def _setup_origin(self, name: Name, value: object) -> str:
        """What has set a field of the setup."""
        keys: list[Name] = [(option,) for option in _CHANGES.get(name[0], name[:1])]
        if name[0] == "sources":
            keys = [("source", name[1])]
        for key in (*keys, ("setup", *name)):
            for other, setting in self.settings.items():
                if other[: len(key)] == key and setting.value is not False:
                    return setting.origin
        setup = self.options.setup
        in_setup = isinstance(setup, str) and name in dict(_leaves(table_of_setup(setup)))
        if name[0] == "sources" and value != DEFAULT_SCENES.get(name[1]):
            return "robot" if setup in BUILT_IN or not in_setup else "setup"
        return "setup" if in_setup else "default"


@contextmanager
def blamed(settings: Settings) -> Iterator[None]:
    """Within it, a ConfigError about a value of a site file begins with file and field."""
    try:
        yield
    except ConfigError as error:
        said = re.findall(r"[^\s=,;'\"()]*[^\s=,;'\"():]", str(error))
        about = [
            (rank, said.index(word), name[0] not in said, setting.origin, name)
            for name, setting in settings.items()
            if len(name) == 1 or setting.value is not False
            for rank, word in enumerate(_words(name, setting.value))
            if word in said
        ]
        rank, *_, origin, name = min(about, default=(0, COMMAND_LINE, ()))
        if origin == COMMAND_LINE:
            raise
        shown = ".".join(name if rank < 4 else name[:1])
        raise ConfigError(f"{origin}: {shown}: {error}") from None


def _words(name: Name, value: object) -> tuple[str, ...]:
    """The words by which a message is about a setting, the surest first."""
    field, text = ".".join(name[1:]), value if isinstance(value, str) else ""
    return flag(name[0]), field, field.partition(".")[0], text, name[0]


def _shown(value: object) -> str:
    """A value in one line, without the password of an address."""
    if isinstance(value, bool):
        return "on" if value else "off"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value, list | tuple):
        text = " ".join(shown_spec(str(one)) for one in value)
    return shown_spec(text) or "on"


def site_options(args: Namespace) -> SiteOptions:
    """What the command line and its site file, if it has one, ask for; ConfigError."""
    site: Path | None = args.site
    if str(site) in BUILT_IN:
        raise ConfigError(f"{site} is a setup: give it as --setup {site}")
    settings = {} if site is None else _read(site)
    given = {name: value for name, value in vars(args).items() if name in OPTIONS}
    _put(settings, {name: Setting(value, COMMAND_LINE) for name, value in _named(given)})
    with blamed(settings):
        return SiteOptions(_options(settings, site), settings)


def _named(given: Mapping[str, Any]) -> Iterator[tuple[Name, Any]]:
    """The values of the command line. Of a NAME=SPEC, its number in the option makes it unique."""
    for option, value in given.items():
        if isinstance(value, list) and _is_named(option):
            for number, text in enumerate(value):
                name, equals, spec = text.partition("=")
                yield (option, name, str(number)), spec if equals else None
        else:
            yield (option,), tuple(value) if isinstance(value, list) else value


def _options(settings: Settings, site: Path | None) -> StreamOptions:
    values: dict[str, Any] = {}
    for (option, *inner), (value, _) in settings.items():
        if inner and option == "setup":
            # A table that is taken back; flags of a setup may be false.
            if value is False and inner[0] not in _FLAGS:
                continue
            table = values.setdefault(option, {"name": site.stem if site else ""})
            for key in inner[:-1]:
                table = table.setdefault(key, {})
            table |= {inner[-1]: value} if inner[-1] else {}
        elif value is False and bool not in kinds_of(option):
            continue
        elif inner:
            text = inner[0] if value is None else f"{inner[0]}={value}"
            values[option] = (*values.get(option, ()), text)
        else:
            values[option] = value
    return StreamOptions(**values)


def _read(path: Path, including: tuple[Path, ...] = ()) -> Settings:
    """The settings of a site file, and of those that it includes; ConfigError."""
    table = dict(read_toml(path, "site file"))
    names = table.pop("include", [])
    names = [names] if isinstance(names, str) else names
    settings: Settings = {}
    including = (*including, path.resolve())
    with refused(path, ConfigError):
        if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
            raise ConfigError(f"include must be a file or a list of files in quotes, not {names!r}")
        files = [Path(normpath(path.parent / Path(name).expanduser())) for name in names]
        for file in files:
            # `Path.is_file` raises for a name that is too long.
            if not isfile(file):  # noqa: PTH113
                raise ConfigError(f"include {file}: there is no such file")
            if file.resolve() in including:
                raise ConfigError(f"include {file}: it includes this file; take one of them out")
        own = {name: Setting(value, str(path)) for name, value in _checked(table, path.parent)}
    for file in files:
        _put(settings, _read(file, including))
    _put(settings, own)
    return settings


def _put(settings: Settings, newer: Settings) -> None:
    """Set newer values. One of a table replaces that of the whole, and the other way round."""
    for name, setting in newer.items():
        rivals = () if setting.value is False else OPTIONS[name[0]].metadata.get("rivals", ())
        for old in [*settings]:
            if old[: len(name)] == name or name[: len(old)] == old or old[0] in rivals:
                del settings[old]
    settings |= newer


def _checked(table: Mapping[str, Any], folder: Path) -> Iterator[tuple[Name, Any]]:
    """The values of a file by name, its paths from `folder` on; ConfigError."""
    for key in table:
        if key in {field.name for field in fields(Setup)} - OPTIONS.keys():
            raise ConfigError(f"{key} is of a setup: write it in [setup], or give a --setup")
        if key.startswith("no_") and key[3:] in OPTIONS:
            raise ConfigError(f"unknown field {key}: write {key[3:]} = false")
    check_known(table, StreamOptions)
    plain = {}
    for option, value in table.items():
        in_setup = option == "setup"
        if isinstance(value, Mapping) and (in_setup or _is_named(option)):
            for name, leaf in _leaves(value):
                if not in_setup and (name[1:] or leaf is True or not isinstance(leaf, str | int)):
                    raise ConfigError(f"{option}.{name[0]} must be a text in quotes, not {leaf!r}")
                leaf = leaf if in_setup or leaf is False else str(leaf)
                yield (option, *name), _placed((option, *name), leaf, folder)
        elif value is False:
            yield (option,), False
        else:
            plain[option] = _plain(option, value)
    entry = typed(plain, StreamOptions, "a site file")
    for option in plain:
        yield (option,), _placed((option,), getattr(entry, option), folder)


def _is_named(option: str) -> bool:
    metavar: str = OPTIONS[option].metadata["metavar"]
    return metavar.startswith("NAME=")


def _plain(option: str, value: Any) -> Any:
    """A value of a file as the command line has it; one that does not fit stays."""
    known, kinds = OPTIONS[option].metadata, kinds_of(option)
    if value is True and kinds[0] is not bool:
        return known.get("bare", None if bool in kinds else True)
    if type(value) is int and known["metavar"].endswith("PORT"):
        return str(value)
    if isinstance(value, list) and "," in known["metavar"]:
        return ",".join(map(str, value))
    return [value] if isinstance(value, str) and get_origin(kinds[0]) is tuple else value


def _leaves(table: Mapping[str, Any]) -> Iterator[tuple[Name, Any]]:
    """Each value by its name in all tables."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from (((key, *name), leaf) for name, leaf in _leaves(value or {"": None}))
        else:
            yield (key,), value


def _placed(name: Name, value: Any, folder: Path) -> Any:
    """A value whose relative path begins at `folder`."""
    if isinstance(value, tuple):
        return tuple(_placed(name, inner, folder) for inner in value)
    if isinstance(value, Path):
        return folder / value.expanduser()
    metavar = OPTIONS[name[0]].metadata["metavar"]
    other = name[0] == "setup" and name[1:2] not in ((), ("sources",), ("radio",))
    if other or not isinstance(value, str) or not metavar.endswith(("NAME", "SPEC", "PROFILE")):
        return value
    if match := _WITH_FILE.fullmatch(value):
        return match[1] + str(folder / Path(match[2]).expanduser())
    is_file = ":" not in value and (Path(value).suffix or "/" in value)
    return str(folder / Path(value).expanduser()) if is_file else value
