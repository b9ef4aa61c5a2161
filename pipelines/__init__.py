"""What is joined to what: setups, processes, the launcher, the report and the command.

What is listed here is the interface for users of the library. Names are loaded when they are first
used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipelines.setup.setup_file import load_setup, setup_from_table
    from pipelines.setup.table import Setup, VideoStream, VoiceStream
    from pipelines.topology import Topology, topology_of

__all__ = [
    "Setup",
    "Topology",
    "VideoStream",
    "VoiceStream",
    "load_setup",
    "setup_from_table",
    "topology_of",
]

#: Module -> the names above that it defines.
_HOMES = {
    "setup.setup_file": ("load_setup", "setup_from_table"),
    "setup.table": ("Setup", "VideoStream", "VoiceStream"),
    "topology": ("Topology", "topology_of"),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    """PEP 562: import a name's module when the name is first used."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
