"""Write the types of `pipelines/seats/static/texts.js` from the texts that the server packs.

    python .ci/web/texts.py

A test checks that the file is up to date.
"""

import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from pipelines.seats import texts  # noqa: E402
from pipelines.session.mission_messages import (  # noqa: E402
    ExperimentShown,
    PanelShown,
    RobotStatus,
)
from pipelines.session.session_metrics import (  # noqa: E402
    Event,
    Figure,
    ProcessNow,
    SessionNews,
)
from pipelines.session.training import Exercises  # noqa: E402
from pipelines.study.trials import StudyFrame, StudyShown  # noqa: E402

FILE = ROOT / "pipelines" / "seats" / "static" / "texts.js"
HEAD = """/**
 * The types of the JSON texts that a seat's server and its page exchange.
 *
 * Written by .ci/web/texts.py: change what the server packs, not this file. `_us`: the session's
 * monotonic clock. `_m`: metres of the workspace.
 */
"""
#: What a server sends, and with which kind if it does not name it itself.
SENT: Mapping[type[msgspec.Struct], str] = {
    texts.HelloText: "",
    texts.StateText: "",
    SessionNews: "",
    texts.AnswerText: "",
    texts.ChatText: "",
    texts.CommandsText: "",
    texts.ValuesText: "",
    texts.EventsText: "",
    texts.RadioText: "",
    PanelShown: "panel",
    ExperimentShown: "experiment",
    RobotStatus: "robot",
    Exercises: "exercises",
    texts.UpkeepText: "upkeep",
}
#: What the server of a study sends to its own page.
OF_STUDIES = (StudyShown, StudyFrame)
#: Names that the page has for types of other rooms.
NAMES = {
    Event: "EventText",
    Exercises: "ExercisesText",
    ExperimentShown: "ExperimentText",
    PanelShown: "PanelText",
    RobotStatus: "RobotText",
    SessionNews: "FiguresText",
    ProcessNow: "ProcessText",
}
REQUESTS = (*get_args(texts.SeatRequest), texts.InputRequest)
#: Unions with a name of their own.
ALIASES = {
    "Figure": Figure,
    "Level": texts.Level,
    "Verb": get_type_hints(texts.CommandRequest)["verb"],
}
PLAIN = {
    bool: "boolean",
    int: "number",
    float: "number",
    str: "string",
    NoneType: "null",
    msgspec.Raw: "unknown",
}


def texts_js() -> str:
    """static/texts.js."""
    parts = [HEAD]
    parts += [f"/** @typedef {{{_union(hint)}}} {name} */\n" for name, hint in ALIASES.items()]
    seen: list[type[msgspec.Struct]] = []
    for struct in (*SENT, texts.WelcomeText, *OF_STUDIES):
        _visit(struct, seen)
    parts += [_typedef(struct) for struct in seen]
    names = [_name(struct) for struct in SENT]
    parts.append(f"/** @typedef {{{_broken(names)}}} ServerText */\n")
    asked = ["{" + ", ".join(_asked(request)) + "}" for request in REQUESTS]
    parts.append(
        f"/**\n * What a page may ask for.\n * @typedef {{{_broken(asked)}}} Request\n */\n"
    )
    return "\n".join(parts) + "\nexport {};\n"


def _broken(types: Sequence[str]) -> str:
    return "\n *   | ".join(types)


def _visit(struct: type[msgspec.Struct], seen: list[type[msgspec.Struct]]) -> None:
    """Add a struct behind all that it is made of."""
    for hint in get_type_hints(struct).values():
        for inner in _structs(hint):
            _visit(inner, seen)
    if struct not in seen:
        seen.append(struct)


def _structs(hint: Any) -> Iterator[type[msgspec.Struct]]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        yield hint
    for inner in get_args(hint):
        yield from _structs(inner)


def _typedef(struct: type[msgspec.Struct]) -> str:
    words = " ".join((inspect.getdoc(struct) or "").split())
    fields = ", ".join(_fields(struct))
    lines = [*_wrapped(words), *_wrapped(f"@typedef {{{{{fields}}}}} {_name(struct)}", "  ")]
    return "\n".join(["/**", *(f" * {line}" for line in lines), " */"]) + "\n"


def _fields(struct: type[msgspec.Struct]) -> Iterator[str]:
    kind = SENT.get(struct) or struct.__struct_config__.tag
    if kind is not None:
        yield f'kind: "{kind}"'
    omits = struct.__struct_config__.omit_defaults
    for field in msgspec.structs.fields(struct):
        optional = omits and not field.required
        # What is left out is never null.
        hint = _type(field.type, nullable=not optional)
        yield f"{field.encode_name}{'?' if optional else ''}: {hint}"


def _wrapped(words: str, indent: str = "") -> list[str]:
    lines = [""]
    for word in words.split():
        if len(lines[-1]) + len(word) > 95:
            lines.append(indent)
        lines[-1] += f" {word}" if lines[-1].strip() else word
    return lines


def _asked(request: type[msgspec.Struct]) -> Iterator[str]:
    """The fields of a request; its number is the connection's."""
    yield f'do: "{request.__struct_config__.tag}"'
    for field in msgspec.structs.fields(request):
        if field.name != "request":
            yield f"{field.name}{'' if field.required else '?'}: {_type(field.type)}"


def _name(struct: type[msgspec.Struct]) -> str:
    return NAMES.get(struct, struct.__name__)


def _type(hint: Any, *, nullable: bool = True) -> str:
    """The type in JavaScript of a type in Python."""
    for name, alias in ALIASES.items():
        if hint == alias:
            return name
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _type(inner[0])
    if hint in PLAIN:
        return PLAIN[hint]
    if origin in (Union, UnionType, Literal):
        return _union(hint, nullable=nullable)
    if origin is Mapping or origin is dict:
        return f"Record<string, {_type(inner[1])}>"
    if origin is tuple and inner[-1] is not ...:
        return f"[{', '.join(map(_type, inner))}]"
    if origin in (tuple, list, Sequence):
        one = _type(inner[0])
        return f"({one})[]" if "|" in one else f"{one}[]"
    if issubclass(hint, Enum):
        return " | ".join(f'"{one.value}"' for one in hint)
    return _name(hint)


def _union(hint: Any, *, nullable: bool = True) -> str:
    if get_origin(hint) is Literal:
        return " | ".join(f'"{one}"' for one in get_args(hint))
    members = [_type(one) for one in get_args(hint) if nullable or one is not NoneType]
    return " | ".join(dict.fromkeys(members))


if __name__ == "__main__":
    FILE.write_text(texts_js(), encoding="utf-8")
