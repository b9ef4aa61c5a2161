"""`kontur-av trainer`: give a running session an exercise."""

import argparse
import sys
from collections.abc import Sequence

from pipelines.commands.common import acting_on
from pipelines.session.option_rows import add_actions
from pipelines.session.requests import ask, running_sessions
from pipelines.session.setup.former_names import INPUTS, current
from pipelines.session.training import (
    CAMERA,
    END,
    EXERCISES,
    TRAINER_SOCKET,
    TrainerAnswer,
    TrainerRequest,
)

_LACKS = "without a trainer: start it with --trainer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    camera = "camera NAME  such as operator_camera"
    exercises: dict[str, Sequence[str]] = {
        name: (
            *(text, camera)[: 1 + (name == CAMERA)],
            f"seconds S <float?={seconds}>  seconds (default {seconds:g})",
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
    session = acting_on(args.session, running, moves=True, lacks=_LACKS)
    try:
        print(ask(session, TRAINER_SOCKET, request, TrainerAnswer).text)
    except OSError as error:
        print(f"kontur-av: {error}", file=sys.stderr)
        return 1
    return 0
