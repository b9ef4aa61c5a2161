"""The samples' own robot and joystick, as modules."""

import importlib.util

from places import ROOT


def load(name):
    """Return a sample as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "samples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
