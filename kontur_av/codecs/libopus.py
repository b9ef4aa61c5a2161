"""Load opuslib with a libopus: the system's, or else the one in PyAV's wheel.

opuslib looks for a system library when it is imported, and raises without one. A fresh machine
often has none, but PyAV's wheel, which is needed anyway, contains a whole libopus.
"""

import ctypes
import ctypes.util
import importlib
import sys
import warnings
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any, Literal

from kontur_av.codecs.carried import carried_by_pyav
from kontur_av.errors import ConfigError


@dataclass(frozen=True, slots=True)
class LibOpus:
    """The libopus in use. path: what the loader was given, a full path or a library's name."""

    path: str
    origin: Literal["system", "PyAV"]
    version: str


def opuslib() -> ModuleType:
    """Return the imported opuslib, with its libopus loaded."""
    load()
    return sys.modules["opuslib"]


def copy_state(encoder: Any) -> bytes:
    """Return the state of opuslib's encoder for mono, a block that libopus lets copy (opus.h)."""
    return ctypes.string_at(encoder, opuslib().api.encoder.get_size(1))


def set_state(encoder: Any, state: bytes) -> None:
    """Give an encoder its own earlier state."""
    ctypes.memmove(encoder, state, len(state))


@cache
def load() -> LibOpus:
    """Import opuslib with the libopus of this machine. Later calls return the first result.

    Raises ConfigError, which names the fix, without a system libopus and PyAV's.
    """
    system = ctypes.util.find_library("opus")
    carried = None if system else carried_by_pyav("opus")
    path = system or (str(carried) if carried else None)
    if path is None:
        raise ConfigError(
            "no libopus: install Debian's libopus0, Homebrew's opus, "
            "or PyAV from its wheel, which carries one"
        )
    _import_with(path)
    version = sys.modules["opuslib.api.info"].get_version_string().decode()
    return LibOpus(path, "system" if system else "PyAV", version)


def _import_with(path: str) -> None:
    find_library = ctypes.util.find_library

    def found(name: str) -> str | None:
        return path if name == "opus" else find_library(name)

    ctypes.util.find_library = found
    try:
        with warnings.catch_warnings():
            # opuslib compares integers with `is`, of which the compiler warns.
            warnings.simplefilter("ignore", SyntaxWarning)
            importlib.import_module("opuslib")
    except OSError as error:
        raise ConfigError(f"libopus {path} cannot be loaded ({error}): reinstall it") from error
    finally:
        ctypes.util.find_library = find_library
    # opus_*_ctl are variadic: ctypes must know the fixed arguments, because Apple's arm64 passes
    # the others on the stack and not in registers.
    for name in ("encoder", "decoder"):
        module = sys.modules[f"opuslib.api.{name}"]
        pointer = getattr(module, f"{name.capitalize()}Pointer")
        module.libopus_ctl.argtypes = (pointer, ctypes.c_int)
