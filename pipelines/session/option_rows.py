"""Options and subcommands as rows of text.

Every command imports this module, so it imports nothing of a session.
"""

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError
from kontur_av.hosts import LAST_PORT


def port(text: str) -> int:
    """Return the number of a port."""
    number = int(text)
    if not 0 < number <= LAST_PORT:
        raise argparse.ArgumentTypeError(f"no port {number}: take 1 to {LAST_PORT}")
    return number


_TYPES: dict[str, Callable[[str], Any]] = {
    "int": int,
    "float": float,
    "Path": Path,
    "port": port,
}
#: Rows that several commands have, by their first names.
COMMON_ROWS = {
    row.split()[0].rstrip(","): row
    for row in (
        "--seconds S <float>  end after S seconds (default: on Ctrl-C)",
        "--session NAME  which one of several; its setup's name will do",
        "--key FILE <Path>  the private key; default: kontur-av/key.pem in the configuration "
        "directory",
        "--joystick-map FILE.toml <Path>  which control of a game controller moves what",
        "--inbox FOLDER <Path>  take updates and orders that come here as files",
        "--raw PATH  write the decoded pictures as YUV4MPEG2 into a file or FIFO",
        "--report FILE <Path>  write the report as JSON",
        "--base-port P <int>  first of the 40 UDP ports",
        "--overwrite  replace files that exist",
        "-q, --quiet  show nothing but mistakes",
        "--token T  the bearer token that the server wants",
        "--token-file FILE <Path>  the same, hidden from other users",
        "--token-origin https://HOST <*>  another origin that gets the token after a redirect; "
        "repeatable",
        "--video SPEC  the picture to send: FILE, rtsp://HOST/PATH, pipe:PATH, v4l2:DEVICE or "
        "scene:NAME",
        "--audio SPEC  the voice to send: FILE, pipe:PATH, alsa:DEVICE or scene:NAME",
        "--size WxH <=640x480>  default: 640x480",
        "--fps N <float=30>  like 29.97 (default: 30)",
        "--video-kbps K <float=1500.0>  of the picture, or what the partner can take (default: "
        "1500)",
        "--voice-kbps K <float=32.0>  of the voice (default: 32)",
        "--save FILE.mkv  write the picture as it comes",
        "--save-voice FILE.mka  write the voice as it comes",
        "--recode  code the recorded pictures anew, by the session's encoder",
        "--cap-kbps STREAM=KBPS <*>  another cap for a replayed stream, like uplink_video=60; "
        "repeatable",
    )
}


def add_options(parser: argparse._ActionsContainer, *rows: str) -> None:
    """Add options and positional arguments to a parser, or to a group of it.

    A row is `NAMES METAVAR <KIND>  HELP`; an option without METAVAR and KIND is a flag. KIND is
    `int`, `float`, `port`, `Path`, choices as `a|b`, or nothing for text. Then come `!` if it must
    be given, `*` if it may be repeated, `?` if its value may be left out, `...` for any number of
    values, and `=DEFAULT`. Where `?` is of an option, DEFAULT is what it then has. The first name
    alone stands for a common row.
    """
    for row in rows:
        head, _, text = COMMON_ROWS.get(row, row).partition("  ")
        head, bracket, kind = head.partition(" <")
        words = head.replace(", -", " -").split(" ")
        option = row.startswith("-")
        names = [word for word in words if word.startswith("-")] if option else words[:1]
        metavar = " ".join(words[len(names) :]) or None
        if option and not bracket and metavar is None:
            parser.add_argument(*names, action="store_true", help=text)
            continue
        match = re.fullmatch(r"([^!*?.=]*)([!*?]|\.{3})?(?:=(.*))?", kind.removesuffix(">"))
        assert match is not None, row
        what, how, default = match.groups()
        convert = _TYPES.get(what)
        choices = what.split("|") if what and convert is None else None
        value = convert(default) if convert is not None and default is not None else default
        add = partial(
            parser.add_argument,
            *names,
            metavar=metavar,
            type=convert or str,
            choices=choices,
            help=text or None,
        )
        if how == "!":
            add(required=True)
        elif how == "*":
            add(action="append", default=[])
        elif how == "?" and option:
            add(nargs="?", const=value)
        else:
            add(nargs="*" if how == "..." else how, default=value)


def add_actions(
    parser: argparse.ArgumentParser, actions: Mapping[str, Sequence[str]], kind: str = "action"
) -> dict[str, argparse.ArgumentParser]:
    """Add subcommands, each with a text and rows of options; return the parser of each."""
    found = parser.add_subparsers(dest=kind, required=True, metavar=kind.upper())
    parsers = {}
    for name, (text, *rows) in actions.items():
        parsers[name] = found.add_parser(name, help=text, description=text)
        add_options(parsers[name], *rows)
    return parsers


def refuse_options(args: object, why: str, *options: str) -> None:
    """Raise ConfigError for the first of these options that is given. why: follows its name."""
    for option in options:
        if getattr(args, option) not in (None, False, [], ()):
            raise ConfigError(f"--{option.replace('_', '-')}{why}")
