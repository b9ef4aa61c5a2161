"""Tables from the code: keys of pages, why the robot holds still; and the index of all pages."""

import re
from functools import cache
from pathlib import Path

import griffe

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "pipelines" / "seats" / "static"
#: Pages with keys, in the order of the table.
SEATS = ("space", "panel", "ground", "top", "k2cp", "k2sv", "systems")
#: A shortcut that a page's module gives to its keyboard.
SHORTCUT = re.compile(
    r"keys(?:: \[(?P<keys>[^\]]*)\]|: [^\n]*)?,\s*"
    r"""(?:shown: (?P<shown>"[^"]*"|`[^`]*`|keys\.map.*),\s*)?"""
    r"""what: (?P<what>"[^"]*"|`[^`]*`)"""
)
#: Keys and words of shortcuts that a page computes, by what they have in the code.
COMPUTED = {
    "`with Space: move ${way}`": ("← → ↑ ↓ or A D W S", "with Space: move the handle"),
    '`with Space and more axes: move the chosen one ${way > 0 ? "up" : "down"}`': (
        "PageUp PageDown",
        "with Space and more axes: move the chosen one up or down",
    ),
    '"open a tab"': ("1 … 9", "open a tab"),
}
#: Keys that come first: the stop, then those of the hand.
FIRST = ("emergency stop", "hold the", "with Space: move", "with these", "let go", "take the")


def keys_table() -> str:
    """Every key of the pages and what it does, those of the same pages together."""
    found: dict[tuple[str, str], list[str]] = {}
    for page in SEATS:
        chooses = " chooses" in (PAGES / f"{page}.html").read_text(encoding="utf-8")
        for module in _modules(f"{page}.js"):
            if module == "focus_frame.js" and not chooses:
                continue
            for row in _shortcuts(module):
                found.setdefault(row, []).append(f"`/{page}`")
    rows = sorted(found.items(), key=lambda item: _place(item[0][1]))
    lists: dict[str, list[str]] = {}
    for (keys, what), pages in rows:
        where = "all pages" if len(pages) == len(SEATS) else ", ".join(pages)
        lists.setdefault(where, []).append(f"- **{keys}**: {what}")
    return "\n\n".join(f"On {w}:\n\n" + "\n".join(one) for w, one in lists.items()) + "\n"


def _place(what: str) -> int:
    return next((at for at, begin in enumerate(FIRST) if what.startswith(begin)), len(FIRST))


@cache
def _modules(name: str) -> tuple[str, ...]:
    """The module and all that it imports, directly or not, each once."""
    found = [name]
    for module in found:
        text = (PAGES / module).read_text(encoding="utf-8")
        imported = re.findall(r'^import (?:.*? from )?"\./([\w.]+)";', text, re.MULTILINE)
        found += [each for each in dict.fromkeys(imported) if each not in found]
    return tuple(found)


def _shortcuts(module: str) -> list[tuple[str, str]]:
    rows = []
    text = (PAGES / module).read_text(encoding="utf-8")
    for match in SHORTCUT.finditer(text):
        what = match["what"]
        if what in COMPUTED:
            keys, what = COMPUTED[what]
        elif what.startswith("`"):
            raise ValueError(f"{module}: add {what} to COMPUTED in {Path(__file__).name}")
        else:
            what = what.strip('"')
            keys = match["shown"] or match["keys"]
            keys = " ".join(one.strip('" ') for one in keys.split('", "'))
            keys = keys.upper() if len(keys) == 1 else keys
        rows.append((keys, what))
    return rows


def holds_table() -> str:
    """Why the robot holds still, and what to do, from the comments of `Hold`."""
    module = griffe.load(
        "telepresence.haptics.envelope", search_paths=[ROOT], try_relative_path=False
    )
    path = ROOT / "telepresence" / "haptics" / "envelope.py"
    source = path.read_text(encoding="utf-8").splitlines()
    lines = []
    for member in module["Hold"].attributes.values():
        value = str(member.value).strip("'\"")
        if not value:
            continue
        at = member.lineno - 2
        comment: list[str] = []
        while source[at].lstrip().startswith("#: "):
            comment.insert(0, source[at].strip().removeprefix("#: "))
            at -= 1
        lines.append(f"- *{value}*: {' '.join(comment)}")
    return "\n".join(lines) + "\n"


#: Pages in the order of the index; pages without a place here come last.
ORDER = (
    *("first-session", "operator", "ground-control", "troubleshooting", "install"),
    *("cameras", "drivers", "two-machines", "telemetry", "own-programs"),
    *("rtp-streams", "webrtc", "live-viewers", "recordings", "simulation"),
    *("safety", "security", "architecture", "haptics", "wire-formats", "measurements"),
    *("setup-file", "commands", "report", "python"),
)


def purpose(text: str) -> tuple[str, str]:
    """The reader and the question that a page names in its first line; "" if it names none."""
    found = re.match(r"# [^\n]*\n\nFor (.*?): (.*?\?)", text, re.DOTALL)
    return (found[1], " ".join(found[2].split())) if found else ("", "")


def pages_list() -> str:
    """Each page of the documents, for whom it is, and its question."""
    found = {page.stem: page for page in sorted((ROOT / "docs").glob("*.md"))}
    del found["index"]
    names = [name for name in ORDER if name in found]
    names += [name for name in found if name not in ORDER]
    lines = []
    for name in names:
        reader, question = purpose(found[name].read_text(encoding="utf-8"))
        lines.append(f"- [{name}]({name}.md), for {reader}: {question}")
    return "\n".join(lines) + "\n"
