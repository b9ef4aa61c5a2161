"""Load one module of a package without the rest of it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec, module_from_spec


@contextmanager
def package_not_run(name: str) -> Iterator[None]:
    """Within the block, modules of the package `name` load without its own `__init__`.

    For a package that imports far more than one of its modules needs. A later import of the package
    loads all of it anew.
    """
    spec = None if name in sys.modules else find_spec(name)
    if spec is None:
        # It has run already, or the import in the block will say that it is missing.
        yield
        return
    sys.modules[name] = module_from_spec(spec)
    try:
        yield
    finally:
        for loaded in [name, *(other for other in sys.modules if other.startswith(f"{name}."))]:
            del sys.modules[loaded]
