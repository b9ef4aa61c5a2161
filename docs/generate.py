"""Write what documents take from the code.

    python docs/generate.py            docs/python.md, from the docstrings of what is exported, and
                                       the tables of commands, processes, topics and ports
    python docs/generate.py --run      the README's table, too: a session of 20 s on virtual time

Tests check that all but the README's table is up to date. griffe reads source text, so the page is
the same under every Python version.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import griffe

from pipelines.bench.result import Headline
from pipelines.cli import make_parser
from pipelines.recording.channels import channels_table, fields_table
from pipelines.report.keys import counts_table, keys_tables
from pipelines.report.model import LinkReport, SessionReport
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.topology import tables, topology_of

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("kontur_av", "telepresence", "pipelines")
HEAD = """# The Python interface

<!-- Written by docs/generate.py from the docstrings: change those, not this page. -->

These names are for users of the library. Import them from the package: `from kontur_av import ...`.
Other modules are the project's own and may change. Instants are integer nanoseconds of one clock,
`now_ns`. `samples/` has short scripts that use these names.
"""
STREAM = "| {name} | {cap} | {mean:.1f} | {most:.1f} | {shown} | {lost} | {p50:.1f} | {p99:.1f} |"


def python_page() -> str:
    """docs/python.md: every exported name with its signature and docstring."""
    parts = [HEAD]
    for package in PACKAGES:
        module = griffe.load(
            package, search_paths=[ROOT], resolve_aliases=True, try_relative_path=False
        )
        names = sorted(exported(module), key=lambda name: (name.lower(), name))
        parts.append(f"## `{package}`\n\n{text(module)}\n")
        if names:
            links = ", ".join(f"[{name}](#{anchor(name)})" for name in names)
            parts.append(f"{links}\n")
        parts += [entry(module[name]) for name in names]
    return "\n".join(parts)


def exported(module: griffe.Object | griffe.Alias) -> list[str]:
    return [str(name).strip("'\"") for name in module.exports or ()]


def anchor(name: str) -> str:
    """The fragment that GitHub makes of a heading."""
    return re.sub(r"[^\w -]", "", name.lower()).replace(" ", "-")


def entry(member: griffe.Object | griffe.Alias) -> str:
    """One exported name: its signature, its docstring, and its public methods."""
    if member.is_attribute:
        code = f"{member.name} = {member.value}"
        return f"### {member.name}\n\n```python\n{code}\n```\n\n{text(member)}\n"
    lines = [f"### {member.name}\n\n```python"]
    if member.is_function:
        lines += [signature(member), "```\n", text(member), ""]
        return "\n".join(lines)
    bases = ", ".join(str(base) for base in member.bases)
    lines.append(f"class {member.name}({bases}):" if bases else f"class {member.name}:")
    public = {
        name: found
        for name, found in {**member.inherited_members, **member.members}.items()
        if name == "__init__" or not name.startswith("_")
    }
    init = public.pop("__init__", None)
    own_init = init is not None and init.is_function and "dataclass" not in member.labels
    for name, found in public.items():
        if own_init or not found.is_attribute or "property" in found.labels:
            continue
        kind = f": {found.annotation}" if found.annotation else ""
        default = f" = {found.value}" if found.value is not None else ""
        # Quotes as ruff would set them: it checks the page, too.
        lines.append(f"    {name}{kind}{default}".replace("'", '"'))
    if own_init:
        lines.append("    " + signature(init).replace("\n", "\n    "))
    lines += ["```\n", text(member), ""]
    for name, found in public.items():
        if found.is_function:
            lines.append(f"- `{name}{arguments(found)}`: {one_paragraph(found)}")
        elif "property" in found.labels:
            lines.append(f"- `{name}: {found.annotation}`: {one_paragraph(found)}")
    return "\n".join(lines).rstrip() + "\n"


def arguments(function: griffe.Object | griffe.Alias) -> str:
    """`(x: int) -> str` as it stands in the source, without self, on one line."""
    shown = " ".join(function.signature(return_type=True).split())
    return re.sub(r"^\((?:self|cls)(?:, )?", "(", shown[shown.index("(") :])


def signature(function: griffe.Object | griffe.Alias) -> str:
    line = f"def {function.name}{arguments(function)}"
    if len(line) <= 96:
        return line
    names, _, result = arguments(function).rpartition(") -> ")
    inner = ",\n    ".join(_split(names.removeprefix("(")))
    return f"def {function.name}(\n    {inner},\n) -> {result}"


def _split(parameters: str) -> list[str]:
    """Split at the commas that stand within no bracket."""
    parts, depth = [""], 0
    for letter in parameters:
        depth += (letter in "[({") - (letter in "])}")
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def text(found: griffe.Object | griffe.Alias) -> str:
    """The docstring; its example after `Use::` becomes a block of Python."""
    docstring = found.docstring.value if found.docstring else ""
    docstring = listed(docstring, names_of(found))
    body = re.sub(
        r"(\w+)::\n\n((?:    .*\n?|\n)+)",
        lambda match: f"{match[1]}:\n\n```python\n{_dedent(match[2])}\n```\n",
        docstring,
    )
    return body.strip()


def names_of(found: griffe.Object | griffe.Alias) -> set[str]:
    """What a docstring may explain: the parameters of a function, the fields of a class."""
    names = set()
    if found.is_class:
        names |= {name for name, member in found.all_members.items() if member.is_attribute}
        init = found.all_members.get("__init__")
        names |= {parameter.name for parameter in init.parameters} if init is not None else set()
    elif found.is_function:
        names |= {parameter.name for parameter in found.parameters}
    return names


def listed(docstring: str, names: set[str]) -> str:
    """Lines `name: text`, with their indented continuations, as items of a list."""
    lines: list[str] = []
    item = False
    for line in docstring.splitlines():
        begin = re.match(r"((?:\w+, )*\w+): ", line)
        if begin and names.issuperset(begin[1].split(", ")):
            told = ", ".join(f"`{name}`" for name in begin[1].split(", "))
            if not item and lines and lines[-1]:
                lines.append("")
            lines.append(f"- {told}: {line[begin.end() :]}")
            item = True
        elif item and line:
            lines.append(f"  {line.strip()}")
        else:
            item = False
            lines.append(line)
    return "\n".join(lines)


def _dedent(block: str) -> str:
    return "\n".join(line.removeprefix("    ") for line in block.rstrip().splitlines())


def one_paragraph(found: griffe.Object | griffe.Alias) -> str:
    return " ".join(found.docstring.value.split()) if found.docstring else ""


def run_table() -> str:
    """The README's table of one session, by `kontur-av simulate`."""
    command = ["simulate", "--setup", "spacejustin", "--seconds", "20", "--radio", "clean"]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "r.json"
        command += ["--seed", "1", "--report", str(file), "-q"]
        subprocess.run([sys.executable, "-m", "pipelines.cli", *command], check=True, cwd=ROOT)
        report = json.loads(file.read_text(encoding="utf-8"))
    rows = [
        "| stream | cap | mean | max 1 s | shown/s | lost | p50 | p99 |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name, stream in report["streams"].items():
        rows.append(
            STREAM.format(
                name=name,
                cap=stream["cap_bps"] // 1000,
                mean=stream["payload_bps_mean"] / 1000,
                most=stream["payload_bps_max_1s"] / 1000,
                shown=f"{stream['displayed_hz']:.1f}",
                lost=stream["rtp_lost"],
                p50=stream["latency_ms"]["p50"],
                p99=stream["latency_ms"]["p99"],
            )
        )
    for name, way in report["haptic"].items():
        latency = way["latency_ms"]
        shown = round(way["received"] / report["seconds"])
        row = f"| haptic_{name} | 96 | 96.0 | | {shown} | {way['lost']} |"
        rows.append(f"{row} {latency['p50']:.1f} | {latency['p99']:.1f} |")
    return "\n".join(rows) + "\n"


def commands_text() -> str:
    """Every command with its arguments and options, from the parsers."""
    return "\n".join(_command_texts(make_parser(), "kontur-av")).strip() + "\n"


def _command_texts(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, inner in action.choices.items():
                heading = "#" * (1 + len(name.split()))
                yield f"{heading} `{name} {word}`\n\n{_sentence(inner.description)}\n"
                yield from _options_table(inner)
                yield from _command_texts(inner, f"{name} {word}")


def _options_table(parser: argparse.ArgumentParser) -> Iterator[str]:
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction | argparse._HelpAction):
            continue
        value = action.metavar or ("|".join(map(str, action.choices)) if action.choices else "")
        if isinstance(value, tuple):
            value = " ".join(value)
        words = ", ".join(action.option_strings) or str(value)
        shown = f"{words} {value}".strip() if action.option_strings else words
        told = " ".join((action.help or "").split()).replace("%%", "%").replace("|", "\\|")
        rows.append("| `" + shown.replace("|", "\\|") + f"` | {told} |")
    if rows:
        yield "| | |\n|---|---|\n" + "\n".join(rows) + "\n"


def _sentence(text: str | None) -> str:
    told = (text or "").strip()
    return f"{told[:1].upper()}{told[1:]}" + ("" if told.endswith(".") else ".")


def topology_blocks() -> dict[str, str]:
    """By name: what stands between `<!-- generated: NAME -->` and `<!-- /generated -->`."""
    session = topology_of(load_setup("spacejustin"), snapshots=True, pages=True, recorder=True)
    processes = tables.processes_table(session)
    for heading in ("priority", "reads", "writes"):
        processes = processes.without(heading)
    topics = tables.topics_table(session)
    channels = tables.channels_table(session, topology_of(load_setup("taskboard")))
    return {
        "commands": commands_text(),
        "processes": tables.in_code(processes, "process").markdown(),
        "topics": tables.in_code(topics, "topic", "writer", "readers").markdown(),
        "ports": tables.ports_table(session).markdown(),
        "channels": channels.markdown(),
        "recorded channels": channels_table(session).markdown(),
        "recorded fields": fields_table().markdown(),
        "report": keys_tables(SessionReport),
        "link report": keys_tables(LinkReport, without=SessionReport),
        "headlines": keys_tables(Headline),
        "counts": counts_table(),
    }


def filled(document: str, blocks: dict[str, str]) -> str:
    """The document with these blocks in it."""
    for name, block in blocks.items():
        marks = rf"(<!-- generated: {name} -->\n).*?(<!-- /generated -->)"
        document = re.sub(marks, lambda m, b=block: f"{m[1]}{b}{m[2]}", document, flags=re.DOTALL)
    return document


def main() -> None:
    (ROOT / "docs" / "python.md").write_text(python_page(), encoding="utf-8")
    blocks = topology_blocks()
    for page in sorted((ROOT / "docs").glob("*.md")):
        page.write_text(filled(page.read_text(encoding="utf-8"), blocks), encoding="utf-8")
    if sys.argv[1:] == ["--run"]:
        readme = ROOT / "README.md"
        marks = r"(<!-- generated: run -->\n).*?(<!-- /generated -->)"
        table = run_table()
        new = re.sub(marks, lambda m: f"{m[1]}{table}{m[2]}", readme.read_text(), flags=re.DOTALL)
        readme.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
