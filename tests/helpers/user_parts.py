"""The samples' own robot and joystick, as modules."""

import importlib.util

from places import ROOT


def load(name):
    """Return the sample in a file of this name as a module."""
    spec = importlib.util.spec_from_file_location(name.removesuffix(".py"), ROOT / "samples" / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
