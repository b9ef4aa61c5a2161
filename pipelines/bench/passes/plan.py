"""What the sessions of `bench passes` have in common. A core."""

from dataclasses import dataclass

from pipelines.session.setup.table import Setup
from pipelines.virtual.campaign.tasks import SessionTask


@dataclass(frozen=True, kw_only=True)
class SessionPlan:
    """By its names, as a report keeps it. content: a digest of the values of setup and radio."""

    setup: str
    seconds: float
    radio: str
    media: bool
    content: str = ""

    def task(self, setup: Setup, seed: int) -> SessionTask:
        """The session of `seed`. setup: what the names stand for."""
        return SessionTask(setup=setup, seconds=self.seconds, seed=seed, media=self.media)
