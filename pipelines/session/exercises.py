"""What a process reads of the trainer's exercises."""

from collections.abc import Callable

from kontur_av.topics.bus import TopicBus
from pipelines.session.topology import TRAINER_TOPIC
from pipelines.session.training import Exercises


def new_exercises(bus: TopicBus) -> Callable[[], Exercises | None]:
    """Return a function that returns the exercises after each change of them, else None."""
    reader = bus.reader(TRAINER_TOPIC)

    def take() -> Exercises | None:
        lease = reader.latest()
        if lease is None:
            return None
        with lease:
            return Exercises.unpack(lease.octets())

    return take
