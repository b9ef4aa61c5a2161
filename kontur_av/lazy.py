"""Names of a package that are imported at their first use (PEP 562)."""

import ast
import sys
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, *, moved: Mapping[str, str] | None = None
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for the `__init__` of `package`.

    The names and their modules are what stands in it below `if TYPE_CHECKING:`.
    moved: by their module, the former names of `package`. Their use gives a DeprecationWarning.
    """
    former = {name: home for home, names in (moved or {}).items() for name in names.split()}
    loader: Any = sys.modules[package].__loader__
    home_of = {
        name.asname or name.name: (str(found.module), name.name)
        for block in ast.parse(loader.get_source(package)).body
        if isinstance(block, ast.If)
        for found in block.body
        if isinstance(found, ast.ImportFrom)
        for name in found.names
    }

    def find(name: str) -> object:
        if name in former:
            words = f"{package}.{name} is {former[name]}.{name} now"
            warnings.warn(words, DeprecationWarning, stacklevel=2)
            return getattr(import_module(former[name]), name)
        if name not in home_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(import_module(home_of[name][0]), home_of[name][1])
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *home_of})

    return find, names
