"""The surroundings of one simulated process, without a session."""

from types import SimpleNamespace

from pipelines.session.probe import Probe


def bare_scene(agenda, setup, costs):
    """A scene whose processes tell their figures to nobody."""
    return SimpleNamespace(
        agenda=agenda,
        setup=setup,
        costs=costs,
        telling=SimpleNamespace(probe=lambda process: Probe(), add=lambda fill: None),
        topology=SimpleNamespace(media=lambda stream: SimpleNamespace(sender="sender")),
    )
