"""Write the tables of what tests cover: `python tests/tables.py`.

rules.md: each rule of CONTRIBUTING.md and docs/safety.md, and the tests that verify it.
commands.md: each command and each option, and the test files that use it.
"""

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
#: The number of test files that a row names.
MOST_NAMED = 3


@cache
def test_files() -> dict[Path, ast.Module]:
    """Every test file, parsed."""
    return {file: _parsed(file) for file in sorted(TESTS.rglob("test_*.py"))}


@cache
def _parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def _name(file: Path) -> str:
    return file.relative_to(TESTS).as_posix()


def _written(title: str, heads: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [f"# {title}", "", "Written by `python tests/tables.py`.", ""]
    lines += [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows), ""])


# Rules


def rules() -> dict[str, str]:
    """The first sentence of each numbered rule, by its number."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text[text.index("## Rules that hold") :].partition("\n## ")[0]
    found = dict(re.findall(r"^(\d+)\. (.+?\.)(?=\s|$)", section, re.MULTILINE | re.DOTALL))
    safety = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    found |= dict(re.findall(r"^\| (S\d+) \| (.+?) \|", safety, re.MULTILINE))
    return {number: " ".join(words.split()) for number, words in found.items()}


def tests_of_rules() -> dict[str, list[str]]:
    """The tests with the marker `rule`, by the rule's number."""
    found: dict[str, list[str]] = {}
    for file, tree in test_files().items():
        for node in tree.body:
            marks = [*getattr(node, "decorator_list", ())]
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
                marks += node.value.elts if isinstance(node.value, ast.List) else [node.value]
            for mark in marks:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.rule":
                    test = f"{_name(file)}::{node.name}" if hasattr(node, "name") else _name(file)
                    for number in mark.args:
                        found.setdefault(ast.literal_eval(number), []).append(test)
    return found


def rules_table() -> str:
    verified = tests_of_rules()
    rows = (
        (number, words, "<br>".join(f"`{test}`" for test in verified.get(number, ())))
        for number, words in rules().items()
    )
    heads = ("rule", "what holds", "verified by")
    return _written("Rules and the tests that verify them", heads, rows)


# Commands and options


@cache
def commands() -> dict[tuple[str, ...], list[tuple[str, ...]]]:
    """The options of each command, each with its long and short form, by the command's words."""
    sys.path.insert(0, str(ROOT))
    from pipelines.cli import make_parser

    return dict(_commands(make_parser(), ()))


def _commands(
    parser: argparse.ArgumentParser, words: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], list[tuple[str, ...]]]]:
    options = []
    below = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            below += action.choices.items()
        elif (
            action.option_strings
            and not action.dest.startswith("help")
            and action.help != argparse.SUPPRESS
        ):
            options.append(tuple(action.option_strings))
    if words and (options or not below):
        yield words, options
    for word, one in below:
        yield from _commands(one, (*words, word))


@cache
def _words(file: Path) -> tuple[str, ...]:
    """The words of all texts in a file, in their order."""
    texts = [
        (node.lineno, node.col_offset, node.value)
        for node in ast.walk(_parsed(file))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    found = []
    for _, _, text in sorted(texts):
        if len(text) < 2_000:
            found += [word.partition("=")[0] for word in text.split()]
    return tuple(found)


@cache
def _with_helpers(file: Path) -> tuple[tuple[str, ...], ...]:
    """The words of a test file, and of each helper that it imports."""
    names = set()
    for node in ast.walk(_parsed(file)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    helpers = (TESTS / "helpers" / f"{name}.py" for name in sorted(names))
    near = [helper for helper in (file.parent / "conftest.py", *helpers) if helper.exists()]
    return tuple(_words(one) for one in (file, *near))


@cache
def tests_of_commands() -> dict[str, list[Path]]:
    """The test files that run a command."""
    return {
        " ".join(words): [
            file
            for file in test_files()
            if any({*words} <= {*text} for text in _with_helpers(file))
        ]
        for words in commands()
    }


@cache
def tests_of_options() -> dict[str, tuple[list[str], list[Path]]]:
    """The commands that have an option, and the test files that use it with one of them."""
    found: dict[str, tuple[list[str], list[Path]]] = {}
    for words, options in commands().items():
        command = " ".join(words)
        for forms in options:
            owners, users = found.setdefault(forms[-1], ([], []))
            owners.append(command)
            users += (
                file
                for file in tests_of_commands()[command]
                if file not in users
                and any(form in text for text in _with_helpers(file) for form in forms)
            )
    return dict(sorted(found.items()))


def _files(files: list[Path]) -> str:
    return ", ".join(_name(file) for file in files[:MOST_NAMED])


def commands_table() -> str:
    # Without their number, which every test changes.
    rows = ((f"`{command}`", _files(files)) for command, files in tests_of_commands().items())
    heads = ("command", "tests, such as")
    return _written("Commands and their tests", heads, rows)


def options_table() -> str:
    rows = (
        (f"`{option}`", ", ".join(owners), _files(files))
        for option, (owners, files) in tests_of_options().items()
    )
    heads = ("option", "of", "tests, such as")
    return _written("Options and their tests", heads, rows)


TABLES = {
    TESTS / "rules.md": rules_table,
    TESTS / "commands.md": lambda: commands_table() + "\n" + options_table(),
}


if __name__ == "__main__":
    for path, make in TABLES.items():
        path.write_text(make(), encoding="utf-8")
