"""What `stream` is asked to run: setup, ends, joystick and robots, components, and tasks."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

from kontur_av.errors import ConfigError, refused
from kontur_av.hosts import split_address
from pipelines.commands.common import say_unprotected
from pipelines.commands.live_session import made_directory
from pipelines.hand.safety_ends import within
from pipelines.link.own_ends import PeerPlan, chosen_end
from pipelines.mission.mission import TaskOptions, listed_tasks
from pipelines.mission.supervisor import session_dictionary
from pipelines.session.option_rows import refuse_options
from pipelines.session.options import OPTIONS, StreamOptions, asked_setup, is_given
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import RtcLeg, Setup
from pipelines.session.topology.table import SessionOptions, Topology
from pipelines.session.topology.topics import JOYSTICK, PAGES, TASKS
from pipelines.table import topology_of
from telepresence.haptics.device.gamepad import asked_map
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import (
    SIMULATED,
    capabilities_of,
    check_joystick,
    check_robot,
    is_simulated,
)
from telepresence.tasks.cosmonaut import Skill
from telepresence.tasks.plan import TaskWorld
from telepresence.tasks.task_files import load_plan, load_tasks
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.routes import TelemetryRoute, read_routes
from telepresence.tmtc.telemetry_source import Component, load_components


def chosen_setup(args: StreamOptions) -> Setup:
    """The setup that the options name, with what they change; ConfigError if it cannot work.

    A user's robot brings its own sources for inputs of the setup, its marks and its limits.
    """
    setup = asked_setup(args)
    if args.second_robot != SIMULATED_ROBOT and setup.partner_arm != "second":
        raise ConfigError(
            f"--second-robot {args.second_robot}: setup {setup.name} has no partner's arm; "
            'give one whose partner_arm is "second"'
        )
    if args.rtc is not None and setup.rtc is None:
        setup = replace(setup, rtc=RtcLeg())
    metadata = None if args.end == Segment.SPACE.value else capabilities_of(args.robot)
    if metadata is None:
        return setup
    inputs = {row.name for row in topology_of(setup).inputs}
    own = {name: spec for name, spec in metadata.sources.items() if name in inputs}
    return replace(
        setup,
        sources={**own, **setup.sources},
        marks={**metadata.marks, **setup.marks},
        safety=within(setup.safety, metadata),
    )


def checked_components(
    args: StreamOptions, setup: Setup, segments: Sequence[Segment]
) -> tuple[Component, ...]:
    """Check the joystick and the robots of these ends, and return the components; ConfigError."""
    if Segment.SPACE in segments:
        check_joystick(args.joystick, setup.more_axes, asked_map(args.joystick_map))
    if Segment.GROUND in segments:
        check_robot(args.robot, setup.more_axes, felt=setup.force == "felt")
        check_robot(args.second_robot)
    say_unprotected(args.joystick, args.robot)
    return load_components(args.telemetry, built_in_dictionary())


def load_routes(path: Path | None) -> tuple[TelemetryRoute, ...]:
    """Return the routes of a file; none without one. ConfigError, with its line."""
    if path is None:
        return ()
    with refused(f"cannot read routes {path}"):
        octets = path.read_bytes()
    with refused(f"routes {path}", ConfigError):
        return read_routes(octets)


def asked_topology(
    args: StreamOptions, plan: Topology, components: tuple[Component, ...], *, tasks: bool
) -> Topology:
    """The table of the session: `plan` with all that the options ask for."""
    asked = {
        field.name: is_given(args, field.name) if field.type is bool else getattr(args, field.name)
        for field in fields(SessionOptions)
        if field.name in OPTIONS
    }
    pages = args.page is not False
    asked |= {"pages": pages, "recorder": True, "tasks": tasks, "components": components}
    asked["routes"] = load_routes(args.routes)
    asked["joystick_map"] = asked_map(args.joystick_map)
    topology = topology_of(plan.setup, segments=plan.segments, **asked)
    with refused(f"routes {args.routes}", ConfigError):
        session_dictionary(built_in_dictionary(), topology)
    return topology


def task_options(
    args: StreamOptions, setup: Setup, segments: Sequence[Segment], *, make: bool = True
) -> TaskOptions | None:
    """What the options request; None for a session without tasks. ConfigError.

    make: whether to make the directory of the runs.
    """
    if args.plan is None and args.tasks is None and not setup.tasks:
        refuse_options(args, " is for tasks: give --tasks or --plan, too", "leds", "runs")
        return None
    metadata = capabilities_of(args.robot) if Segment.GROUND in segments else None
    # Space alone does not know the ground's robot.
    two_hands = metadata.two_hands if metadata is not None else Segment.GROUND not in segments
    world = TaskWorld(
        cameras=setup.cameras,
        setup=setup.name,
        two_hands=two_hands and setup.partner_arm == "second",
        measures=metadata is None or metadata.force == "felt",
    )
    files = args.tasks or ()
    if args.plan is None:
        plan, catalogue = None, load_tasks(files)
    elif files:
        raise ConfigError("--plan names its files itself: leave those of --tasks out")
    else:
        plan, catalogue = load_plan(args.plan)
        plan.check(catalogue, world)
    simulated = is_simulated(args.joystick)
    if plan is None and (len(segments) == 1 or args.leds is not None):
        # Its eyes need both; people do without it.
        simulated = False
    if simulated and len(segments) == 1:
        raise ConfigError(
            "a simulated cosmonaut sees the LED panel on one machine only: leave --end out, or "
            "give --tasks at both ends, and --joystick page or evdev in space"
        )
    if simulated and args.leds is not None:
        raise ConfigError(
            "a simulated cosmonaut sees only the built-in LED panel: leave --leds out"
        )
    if setup.partner_arm == "shared":
        raise ConfigError('tasks are the cosmonaut\'s: take a setup with partner_arm = "none"')
    if args.runs is not None and args.record is not None:
        raise ConfigError("--runs and --record want the same recorder: give one of them")
    leds = None if args.leds is None else split_address(args.leds, "--leds")
    runs = args.runs and made_directory(args.runs, "--runs", make=make)
    return TaskOptions(
        catalogue=catalogue,
        plan=plan,
        leds=leds,
        runs=None if runs is None else str(runs.resolve()),
        simulated=simulated,
        world=world,
    )


def task_arguments(options: TaskOptions | None) -> Mapping[str, Mapping[str, object]]:
    """By process, what it needs to know of the request."""
    if options is None:
        return {}
    arguments: dict[str, dict[str, object]] = {
        TASKS: {"options": options},
        PAGES[Segment.SPACE]: {"tasks": listed_tasks(options.catalogue, options.world)},
    }
    if options.simulated:
        plan = options.plan
        skill = Skill().level if plan is None else plan.skill
        arguments[JOYSTICK] = {"skill": skill, "taps": plan is None}
    return arguments


def inputs_here(topology: Topology) -> tuple[str, ...]:
    """The names of the inputs that are captured on this machine."""
    return tuple(row.name for row in topology.inputs if topology.runs(row.process))


def ends_here(args: StreamOptions, setup: Setup) -> tuple[Topology, PeerPlan | None]:
    """The table of the ends that run here, and the only one if it is alone.

    ConfigError for the first option of `stream` that belongs to the other end.
    """
    plan = topology_of(setup)
    one = chosen_end(args, plan)
    if one is not None:
        plan = replace(plan, segments=(one.segment,))
        _check_own_options(args, plan, one.segment)
    return plan, one


def _check_own_options(args: StreamOptions, topology: Topology, end: Segment) -> None:
    if end is Segment.GROUND and (args.joystick != SIMULATED or args.joystick_map):
        raise ConfigError("--joystick: the joystick is in space; give it at --end space")
    if end is Segment.SPACE:
        why = ": a partner joins the ground; give it at --end ground"
        refuse_options(args, why, "rtc", "rtc_token_file", "rtc_hand_token_file", "ice_server")
    here = inputs_here(topology)
    for option in args.source:
        name = option.partition("=")[0]
        if name not in here:
            raise ConfigError(
                f"--source {option}: {name} is captured at --end {end.peer.value}; "
                f"this end has {', '.join(here) or 'no input'}"
            )
    radio = topology.setup.radio_profile
    if radio.timed and not (args.trainer and end is Segment.SPACE):
        raise ConfigError(
            f"radio {radio.name} changes with time, and both ends would have a time of their own: "
            "give it at --end space with --trainer, and none at --end ground"
        )
    if args.bypass:
        raise ConfigError("--bypass: both ends must be here; leave --end out")
