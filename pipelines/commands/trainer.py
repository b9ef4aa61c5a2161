"""`kontur-av trainer`: give a running session an exercise."""

import argparse
import sys
from collections.abc import Sequence

from kontur_av.errors import ConfigError
from pipelines.commands.common import acting_on
from pipelines.session.option_rows import add_actions
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.terminals import running_sessions, send_request
from pipelines.session.training import (
    CAMERA,
    END,
    EXERCISES,
    TRAINER_SOCKET,
    TrainerAnswer,
    TrainerRequest,
)

_MISSING = (
    "no session here has a trainer: start it with --trainer, "
    "as `kontur-av stream --setup spacejustin --end space --trainer`"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    camera = "camera NAME  the camera, such as operator_camera"
    exercises: dict[str, Sequence[str]] = {
        name: (
            *(text, camera)[: 1 + (name == CAMERA)],
            f"seconds S <float?={seconds}>  for S seconds (default {seconds:g})",
            "--session",
        )
        for name, (text, seconds) in EXERCISES.items()
    }
    end = ("end all exercises at once", "--session")
    add_actions(parser, {**exercises, END: end}, "exercise")


def run(args: argparse.Namespace) -> int:
    """0 once the session has begun the exercise; 1 if it did not answer."""
    request = TrainerRequest(
        exercise=args.exercise,
        seconds=getattr(args, "seconds", 0.0),
        camera=current(getattr(args, "camera", ""), INPUTS),
    )
    running = running_sessions(TRAINER_SOCKET)
    session = acting_on(args.session, running, moves=True) if running else None
    answer = send_request(TRAINER_SOCKET, request, TrainerAnswer, session, missing=_MISSING)
    if answer is None:
        print("kontur-av: the session's trainer has ended before it answered", file=sys.stderr)
        return 1
    if answer.mistake:
        raise ConfigError(answer.text)
    if not answer.ok:
        print(f"kontur-av: {answer.text}", file=sys.stderr)
        return 1
    print(answer.text)
    return 0
