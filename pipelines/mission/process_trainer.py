"""The trainer's process: a Unix socket for terminals, and the topic with the exercises.

`Trainer` decides.
"""

from itertools import count

from kontur_av.media import CaptureStamp
from pipelines.session.process import Context
from pipelines.session.terminals import serve_terminals
from pipelines.session.topology import TRAINER_TOPIC
from pipelines.session.training import TRAINER_DESK, Trainer, TrainerReach

_OCTETS = 4096


def run_trainer(context: Context) -> None:
    """Take requests, and publish what lasts."""
    trainer = Trainer(context.probe, TrainerReach.of(context.topology))
    context.on_flush(trainer.tell)
    published, numbers = trainer.exercises, count()
    with context.open_bus() as bus:
        writer = bus.writer(TRAINER_TOPIC, max_octets=_OCTETS, wake=False)

        def publish(now_ns: int) -> None:
            nonlocal published
            if trainer.exercises is not published:
                published = trainer.exercises
                stamp = CaptureStamp(now_ns, next(numbers), "trainer")
                writer.publish_octets(published.pack(), stamp)

        serve_terminals(context, TRAINER_DESK, trainer.desk, publish)
