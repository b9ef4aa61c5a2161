"""The dictionary of a session: the built-in one, with what its setup and options add."""

from dataclasses import replace

from pipelines.mission.choosing import CAMERA
from pipelines.mission.supervisor import supervised
from pipelines.session.topology import Topology
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.telemetry_source import with_components


def session_dictionary(dictionary: Dictionary, topology: Topology) -> Dictionary:
    """Return `dictionary` with a session's cameras, components and processes; ConfigError."""
    known = supervised(with_components(dictionary, topology.options.components), topology)
    return Dictionary(
        applications=tuple(
            replace(
                one,
                parameters=tuple(
                    replace(each, choices=topology.setup.cameras) if each.name == CAMERA else each
                    for each in one.parameters
                ),
            )
            if one.name == CAMERA
            else one
            for one in known.applications
        )
    )
