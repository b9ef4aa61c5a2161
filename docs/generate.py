"""Write what documents take from the code.

    python docs/generate.py            docs/python.md, from the docstrings of what is exported, and
                                       every part between `<!-- generated: NAME -->` marks
    python docs/generate.py --run      the README's table, too: a session of 20 s on virtual time

Tests check that all but the README's table is up to date. griffe reads source text, so the page is
the same under every Python version.
"""

import argparse
import dataclasses
import inspect
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import griffe
from report_keys import counts, report_keys
from user_tables import holds_table, keys_table, pages_list

from pipelines.cli import make_parser
from pipelines.recording.channels import channels_of
from pipelines.session.setup.composition import Composition
from pipelines.session.setup.segments import Direction
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.setup_text import SETUP_FILE, file_kind
from pipelines.session.setup.table import Playback, RtcLeg, Setup, VideoStream, VoiceStream
from pipelines.session.topology import tables
from pipelines.session.topology.table import Topology
from pipelines.table import topology_of
from telepresence.haptics.axes import AxisSettings
from telepresence.haptics.envelope import SafetyLimits
from telepresence.haptics.robot import Mark

ROOT = Path(__file__).resolve().parents[1]
MODULES = ("media", "codecs", "rtp", "sources", "streams", "topics", "clock")
PACKAGES = ("kontur_av", *(f"kontur_av.{name}" for name in MODULES), "telepresence", "pipelines")
HEAD = """# The Python interface

For programmers: which names may a program use, and what do they do?

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

Send a file, `v4l2:/dev/video0` or `rtsp://…`, as `kontur-av send` does.

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

Import these names from the modules that stand above them; all else may change. Instants are
integer nanoseconds of one clock, most often a `MonotonicClock`. Classes are bold, with the methods
of small ones. Types, units, shapes, errors and what `…` stands for are in the docstrings:
`python -c "import kontur_av; help(kontur_av.send)"`.
"""
#: Of a class with more methods the page has none, of a function with more options `…`.
MOST_METHODS, MOST_OPTIONS = 5, 1
#: Fields of a setup that are tables of their own.
TABLES = (
    *("uplink_video", "uplink_voice", "downlink_video", "downlink_voice", "uplink", "downlink"),
    *("composed", "axis", "rtc", "marks", "playback", "safety"),
)
STREAM = "| {name} | {cap} | {mean:.1f} | {most:.1f} | {shown} | {lost} | {p50:.1f} | {p99:.1f} |"


def python_page() -> str:
    """docs/python.md: every exported name with its signature and what it is for."""
    parts = [HEAD]
    before: set[str] = set()
    # One for all: each would read its whole package again.
    loader = griffe.GriffeLoader(search_paths=[ROOT])
    for package in dict.fromkeys(name.partition(".")[0] for name in PACKAGES):
        loader.load(package, try_relative_path=False)
    loader.resolve_aliases()
    for package in PACKAGES:
        module = loader.modules_collection[package]
        # What the package itself exports is not told again with its modules.
        names = sorted({*exported(module)} - before, key=lambda name: (name.lower(), name))
        before.update(names)
        parts.append(f"## `{package}`\n\n{paragraph(module)}\n")
        now = [module[name] for name in names if _is_current(module[name])]
        parts.append("\n".join(map(entry, now)) + "\n")
    return "\n".join(parts)


def exported(module: griffe.Object | griffe.Alias) -> list[str]:
    return [str(name).strip("'\"") for name in module.exports or ()]


def _is_current(member: griffe.Object | griffe.Alias) -> bool:
    """Whether a name is not the former one of another."""
    return not member.is_alias or bool(member.target.name == member.name)


def entry(member: griffe.Object | griffe.Alias) -> str:
    """One exported name: how it is called, the first sentence of its docstring, its methods."""
    if member.is_attribute:
        value = " ".join(str(member.value).split()).replace("'", '"')
        return f"- `{member.name} = {value}`" if len(value) <= 60 else f"- `{member.name}`"
    if member.is_function:
        return f"- `{member.name}{names(member)}`: {sentence(member)}"
    public = {
        name: found
        for name, found in {**member.inherited_members, **member.members}.items()
        if not name.startswith("_") and found.is_function
    }
    methods = ", ".join(f"`{name}`" for name in public) if len(public) <= MOST_METHODS else ""
    return f"- **`{member.name}`**: {sentence(member)}" + f" {methods}." * bool(methods)


def arguments(function: griffe.Object | griffe.Alias) -> str:
    """`(x: int) -> str` as it stands in the source, without self, on one line."""
    shown = " ".join(function.signature(return_type=True).split())
    return re.sub(r"^\((?:self|cls)(?:, )?", "(", shown[shown.index("(") :])


def names(function: griffe.Object | griffe.Alias) -> str:
    """`(x, *, y=0) -> str`: without the types of parameters, and without `-> None`."""
    inner, _, result = arguments(function).rpartition(") -> ")
    kept, options = [], []
    for parameter in _split(inner.removeprefix("(")):
        before, _, default = parameter.partition(" = ")
        kept.append(before.partition(":")[0] + f"={default}" * bool(default))
        options += kept[-1:] * bool(default)
    if len(options) > MOST_OPTIONS:
        kept = [one for one in kept if one not in options]
        kept = [*kept[: -1 if kept[-1] == "*" else None], "…"]
    return f"({', '.join(kept)})" + f" -> {result}" * (result != "None")


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

    What only the subcommands of one command share stands there. Which command has a shared option,
    and the options of benches, are left to `--help`.
    """
    commands = [
        (name.removeprefix("kontur-av "), parser)
        for name, parser in _commands(make_parser(), "kontur-av")
        if not name.startswith("kontur-av bench")
    ]
    rows = {name: _rows(parser) for name, parser in commands}
    shared = _shared({name: name.split()[0] for name in rows}, rows)
    parts = ["## Options of several commands\n"]
    parts += [f"- {option}: {told}" for option, told in shared]
    below: list[tuple[str, str]] = []
    words = [name.split()[0] for name in rows]
    several = {word for word in words if words.count(word) > 2}
    for name, parser in commands:
        told = _sentence(parser.description)
        own = _own(rows[name], shared)
        if name.split()[0] in several and " " in name:
            own = [row for row in own if row not in below]
            parts.append(f"- `{name}`: {told} {'; '.join(map(_told, own))}".rstrip())
            continue
        inner = {of: of for of in rows if of.startswith(f"{name} ")}
        if len(inner) == 1:
            # Told at its only subcommand.
            continue
        below = [row for row in _shared(inner, rows) if row not in shared]
        parts.append(f"\n## `{name}`\n\n{told}")
        parts += [""] * bool(own or inner)
        parts += [f"- {_told(row)}" for row in own]
        parts += ["- of several: " + "; ".join(map(_told, below))] * bool(below)
    return "\n".join(parts) + "\n"


def _shared(
    homes: Mapping[str, str], rows: Mapping[str, list[tuple[str, str]]]
) -> list[tuple[str, str]]:
    """By option its most frequent meaning, if commands of at least two homes have it."""
    having: dict[tuple[str, str], set[str]] = {}
    for name, home in homes.items():
        for row in rows[name]:
            having.setdefault(row, set()).add(home)
    found: dict[str, tuple[str, str]] = {}
    for row in sorted(having, key=lambda row: -len(having[row])):
        if len(having[row]) >= 2 and row[1]:
            found.setdefault(_option(row), row)
    return [row for row in having if row in found.values()]


def _told(row: tuple[str, str]) -> str:
    option, what = row
    return option + f": {what}" * bool(what)


def _own(rows: list[tuple[str, str]], shared: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """The options that are not shared; all times of virtual steps as one."""
    own = [row for row in rows if row not in shared]
    times = [_option(row) for row in own if row[1].startswith("virtual time to ")]
    if times:
        own = [row for row in own if _option(row) not in times]
        own.append((f"`{times[0]}` to `{times[-1]}`", "virtual time that such a step takes"))
    return own


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
        hidden = action.dest.startswith("help") or action.help == argparse.SUPPRESS
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


def _channels_table(whole: Topology) -> tables.Table:
    """The channels of `whole` with their ports."""
    rows = [
        (
            f"`{row.name}`",
            f"{row.direction.sender.value} → {row.direction.receiver.value}",
            str(row.entry_port),
            str(row.exit_port),
            tables.travels(row, whole),
        )
        for row in whole.streams
    ]
    up, down = (whole.link(direction) for direction in Direction)
    frames = f"transfer frames: ground has {down.port}, space {up.port}"
    rows.append(("radio", "gateway ↔ gateway", str(down.port), str(up.port), frames))
    return tables.Table(
        headings=("channel", "from → to", "send to", "comes out at", "what travels"), rows=rows
    )


def _processes(session: Topology) -> str:
    """The processes of each segment, those that do the same together."""
    table = tables.processes_table(session)
    for heading in ("priority", "stage", "reads", "writes"):
        table = table.without(heading)
    lines: dict[str, list[str]] = {}
    for names, segment, what in joined(table).rows:
        named = ", ".join(f"`{name}`" for name in names.split(", "))
        lines.setdefault(segment, []).append(f"- {named}: {what}")
    heads = {"–": "At both", "ground": "On the ground", "space": "In space"}
    parts = [f"{heads[segment]}:\n\n" + "\n".join(rows) for segment, rows in lines.items()]
    return "\n\n".join(parts) + "\n"


def topology_blocks() -> dict[str, str]:
    """By name: what stands between `<!-- generated: NAME -->` and `<!-- /generated -->`."""
    session = topology_of(load_setup("spacejustin"), snapshots=True, pages=True, recorder=True)
    channels = _channels_table(session)
    return {
        "commands": commands_text(),
        "pages": pages_list(),
        "keys": keys_table(),
        "holds": holds_table(),
        "processes": _processes(session),
        "channels": _markdown(channels),
        "recorded channels": "".join(
            f"- {channels} (`{schema}`): {what}\n"
            for channels, schema, what in joined(recorded_channels(session)).rows
        ),
        "setup": setup_fields(),
        "report": report_keys(),
        "counts": counts(),
    }


def joined(table: tables.Table) -> tables.Table:
    """Rows that are the same but for their first cell become one row."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for first, *others in table.rows:
        alike.setdefault(tuple(others), []).append(first)
    rows = [(", ".join(firsts), *others) for others, firsts in alike.items()]
    return tables.Table(headings=table.headings, rows=rows)


def recorded_channels(session: Topology) -> tables.Table:
    """All channels that a recording of a session can have; their names say which way."""
    rows = channels_of(session, link_frames=True)
    way = re.compile(r" (as (sent|received)|from this end for this end).*")
    return tables.Table(
        headings=("channel", "schema", "a message"),
        rows=[(f"`{row.topic}`", row.schema.full_name, way.sub("", row.what)) for row in rows],
    )


def setup_fields() -> str:
    """For each table of a setup's file: its keys, their defaults, and what they mean."""
    tables_of: dict[str, tuple[Any, Any]] = {
        "": (Setup, SETUP_FILE),
        "[uplink_video]`, `[downlink_video]": (VideoStream, file_kind(VideoStream)),
        "[uplink_voice]`, `[downlink_voice]": (VoiceStream, file_kind(VoiceStream)),
        "[composed.NAME]": (Composition, Composition),
        "[axis.NAME]": (AxisSettings, AxisSettings),
        "[rtc]": (RtcLeg, file_kind(RtcLeg)),
        "[marks.NAME]": (Mark, Mark),
        "[playback]": (Playback, Playback),
        "[safety]": (SafetyLimits, SafetyLimits),
    }
    parts = []
    for name, (kind, in_file) in tables_of.items():
        said = _said_of_fields(kind)
        heads: dict[str, list[str]] = {}
        for field in dataclasses.fields(in_file):
            own = {"size": "width"}.get(field.name, field.name.replace("_kbps", "_bps"))
            if name or own not in TABLES:
                what = re.sub(r"\(?docs/(([\w-]+)\.md[#\w-]*)\)?", r"([\2](\1))", said[own])
                heads.setdefault(what, []).append(f"`{field.name}`{_default(field, kind, own)}")
        lines = [f"**`{name}`**\n"] if name else []
        lines += [f"- {', '.join(fields)}: {what}" for what, fields in heads.items()]
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _said_of_fields(kind: type) -> dict[str, str]:
    """By field: its sentence in the docstring, `name, name: what`."""
    text = inspect.getdoc(kind) or ""
    found = {}
    for entry in re.split(r"\n(?=\w+(?:, \w+)*: )|(?<=\. )(?=\w+(?:, \w+)*: )", text)[1:]:
        names, _, what = entry.partition(": ")
        for name in names.split(", "):
            found[name] = " ".join(what.split()).partition(" Raises ")[0]
    return found


def _default(field: dataclasses.Field[Any], kind: Any, own: str) -> str:
    """` = ` and the default of a field as a file has it; of choices all, the default first."""
    hint = next(one.type for one in dataclasses.fields(kind) if one.name == own)
    default = field.default
    if get_origin(hint) is Literal:
        choices = sorted(get_args(hint), key=lambda one: one != default)
        return " = " + ", ".join(f'`"{one}"`' for one in choices)
    if default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
        return " (required)" * (own != "name")
    return "" if default in (dataclasses.MISSING, None) else f" = `{json.dumps(default)}`"


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
