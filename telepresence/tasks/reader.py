"""Reads tasks from XML. A mistake is a ConfigError with its line, the element and the fix.

`tasks.xsd` describes the same format for editors. What a schema cannot say is checked here, too:
references, and that operations fit their place. There is no document type, so no entity can be
declared: nothing outside of the file is read.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from difflib import get_close_matches
from enum import StrEnum
from typing import Any, get_type_hints
from xml.parsers import expat

from kontur_av.errors import ConfigError
from telepresence.tasks.definitions import (
    ELEMOPS,
    MOVING_MODES,
    Catalogue,
    Elemop,
    MoveTo,
    Operation,
    Pattern,
    SetMode,
    SetPower,
    Show,
    StartLog,
    Task,
)
from telepresence.xml_file import parse_xml

MAX_FILE_OCTETS = 1 << 18
MAX_STEPS = 200
MAX_TEXT_OCTETS = 128

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)")
_SPACE = " \t\r\n"
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_ROOT, _OPERATION, _TASK, _STEP = "Tasks", "Operation", "Task", "Elemop"
_TASK_FIELDS = ("name", "start", "exec", "start_x_mm", "start_y_mm", "text")


def read_tasks(octets: bytes, base: Catalogue | None = None) -> Catalogue:
    """Return what the XML in `octets` defines, together with all of `base`; ConfigError.

    A name may be used once, also if `base` has it.
    """
    if len(octets) > MAX_FILE_OCTETS:
        raise ConfigError(f"{len(octets)} octets: a file of tasks has at most {MAX_FILE_OCTETS}")
    base = base or Catalogue()
    reader = _Reader(Catalogue(dict(base.elemops), dict(base.operations), dict(base.tasks)))
    parser = expat.ParserCreate()
    parser.StartElementHandler = reader.handle_start
    parser.EndElementHandler = reader.handle_end
    parser.CharacterDataHandler = reader.handle_text
    parser.StartDoctypeDeclHandler = reader.handle_document_type
    reader.line = lambda: parser.CurrentLineNumber
    parse_xml(parser, octets)
    return reader.catalogue


class _Reader:
    """Takes the elements as they come; definitions come before their use."""

    def __init__(self, catalogue: Catalogue) -> None:
        self.catalogue = catalogue
        self.line: Callable[[], int] = lambda: 0
        self._open: list[str] = []
        self._operation = ""
        self._steps: list[Elemop] = []

    def handle_document_type(self, *_: object) -> None:
        raise self._mistake("a document type is not allowed: leave out <!DOCTYPE ...>")

    def handle_text(self, text: str) -> None:
        if text.strip(_SPACE):
            raise self._mistake(f"text {text.strip()[:20]!r}: all values are attributes")

    def handle_start(self, element: str, attributes: dict[str, str]) -> None:
        position = self._open[-1] if self._open else ""
        self._open.append(element)
        if not position:
            self._check_root(element, attributes)
        elif position == _ROOT:
            self._define(element, attributes)
        elif position == _OPERATION and len(self._open) == 3:
            self._add_steps(element, attributes)
        else:
            raise self._mistake(f"<{element}> cannot be inside of <{position}>")

    def handle_end(self, element: str) -> None:
        if element == _OPERATION and len(self._open) == 2:
            if not self._steps:
                raise self._mistake(f'<Operation name="{self._operation}"> needs an <Elemop>')
            steps = tuple(self._steps)
            self.catalogue.operations[self._operation] = Operation(self._operation, steps)
        self._open.pop()

    def _check_root(self, element: str, attributes: dict[str, str]) -> None:
        if element != _ROOT:
            raise self._mistake(f"<{element}>: the outermost element is <{_ROOT}>")
        for key in attributes:
            if key != "xmlns:xsi" and not key.startswith("xsi:"):
                raise self._mistake(f"<{_ROOT}> has no attribute {key}: leave it out")

    def _define(self, element: str, attributes: dict[str, str]) -> None:
        if element == _OPERATION:
            self._check_keys(element, attributes, ("name",))
            self._operation = self._new_name(element, attributes, self.catalogue.operations)
            self._steps = []
        elif element == _TASK:
            self._define_task(attributes)
        elif element in ELEMOPS:
            elemop = self._elemop(ELEMOPS[element], attributes)
            self.catalogue.elemops[elemop.name] = elemop
        else:
            known = (*ELEMOPS, _OPERATION, _TASK)
            raise self._mistake(f"unknown element <{element}>{_nearest(element, known, '<', '>')}")

    def _add_steps(self, element: str, attributes: dict[str, str]) -> None:
        """`<Elemop ref="..."/>` or `<Operation ref="..."/>` within an operation."""
        kinds: dict[str, Mapping[str, Any]] = {
            _STEP: self.catalogue.elemops,
            _OPERATION: self.catalogue.operations,
        }
        if element not in kinds:
            raise self._mistake(
                f'<{element}> in an operation: refer to it with <Elemop ref="..."/>'
            )
        self._check_keys(element, attributes, ("ref",))
        ref, known = attributes["ref"], kinds[element]
        if ref not in known:
            raise self._mistake(
                f"<{element} ref={ref!r}>: it is not defined above{_nearest(ref, known)}"
            )
        found = known[ref]
        self._steps += found.elemops if isinstance(found, Operation) else (found,)
        if len(self._steps) > MAX_STEPS:
            raise self._mistake(f"more than {MAX_STEPS} Elemops in {self._operation}: split it")

    def _define_task(self, attributes: dict[str, str]) -> None:
        self._check_keys(_TASK, attributes, _TASK_FIELDS)
        name = self._new_name(_TASK, attributes, self.catalogue.tasks)
        at = f'<Task name="{name}">'
        found: dict[str, Operation] = {}
        for key in ("start", "exec"):
            ref, known = attributes[key], self.catalogue.operations
            if ref not in known:
                raise self._mistake(
                    f"{at}: {key} is {ref!r}, which is not defined above{_nearest(ref, known)}"
                )
            found[key] = known[ref]
        text = attributes["text"]
        if not text.isprintable() or not 0 < len(text.encode()) <= MAX_TEXT_OCTETS:
            raise self._mistake(
                f"{at}: text has {len(text.encode())} octets: give one line of 1 to "
                f"{MAX_TEXT_OCTETS}"
            )
        start_x_mm = self._number(at, "start_x_mm", attributes["start_x_mm"], -150, 150)
        start_y_mm = self._number(at, "start_y_mm", attributes["start_y_mm"], -100, 100)
        task = Task(name=name, start_x_mm=start_x_mm, start_y_mm=start_y_mm, text=text, **found)
        self._check_operations(at, task)
        self.catalogue.tasks[name] = task

    def _check_operations(self, at: str, task: Task) -> None:
        """The robot must be able to move where the operations move it."""
        mode = None
        for elemop in (*task.start.elemops, *task.exec.elemops):
            if isinstance(elemop, SetMode):
                mode = elemop.mode
            elif isinstance(elemop, MoveTo) and mode not in MOVING_MODES:
                raise self._mistake(
                    f"{at}: {elemop.name} moves the robot: choose position or impedance control "
                    "before it"
                )
        last_power = [op.on for op in task.exec.elemops if isinstance(op, SetPower)][-1:]
        if last_power != [False]:
            raise self._mistake(f"{at}: {task.exec.name} leaves the robot on: end it by powerOff")
        moves = [op for op in task.start.elemops if isinstance(op, MoveTo)][-1:]
        if not any((op.x_mm, op.y_mm) == (task.start_x_mm, task.start_y_mm) for op in moves):
            raise self._mistake(
                f"{at}: {task.start.name} must move the tip to start_x_mm and start_y_mm, so that "
                "it does not jump to the handle"
            )
        starts = [op for op in task.exec.elemops if isinstance(op, StartLog)]
        if starts:
            raise self._mistake(f"{at}: {starts[0].name} belongs into {task.start.name}")

    def _elemop(self, kind: type[Elemop], attributes: dict[str, str]) -> Elemop:
        element = kind.__name__
        known = fields(kind)
        needed = tuple(
            each.name
            for each in known
            if each.default is MISSING and each.default_factory is MISSING
        )
        optional = tuple(each.name for each in known if each.name not in needed)
        self._check_keys(element, attributes, needed, optional)
        name = self._new_name(element, attributes, self.catalogue.elemops)
        at, hints = f'<{element} name="{name}">', get_type_hints(kind)
        values: Any = {"name": name}
        for each in known:
            if each.name != "name" and each.name in attributes:
                given = attributes[each.name]
                values[each.name] = self._value(
                    at, each.name, given, hints[each.name], each.metadata
                )
        made = kind(**values)
        if isinstance(made, Show) and bool(made.leds) != (made.pattern is Pattern.LEDS):
            raise self._mistake(f'{at}: give leds="0", or another pattern than leds')
        return made

    def _value(self, at: str, key: str, given: str, hint: Any, limits: Any) -> Any:
        if hint is bool:
            if given.strip(_SPACE) not in _BOOLEANS:
                raise self._mistake(f"{at}: {key} is {given!r}: give true or false")
            return _BOOLEANS[given.strip(_SPACE)]
        if hint is str:
            if not _NAME.fullmatch(given):
                raise self._mistake(f"{at}: {key} is {given!r}: give a name of letters and digits")
            return given
        if isinstance(hint, type) and issubclass(hint, StrEnum):
            if given not in set(hint):
                raise self._mistake(f"{at}: {key} is {given!r}: choose one of {', '.join(hint)}")
            return hint(given)
        least, most = limits["least"], limits["most"]
        if hint is float:
            return self._number(at, key, given, least, most)
        words = given.split()
        single = hint is int
        fits = all(word.isdecimal() and word.isascii() and int(word) <= most for word in words)
        if not words or not fits or (single and len(words) > 1) or len(words) > 8:
            what = "a whole number" if single else "one to eight whole numbers"
            raise self._mistake(f"{at}: {key} is {given!r}: give {what} from {least} to {most}")
        return int(words[0]) if single else tuple(map(int, words))

    def _number(self, at: str, key: str, given: str, least: float, most: float) -> float:
        text = given.strip(_SPACE)
        if not _NUMBER.fullmatch(text) or not least <= float(text) <= most:
            raise self._mistake(f"{at}: {key} is {given!r}: give a number from {least} to {most}")
        return float(text)

    def _new_name(self, element: str, attributes: dict[str, str], known: Mapping[str, Any]) -> str:
        name = attributes["name"]
        if not _NAME.fullmatch(name):
            raise self._mistake(
                f"<{element} name={name!r}>: give up to 32 letters and digits, a letter first"
            )
        if name in known:
            raise self._mistake(f'<{element} name="{name}">: this name is taken: choose another')
        return name

    def _check_keys(
        self,
        element: str,
        attributes: dict[str, str],
        needed: tuple[str, ...],
        optional: tuple[str, ...] = (),
    ) -> None:
        name = attributes.get("name", "")
        at = f'<{element} name="{name}">' if name else f"<{element}>"
        for key in attributes:
            if key not in needed and key not in optional:
                nearest = _nearest(key, (*needed, *optional))
                raise self._mistake(f"{at}: unknown attribute {key}{nearest}")
        missing = [key for key in needed if key not in attributes]
        if missing:
            raise self._mistake(f"{at} needs {' and '.join(missing)}")

    def _mistake(self, what: str) -> ConfigError:
        return ConfigError(f"line {self.line()}: {what}")


def _nearest(name: str, known: Any, before: str = "", after: str = "") -> str:
    found = get_close_matches(name, list(known), n=1, cutoff=0.0)
    return f": the nearest one is {before}{found[0]}{after}" if found else ""
