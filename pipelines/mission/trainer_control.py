"""How a session's trainer is found and asked."""

from pathlib import Path

from pipelines.session.asking import ask_desk, desk_path
from pipelines.session.training import (
    TrainerAnswer,
    TrainerRequest,
    pack_line,
    parse_trainer_answer,
)

TRAINER_DESK = "trainer"


def trainer_path(session: str) -> Path:
    """Return the path of the Unix socket of `session`'s trainer."""
    return desk_path(session, TRAINER_DESK)


def ask_trainer(request: TrainerRequest, session: str | None) -> TrainerAnswer:
    """Send a request to the trainer of a session, and return its answer.

    session: a name as of `choose_session`. Raises ConfigError if no session has a trainer.
    """
    missing = (
        "no session here has a trainer: start it with --trainer, "
        "as `kontur-av stream --setup spacejustin --end space --trainer`"
    )
    answer = parse_trainer_answer(
        ask_desk(TRAINER_DESK, pack_line(request), session, missing=missing)
    )
    if answer is None:
        return TrainerAnswer(ok=False, text="the session's trainer has ended before it answered")
    return answer
