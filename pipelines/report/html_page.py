"""Pages that are one HTML file with nothing beside it: sections, tables, and bars on tracks.

Bars are boxes whose places are percentages, so that they fit a telephone and a wide screen.
"""

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import NamedTuple

_STYLE = """
:root { color-scheme: light dark; --faint: #8884; --good: #009e73; --bad: #d55e00; --run: #0072b2;
  --s0: #0072b2; --s1: #e69f00; --s2: #009e73; --s3: #cc79a7; }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.row { display: grid; grid-template-columns: minmax(6rem, 11rem) 1fr; gap: .6rem; margin: .3rem 0; }
.row > :first-child { overflow-wrap: anywhere; }
.track { position: relative; height: 1.2rem; background: var(--faint); border-radius: 3px; }
.track i { position: absolute; top: 0; bottom: 0; min-width: 2px; }
.good { background: var(--good); } .bad { background: var(--bad); } .run { background: var(--run); }
.mark { width: 2px; background: currentColor; }
.s0 { background: var(--s0); } .s1 { background: var(--s1); }
.s2 { background: var(--s2); } .s3 { background: var(--s3); }
.key span { display: inline-block; margin-right: 1rem; }
.key b { padding: 0 .5em; margin-right: .4em; }
small { display: block; opacity: .8; } table { border-collapse: collapse; }
section { overflow-x: auto; }
td, th { text-align: left; vertical-align: top; padding: .15rem .8rem .15rem 0; }
td:first-child { white-space: nowrap; } .failed { color: var(--bad); font-weight: bold; }
"""


class Bar(NamedTuple):
    """A part of a track, in the track's unit."""

    begin: float
    end: float
    look: str
    title: str


def whole_page(title: str, parts: Iterable[str]) -> str:
    """The text of the file. parts: markup."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style>\n"
        + "\n".join(parts)
        + "\n</html>\n"
    )


def section(heading: str, lines: Iterable[str]) -> Iterator[str]:
    """The heading and the lines; nothing without lines."""
    found = list(lines)
    if found:
        yield f"<section><h2>{heading}</h2>"
        yield from found
        yield "</section>"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    found = [_cells("td", row) for row in rows]
    if found:
        yield f"<table>{_cells('th', headings)}{''.join(found)}</table>"


def _cells(kind: str, words: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{kind}>{escape(word)}</{kind}>' for word in words)}</tr>"


def track(name: str, bars: Iterable[Bar], most: float, words: str) -> str:
    """A row: its name, its bars on a scale from 0 to `most`, and the same in words."""
    boxes = []
    for bar in bars:
        begin, end = (100 * min(1.0, max(0.0, at / most)) for at in (bar.begin, bar.end))
        width = "" if bar.look == "mark" else f"width:{end - begin:.2f}%"
        style = f"left:{begin:.2f}%;{width}"
        boxes.append(f'<i class="{bar.look}" style="{style}" title="{escape(bar.title)}"></i>')
    drawn = f'<div class="track" role="img" aria-label="{escape(words)}">{"".join(boxes)}</div>'
    said = f"<small>{escape(words)}</small>"
    return f'<div class="row"><div>{escape(name)}</div><div>{drawn}{said}</div></div>'
