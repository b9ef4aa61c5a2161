"""`kontur-av maintain`: run a sequence of commands, each of which is confirmed."""

import argparse
import select
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.commands.common import acting_on
from pipelines.mission.tmtc_socket import TMTC_SOCKETS
from pipelines.session.command_process import say
from pipelines.session.option_rows import add_options
from pipelines.session.requests import running_sessions
from pipelines.upkeep.sequence import MaintenanceSequence, StepOutcome
from pipelines.upkeep.sequence_runner import (
    MaintenanceLog,
    SequenceRunner,
    SessionWatch,
    own_command,
)

#: Those that end by themselves and need no terminal.
COMMANDS = (
    *("apploader", "devices", "doctor", "export", "file", "info", "authority", "joystick", "keys"),
    *("recover", "report", "robot", "select", "stop", "task", "tc", "topology", "versions"),
)
#: Those of them that act on a session: that of `maintain`, unless the step names another.
OF_SESSION = ("file", "authority", "select", "stop", "task", "tc")
_LOOK_S = 0.5
_KEYS = "Enter: run it, e: change it, s: skip it, q: end"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "script SCRIPT <Path>  a command of kontur-av a line, without that word; also wait "
        "SECONDS, wait contact, say TEXT, milestone TEXT",
        "--yes  confirm all; end at a failure",
        "--log FILE <Path>  append what was sent and received, as JSON lines (default SCRIPT.log)",
        "--session",
    )
    parser.description = (
        "Run the commands of a script one by one; each may be changed, and must be confirmed. "
        "None is run during an experiment."
    )


def run(args: argparse.Namespace) -> int:
    """0 if every step is done or skipped; else 1."""
    try:
        lines = args.script.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text"
        raise ConfigError(f"{args.script}: cannot be read: {reason}") from None
    sequence = MaintenanceSequence(lines, COMMANDS)
    if not args.yes and not sys.stdin.isatty():
        raise ConfigError("nobody can confirm here: start it in a terminal, or with --yes")
    running = running_sessions(*TMTC_SOCKETS)
    with ExitStack() as stack:
        log = stack.enter_context(MaintenanceLog(args.log or Path(f"{args.script}.log")))
        watch = None
        if running or args.session:
            name = acting_on(args.session, running, moves=True)
            watch = stack.enter_context(SessionWatch(name))
        runner = SequenceRunner(
            sequence, log, command=own_command(), say=say, watch=watch, of_session=OF_SESSION
        )
        log.write("begin", script=str(args.script), session="" if watch is None else watch.name)
        while (step := sequence.next) is not None:
            contact = runner.look()
            say(f"{sequence.number}/{len(sequence)} {step.text}{contact and f'  [{contact}]'}")
            answer = "" if args.yes else _asked(runner.look)
            if answer == "q":
                break
            if answer == "e":
                _change(sequence)
            elif answer == "s":
                runner.skip(step)
            elif answer:
                say(_KEYS)
            elif (obstacle := runner.obstacle()) != "":
                print(f"kontur-av: {obstacle}", file=sys.stderr)
                if args.yes:
                    break
            elif runner.run(step) is StepOutcome.FAILED and args.yes:
                break
    return 0 if sequence.next is None else 1


def _asked(look: Callable[[], str]) -> str:
    """Return a person's answer. look: called while waiting, so that announcements are in time."""
    print(f"[{_KEYS}] ", end="", flush=True)
    while not select.select([sys.stdin], [], [], _LOOK_S)[0]:
        look()
    try:
        return input().strip().lower()
    except EOFError:
        return "q"


def _change(sequence: MaintenanceSequence) -> None:
    try:
        sequence.change(input("instead: "))
    except EOFError:
        return
    except ConfigError as error:
        print(f"kontur-av: {error}", file=sys.stderr)
