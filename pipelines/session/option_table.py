"""Command-line options as rows of text."""

import argparse
import re
from pathlib import Path
from typing import Any

_TYPES = {"int": int, "float": float, "Path": Path}
#: Rows that several commands have, by their first names.
_COMMON = {
    row.split()[0].rstrip(","): row
    for row in (
        "--seconds S <float>  end after S seconds (default: on Ctrl-C)",
        "--session NAME  which one, where several run; its setup's name will do",
        "--key FILE <Path>  the private key; default: kontur-av/key.pem in the configuration "
        "directory",
        "--inbox FOLDER <Path>  take updates and orders that come here as files",
        "--raw PATH  write the decoded pictures as YUV4MPEG2 into a file or FIFO, as they come",
        "--report FILE <Path>  write the report as JSON",
        "--base-port P <int>  first of the 40 UDP ports",
        "-q, --quiet  show nothing but mistakes",
    )
}


def add_options(parser: argparse._ActionsContainer, *rows: str) -> None:
    """Add options and positional arguments to a parser, or to a group of it.

    A row is `NAMES METAVAR <KIND>  HELP`; an option without METAVAR and KIND is a flag. KIND is
    `int`, `float`, `Path`, choices as `a|b`, or nothing for text. Then come `!` if it must be
    given, `*` if it may be repeated, `?` if its value may be left out, and `=DEFAULT`. Where `?`
    is of an option, DEFAULT is what it then has. The first name alone stands for a common row.
    """
    for row in rows:
        head, _, text = _COMMON.get(row, row).partition("  ")
        head, bracket, kind = head.partition(" <")
        words = head.replace(", -", " -").split(" ")
        option = row.startswith("-")
        names = [word for word in words if word.startswith("-")] if option else words[:1]
        metavar = " ".join(words[len(names) :]) or None
        more: dict[str, Any] = {"help": text or None}
        if option and not bracket and metavar is None:
            more["action"] = "store_true"
        else:
            match = re.fullmatch(r"([^!*?=]*)([!*?]?)(?:=(.*))?", kind.removesuffix(">"))
            assert match is not None, row
            choices, how, default = match.groups()
            convert = _TYPES.get(choices, str)
            value = None if default is None else convert(default)
            more |= {"metavar": metavar, "type": _TYPES.get(choices)}
            if choices and choices not in _TYPES:
                more["choices"] = choices.split("|")
            if how == "?":
                more["nargs"] = "?"
            if value is not None:
                more["const" if how == "?" and option else "default"] = value
            if how == "!":
                more["required"] = True
            elif how == "*":
                more |= {"action": "append", "default": []}
        parser.add_argument(*names, **more)
