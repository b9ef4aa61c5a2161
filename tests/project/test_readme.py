"""The documents match the code: commands, options, links, setups and the CI's command."""

import argparse
import re
import shlex
import tomllib
from functools import cache

import pytest
from positions import ROOT

from benchmarks.__main__ import make_parser as make_benchmark_parser
from pipelines.cli import make_parser
from pipelines.session.setup.setup_file import setup_from_table

README = (ROOT / "README.md").read_text(encoding="utf-8")
FOLDERS = ("docs", "samples")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(p for f in FOLDERS for p in (ROOT / f).rglob("*.md"))])


def blocks(text: str, language: str = "sh") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands_in(text: str, program: str = "kontur-av") -> list[list[str]]:
    """Every call of kontur-av in the code blocks of a document, as its arguments."""
    found: list[list[str]] = []
    for block in blocks(text):
        for line in block.replace("\\\n", " ").replace("&&\n", "&& ").splitlines():
            call: list[str] | None = None
            for word in shlex.split(line, comments=True):
                if word in ("&", "&&", "|", ";"):
                    call = None
                elif call is not None:
                    call.append(word)
                elif (name := word.rpartition("/")[2]) in ("kontur-av", "benchmarks"):
                    call = []
                    if name == program:
                        found.append(call)
    return found


@cache
def parsers() -> tuple[argparse.ArgumentParser, argparse.ArgumentParser]:
    """Those of kontur-av and of the benchmarks, which take long to make."""
    return make_parser(), make_benchmark_parser()


def subcommands() -> dict[str, argparse.ArgumentParser]:
    (action,) = (
        action for action in parsers()[0]._actions if isinstance(action, argparse._SubParsersAction)
    )
    return dict(action.choices)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_the_cli_accepts_every_documented_command(document):
    text = document.read_text(encoding="utf-8")
    for parser, program in zip(parsers(), ("kontur-av", "benchmarks"), strict=True):
        for arguments in commands_in(text, program):
            parser.parse_args(arguments)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_leads_to_a_file(document):
    text = document.read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text) if "://" not in link]
    missing = [link for link in links if not (document.parent / link).exists()]
    # Paths in code quotes must exist, too: kontur_av/clock.py, tests/sim/test_caps.py, ...
    paths = re.findall(r"`((?:kontur_av|telepresence|pipelines|samples|tests|docs)/[\w./]+)`", text)
    missing += [path for path in paths if not (ROOT / path).exists()]
    assert not missing


def test_the_ci_runs_the_readmes_test_command():
    (command, *_) = blocks(README.split("<!-- command: test -->\n", 1)[1])
    installed = "python3 -m venv .venv && .venv/bin/pip install -q -e '.[dev]' && .venv/bin/pytest"
    assert command.strip() == installed
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "<!-- command: test -->" in ci


def test_the_example_of_a_setup_is_one():
    text, *_ = blocks((ROOT / "docs" / "setup-file.md").read_text(encoding="utf-8"), "toml")
    setup = setup_from_table({"name": "wrist", **tomllib.loads(text)})
    assert setup.inputs[:4] == ("left", "right", "wrist", "static")
