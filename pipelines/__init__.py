"""What is joined to what: setups, processes, the launcher, the report and the command."""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from pipelines.mission.driving import Driving, Observation
    from pipelines.mission.joined_session import GivenInput, JoinedSession, ShownPicture
    from pipelines.session.setup.setup_file import load_setup, setup_from_table
    from pipelines.session.setup.table import Setup, VideoStream, VoiceStream
    from pipelines.session.topology.table import Topology
    from pipelines.table import topology_of
    from pipelines.virtual.simulate import simulate

__all__ = [
    "Driving",
    "GivenInput",
    "JoinedSession",
    "Observation",
    "Setup",
    "ShownPicture",
    "Topology",
    "VideoStream",
    "VoiceStream",
    "load_setup",
    "setup_from_table",
    "simulate",
    "topology_of",
]

__getattr__, __dir__ = lazy_names(__name__)
