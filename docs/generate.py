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
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import griffe
from report_keys import counts_table, keys_tables
from user_tables import holds_table, keys_table, pages_list

from pipelines.cli import make_parser
from pipelines.recording.channels import channels_of
from pipelines.recording.recorded_messages import SCHEMAS
from pipelines.recording.schemas import MessageSchema
from pipelines.report.model import LinkReport, SessionReport
from pipelines.report.result import Headline
from pipelines.session.setup.segments import Direction
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.topology import tables
from pipelines.session.topology.table import Topology
from pipelines.table import topology_of

ROOT = Path(__file__).resolve().parents[1]
MODULES = ("media", "codecs", "rtp", "sources", "streams", "topics", "clock")
PACKAGES = ("kontur_av", *(f"kontur_av.{name}" for name in MODULES), "telepresence", "pipelines")
HEAD = """# The Python interface

<!-- Written by docs/generate.py from the docstrings: change those, not this page. -->

## Recipes

```python
import time, kontur_av as ka
```

Send pictures by RTP, under a hard cap. Other forms: `format="bgr"`, `"grey"`, `"i420"`.

```python
with ka.PictureSender("localhost:5004", cap_bps=250_000) as end:
    for picture in pictures:  # RGB, uint8, shape (height, width, 3)
        end.send(picture)
```

Receive them at the other end, in the size that was sent.

```python
with ka.StreamReceiver(port=5004) as stream:
    for picture in stream:
        show(picture.data, picture.age_ms)
print(stream.ended)
```

Send a file, `v4l2:/dev/video0` or `rtsp://…`: what `kontur-av send` does, and returns its report.

```python
report = ka.send("clip.mp4", "localhost:5004", cap_bps=250_000, seconds=2)
print(report.sender.frames_sent, report.payload_bps_max_1s)
```

Encode and decode, with a transport of your own.

```python
encoder, decoder = ka.H264Encoder(width=640, height=480, fps=30, cap_bps=250_000), ka.H264Decoder()
for number, picture in enumerate(pictures):
    unit = encoder.encode(picture)  # unit.data: Annex B, of the size encoder.unit_size
    for decoded in decoder.decode(unit.data, number):
        show(decoded.to_rgb())
```

Share octets, pictures or sound with other processes of this machine.

```python
with ka.TopicBus("my-cell") as bus:
    reader, writer = bus.reader("camera"), bus.writer("camera", max_octets=1 << 20)
    writer.publish_octets(b"hello", ka.CaptureStamp(time.monotonic_ns(), 0, "me"))
    if reader.wait(1_000_000_000):
        print(reader.latest_octets())
```

Send voice. `ka.StreamReceiver(port=5006, codec="opus")` receives it.

```python
with ka.SoundSender("localhost:5006", cap_bps=64_000) as end:
    for block in blocks:  # 20 ms: int16, shape (960,), mono, 48 kHz
        end.send(block)
```

## Reference

Import these names from the modules that stand above them. All else is the project's own and may
change. Instants are integer nanoseconds of one clock, most often a `MonotonicClock`. `samples/` has
short scripts that use these names.

Of a class with more than six methods this page has their names. What they do, and types, units,
shapes and errors are in the docstrings:
`python -c "import kontur_av; help(kontur_av.PictureSender)"`.
"""
#: Keys whose unit says that their value is a number.
NUMBERS = re.compile(
    r"(`(?:p[\d.]+|max|mean|\w+_(?:ms|s|us|mm|km|deg|n|c|percent))`\??) \(number\)"
)
#: Of a class with more methods the page has their names only.
MOST_METHODS = 6
STREAM = "| {name} | {cap} | {mean:.1f} | {most:.1f} | {shown} | {lost} | {p50:.1f} | {p99:.1f} |"


def python_page() -> str:
    """docs/python.md: every exported name with its signature and what it is for."""
    parts = [HEAD]
    before: set[str] = set()
    for package in PACKAGES:
        module = griffe.load(
            package, search_paths=[ROOT], resolve_aliases=True, try_relative_path=False
        )
        # What the package itself exports is not told again with its modules.
        names = sorted({*exported(module)} - before, key=lambda name: (name.lower(), name))
        before.update(names)
        parts.append(f"## `{package}`\n\n{module.docstring.value}\n")
        told: dict[str, str] = {}
        parts += [entry(module[name], told) for name in names]
    return "\n".join(parts)


def exported(module: griffe.Object | griffe.Alias) -> list[str]:
    return [str(name).strip("'\"") for name in module.exports or ()]


def anchor(name: str) -> str:
    """The fragment that GitHub makes of a heading."""
    return re.sub(r"[^\w -]", "", name.lower()).replace(" ", "-")


def entry(member: griffe.Object | griffe.Alias, told: dict[str, str]) -> str:
    """One exported name: its signature, its docstring, and its public methods.

    told: by line, the class that has it already; lines of this class are added.
    """
    if member.is_attribute:
        code = f"{member.name} = {member.value}".replace("'", '"')
        return f"### {member.name}\n\n```python\n{code}\n```\n\n{paragraph(member)}\n"
    lines = [f"### {member.name}\n\n```python"]
    if member.is_function:
        lines += [signature(member), "```\n", paragraph(member), ""]
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
    methods = [name for name, found in public.items() if _is_method(found)]
    if own_init:
        lines.append("    " + signature(init).replace("\n", "\n    "))
    lines += ["```\n", paragraph(member), ""]
    if len(methods) > MOST_METHODS:
        lines.append("Methods: " + ", ".join(f"`{name}`" for name in methods))
        return "\n".join(lines) + "\n"
    again: dict[str, list[str]] = {}
    for name in methods:
        found = public[name]
        shown = names(found) if found.is_function else f": {found.annotation}"
        line = f"- `{name}{shown}`: {sentence(found)}"
        if shown.endswith("None"):
            line = line.replace(", or None.", ".")
        if told.setdefault(line, member.name) == member.name:
            lines.append(line.removesuffix(": "))
        else:
            again.setdefault(told[line], []).append(f"`{name}`")
    lines += [f"- {', '.join(names)}: as of [{of}](#{anchor(of)})" for of, names in again.items()]
    return "\n".join(lines).rstrip() + "\n"


def _is_method(found: griffe.Object | griffe.Alias) -> bool:
    return found.is_function or "property" in found.labels


def arguments(function: griffe.Object | griffe.Alias) -> str:
    """`(x: int) -> str` as it stands in the source, without self, on one line."""
    shown = " ".join(function.signature(return_type=True).split())
    return re.sub(r"^\((?:self|cls)(?:, )?", "(", shown[shown.index("(") :])


def names(function: griffe.Object | griffe.Alias) -> str:
    """`(x, *, y=0) -> str`: without the types of parameters, and without `-> None`."""
    inner, _, result = arguments(function).rpartition(") -> ")
    kept = []
    for parameter in _split(inner.removeprefix("(")):
        before, _, default = parameter.partition(" = ")
        kept.append(before.partition(":")[0] + f"={default}" * bool(default))
    return f"({', '.join(kept)})" + f" -> {result}" * (result != "None")


def signature(function: griffe.Object | griffe.Alias) -> str:
    line = f"def {function.name}{arguments(function)}".removesuffix(" -> None")
    if len(line) <= 96:
        return line
    parameters, _, result = arguments(function).rpartition(") -> ")
    inner = ",\n    ".join(_split(parameters.removeprefix("(")))
    end = f" -> {result}" * (result != "None")
    return f"def {function.name}(\n    {inner},\n){end}"


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


def paragraph(found: griffe.Object | griffe.Alias) -> str:
    """The first paragraph of the docstring."""
    return " ".join(found.docstring.value.split("\n\n")[0].split()) if found.docstring else ""


def sentence(found: griffe.Object | griffe.Alias) -> str:
    """The first sentence of the docstring, without its `Return`: the type is beside it."""
    told = re.split(r"(?<=\.) (?=[A-Z`(])", paragraph(found))[0].removeprefix("Return ")
    return told[:1].upper() + told[1:]


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
        cap, mean = way["cap_bps"] // 1000, way["payload_bps_mean"] / 1000
        row = f"| haptic_{name} | {cap} | {mean:.1f} | | {shown} | {way['lost']} |"
        rows.append(f"{row} {latency['p50']:.1f} | {latency['p99']:.1f} |")
    return "\n".join(rows) + "\n"


def commands_text() -> str:
    """What several commands' options mean, then every command with those of its own.

    The options of benches are left to `--help`.
    """
    commands = list(_commands(make_parser(), "kontur-av"))
    rows = {name: _rows(one) for name, one in commands if not name.startswith("kontur-av bench ")}
    counts = Counter(row for of in rows.values() for row in of)
    # By option: its most frequent meaning, if at least two commands have it.
    shared: dict[str, tuple[str, str]] = {}
    for row, count in counts.most_common():
        if count >= 2 and row[1]:
            shared.setdefault(_option(row), row)
    parts = ["## Options of several commands\n"]
    listed = {_option(row): row for row in counts if row == shared.get(_option(row))}
    parts += [f"- {option}: {told}" for option, told in listed.values()]
    for name, parser in commands:
        told = _sentence(parser.description)
        mine = rows.get(name, [])
        alike = [row for row in mine if row in listed.values()]
        own = [
            option + f": {what}" * bool(what)
            for option, what in mine
            if (option, what) not in alike
        ]
        also = [f"`{_option(row)}`" for row in alike]
        if len(name.split()) > 2 and len(mine) <= 3:
            # Few options: one item.
            parts += [""] * (not parts[-1].startswith("- "))
            parts.append(f"- `{name}`: {told}" + f" {'; '.join([*own, *also])}" * bool(mine))
            continue
        parts.append(f"\n{'#' * len(name.split())} `{name}`\n\n{told}")
        parts += [""] * bool(mine)
        parts += [f"- {one}" for one in own]
        parts += ["- " + "and " * bool(own) + ", ".join(also)] * bool(also)
    return "\n".join(parts) + "\n"


def _option(row: tuple[str, str]) -> str:
    """`--seconds` of `--seconds S`."""
    return row[0].strip("`").split()[0].rstrip(",")


def _commands(
    parser: argparse.ArgumentParser, name: str
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, inner in action.choices.items():
                yield f"{name} {word}", inner
                yield from _commands(inner, f"{name} {word}")


def _rows(parser: argparse.ArgumentParser) -> list[tuple[str, str]]:
    """Each option with its value, and what it means."""
    rows = []
    for action in parser._actions:
        hidden = "-h" in action.option_strings or action.help == argparse.SUPPRESS
        if hidden or isinstance(action, argparse._SubParsersAction):
            continue
        value = action.metavar or ("|".join(map(str, action.choices)) if action.choices else "")
        if isinstance(value, tuple):
            value = " ".join(value)
        words = ", ".join(action.option_strings) or str(value)
        shown = f"{words} {value}".strip() if action.option_strings else words
        told = " ".join((action.help or "").split()).replace("%%", "%")
        rows.append((f"`{shown}`", told))
    return rows


def _sentence(text: str | None) -> str:
    told = (text or "").strip()
    return f"{told[:1].upper()}{told[1:]}" + ("" if told.endswith(".") else ".")


def _markdown(table: tables.Table) -> str:
    rows = (table.headings, ["---"] * len(table.headings), *table.rows)
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _channels_table(whole: Topology, *others: Topology) -> tables.Table:
    """The channels of `whole` with their ports, and which of the setups has which."""
    sessions = (whole, *others)
    rows = [
        (
            f"`{row.name}`",
            f"{row.direction.sender.value} → {row.direction.receiver.value}",
            str(row.entry_port),
            str(row.exit_port),
            tables.travels(row, whole),
            *("●" if row.name in {each.name for each in one.streams} else "" for one in sessions),
        )
        for row in whole.streams
    ]
    up, down = (whole.link(direction) for direction in Direction)
    frames = f"transfer frames: ground has {down.port}, space {up.port}"
    ends = "gateway ↔ gateway"
    rows.append(("radio", ends, str(down.port), str(up.port), frames, *("●" for _ in sessions)))
    names = tuple(one.setup.name for one in sessions)
    return tables.Table(
        headings=("channel", "from → to", "send to", "comes out at", "what travels", *names),
        rows=rows,
    )


def _in_code(table: tables.Table, *headings: str) -> tables.Table:
    """The table with the cells of these columns as code, for Markdown."""
    columns = [table.headings.index(heading) for heading in headings]
    rows = [
        [
            ", ".join(f"`{name}`" for name in cell.split(", ")) if number in columns else cell
            for number, cell in enumerate(row)
        ]
        for row in table.rows
    ]
    return tables.Table(headings=table.headings, rows=[_dashed(row) for row in rows])


def _dashed(row: Sequence[str]) -> list[str]:
    return ["–" if cell == "`–`" else cell for cell in row]


def topology_blocks() -> dict[str, str]:
    """By name: what stands between `<!-- generated: NAME -->` and `<!-- /generated -->`."""
    session = topology_of(load_setup("spacejustin"), snapshots=True, pages=True, recorder=True)
    processes = tables.processes_table(session)
    for heading in ("priority", "reads", "writes"):
        processes = processes.without(heading)
    channels = _channels_table(session, topology_of(load_setup("taskboard")))
    return {
        "commands": commands_text(),
        "pages": pages_list(),
        "keys": keys_table(),
        "holds": holds_table(),
        "processes": _markdown(joined(_in_code(processes, "process"))),
        "channels": _markdown(channels),
        "recorded channels": _markdown(joined(recorded_channels(session))),
        "recorded fields": recorded_fields(),
        **told_once(
            {
                "report": keys_tables(SessionReport),
                "counts": counts_table(),
                "link report": keys_tables(LinkReport, without=SessionReport),
                "headlines": keys_tables(Headline),
            }
        ),
    }


def told_once(blocks: dict[str, str]) -> dict[str, str]:
    """The lists of these blocks, with runs of three items or more in their first place only.

    A later place names their first and last key, and the list that has them.
    """
    before: list[tuple[str, list[str]]] = []
    for name, block in blocks.items():
        parts = []
        for part in block.strip().split("\n\n**"):
            title, *items = NUMBERS.sub(r"\1", part).split("\n- ")
            listed = title.strip("*\n ").partition("**")[0].rstrip(".")
            kept = list(_without_runs(items, listed, before))
            if not (name == "counts" and len(kept) == 1 and ": as in " in kept[0]):
                parts.append("\n- ".join([title, *kept]))
        blocks[name] = "\n\n**".join(parts) + "\n"
    return blocks


def _without_runs(
    items: list[str], title: str, before: list[tuple[str, list[str]]]
) -> Iterator[str]:
    """The items, runs of those that were in `before` named only. Adds new ones to `before`."""
    fresh: list[str] = []
    before.append((title, fresh))
    while items:
        plain = [item.replace("`STREAM.", "`", 1) for item in items]
        length, where = max(
            ((_alike(plain, had[at:]), of) for of, had in before for at in range(len(had))),
            key=lambda found: found[0],
            default=(0, ""),
        )
        if length >= 3:
            first, last = (items[at].partition(":")[0].split()[0] for at in (0, length - 1))
            yield f"{first} … {last}: as " + (f"in {where}" if where != title else "above")
        else:
            length = 1
            fresh.append(plain[0])
            yield items[0]
        items = items[length:]


def _alike(items: list[str], others: list[str]) -> int:
    """How many items are the same from the first on."""
    pairs = list(zip(items, others, strict=False))
    return next((at for at, (one, other) in enumerate(pairs) if one != other), len(pairs))


def joined(table: tables.Table) -> tables.Table:
    """Rows that are the same but for their first cell become one row."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for first, *others in table.rows:
        alike.setdefault(tuple(others), []).append(first)
    rows = [(", ".join(firsts), *others) for others, firsts in alike.items()]
    return tables.Table(headings=table.headings, rows=rows)


def recorded_channels(session: Topology) -> tables.Table:
    """All channels that a recording of a session can have."""
    rows = channels_of(session, link_frames=True)
    return tables.Table(
        headings=("channel", "schema", "a message"),
        rows=[(f"`{row.topic}`", f"`{row.schema.full_name}`", row.what) for row in rows],
    )


def recorded_fields() -> str:
    """A list of fields for each schema, and for each one in it."""
    named: list[tuple[str, MessageSchema]] = []
    for schema in SCHEMAS:
        named.append((schema.full_name, schema))
        named += [(f"{schema.full_name}.{inner.name}", inner) for inner in schema.nested]
    parts = []
    for name, schema in named:
        alike: dict[str, list[str]] = {}
        for row in schema.fields:
            told = f" ({row.type}{'[]' * row.repeated}): {row.what}"
            alike.setdefault(told, []).append(f"`{row.name}`")
        fields = (f"- {', '.join(names)}{told}" for told, names in alike.items())
        parts.append("\n".join([f"`{name}`\n", *fields]))
    return "\n\n".join(parts) + "\n"


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
