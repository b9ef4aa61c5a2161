"""Paths of the project, and its modules as syntax trees, each parsed once."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


#: Where a statement has others; an expression has none.
_BODIES = ("body", "orelse", "handlers", "finalbody", "cases")


@cache
def imports_of(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """All imports of a module, within functions too."""
    found, left = [], [tree_of(path)]
    while left:
        node = left.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for name in _BODIES:
            inner = getattr(node, name, ())
            left += inner if isinstance(inner, list) else ()
    return found
