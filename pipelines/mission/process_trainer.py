"""The trainer's process: a Unix socket for terminals, and the topic with the exercises.

`Trainer` decides.
"""

from pipelines.session.process import Context
from pipelines.session.terminals import serve_terminals
from pipelines.session.topic_ends import NumberedTopic
from pipelines.session.topology import TRAINER_TOPIC
from pipelines.session.training import TRAINER_DESK, Trainer, TrainerReach

_OCTETS = 4096


def run_trainer(context: Context) -> None:
    """Take requests, and publish what lasts."""
    trainer = Trainer(context.probe, TrainerReach.of(context.topology))
    context.on_flush(trainer.tell)
    with context.open_bus() as bus:
        writer = NumberedTopic(bus, TRAINER_TOPIC, max_octets=_OCTETS)

        def publish(now_ns: int) -> None:
            if (exercises := trainer.poll_exercises(now_ns)) is not None:
                writer.publish_octets(exercises.pack(), now_ns)

        serve_terminals(context, TRAINER_DESK, trainer.desk, publish)
