"""Paths of the project, and its modules as syntax trees, each parsed once."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports_of(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """All imports of a module, within functions too."""
    kinds = ast.Import, ast.ImportFrom
    return [node for node in ast.walk(tree_of(path)) if isinstance(node, kinds)]
