"""`kontur-av task`: list, select, start and abort the tasks of a running session."""

import argparse
from random import SystemRandom

from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus
from pipelines.commands.common import acting_on, situation_now
from pipelines.commands.tc import follow
from pipelines.mission.tmtc_messages import SendCommand
from pipelines.mission.tmtc_socket import Sending, tmtc_socket_name
from pipelines.session.mission_messages import MISSION_GROUND_TOPIC, ExperimentShown
from pipelines.session.option_rows import add_options
from pipelines.session.requests import running_sessions
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader
from pipelines.session.topology.topics import TASKS
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

_CLIENT = "kontur-av task"
_TIMEOUT_NS = 2_000_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "action <list|select|start|abort>  list: the tasks, and where the present one is; select: "
        "prepare the robot, and tell the cosmonaut; start: in the cosmonaut's place",
        "task TASK <?>  which one to select",
        "--session",
    )
    parser.description = "Do what an experimenter does in a session with --tasks or --plan."


def run(args: argparse.Namespace) -> int:
    """0 once it is done; else 1."""
    if (args.task is not None) != (args.action == "select"):
        if args.action == "select":
            raise ConfigError("task select: name the task; `kontur-av task list` lists them")
        raise ConfigError(f"task {args.action} takes no name")
    running = running_sessions(tmtc_socket_name(Segment.GROUND))
    lacks = "here without its ground end, which has the tasks: ask on the ground's machine"
    session = acting_on(args.session, running, moves=args.action != "list", lacks=lacks)
    with TopicBus.join(session) as bus:
        shown = _shown(bus, session)
        if args.action == "list":
            _print(shown)
            if (told := situation_now(session)) is not None:
                print(told.words)
            return 0
        arguments: tuple[int, ...] = ()
        if args.action == "select":
            names = [task.name for task in shown.tasks]
            if args.task not in names:
                raise ConfigError(f"unknown task {args.task}: choose one of {', '.join(names)}")
            arguments = (names.index(args.task),)
        request = SendCommand(
            _CLIENT, SystemRandom().getrandbits(48), TASKS, "call", args.action, arguments
        )
        application = built_in_dictionary().application(TASKS)
        return follow(Sending(session, Segment.GROUND, request, bus), application)


def _shown(bus: TopicBus, session: str) -> ExperimentShown:
    if MISSION_GROUND_TOPIC in bus.topics():
        reader = TopicReader(bus, MISSION_GROUND_TOPIC)
        for _ in range(20):
            if (shown := reader.latest()) is not None:
                return shown
            reader.open().wait(_TIMEOUT_NS // 20)
    raise ConfigError(f"session {session} has no tasks: start it with --tasks or --plan PLAN.toml")


def _print(shown: ExperimentShown) -> None:
    for task in shown.tasks:
        lacks = f" Not available: it {task.lacks}." if task.lacks else ""
        print(f"{task.name:<10} {task.text}{lacks}")
    present = f"{shown.task}, run {shown.run}: {shown.phase}" if shown.task else shown.phase
    elemop = f", {shown.elemop}" if shown.elemop else ""
    print(f"now: {present}{elemop}")
    for run in shown.runs:
        took = "" if run.seconds is None else f" after {run.seconds:.1f} s"
        why = f": {run.reason}" if run.reason else ""
        print(f"run {run.run} {run.task}: {run.result}{took}{why}")
