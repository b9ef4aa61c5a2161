"""What `stream` is asked to run: the setup, its joystick and robots, and the user's components."""

import argparse
from collections.abc import Sequence
from dataclasses import replace

from kontur_av.errors import ConfigError
from pipelines.commands.common import say_unprotected
from pipelines.session.option_rows import add_options
from pipelines.session.options import asked_setup
from pipelines.session.setup.table import RtcLeg, Setup
from pipelines.session.topology import Segment, Topology
from pipelines.table import topology_of
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import SIMULATED, check_joystick, check_robot, facts_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.telemetry_source import Component, load_components

#: What a session has once its option is given.
_WISHES = ("snapshots", "metrics", "foxglove", "packets", "frames", "ros2", "files")


def add_part_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"--joystick SPEC <={SIMULATED}>  sim, page (the hand at the operator's page), ros2 (a "
        "node's), evdev, evdev:/dev/input/eventN, udp:HOST:PORT[:KEYFILE] or your own: "
        "module:Class (default: sim); see `kontur-av joystick list`",
        f"--robot SPEC <={SIMULATED_ROBOT}>  sim, udp:HOST:PORT[:KEYFILE] or your own: "
        "module:Class (default: sim)",
        "--telemetry SPEC <*>  your component in telemetry: module:Class, at both ends; repeatable",
        f"--second-robot SPEC <={SIMULATED_ROBOT}>  the partner's arm, as --robot",
    )


def chosen_setup(args: argparse.Namespace) -> Setup:
    """The setup that the options name, with what they change; ConfigError if it cannot work.

    A user's robot brings its own sources for inputs of the setup.
    """
    setup = asked_setup(args)
    if args.second_robot != SIMULATED_ROBOT and setup.partner_arm != "second":
        raise ConfigError(
            f"--second-robot {args.second_robot}: setup {setup.name} has no partner's arm; "
            'give one whose partner_arm is "second"'
        )
    if args.rtc is not None and setup.rtc is None:
        setup = replace(setup, rtc=RtcLeg())
    facts = None if args.end == Segment.SPACE.value else facts_of(args.robot)
    if facts is None:
        return setup
    inputs = {row.name for row in topology_of(setup).inputs}
    own = {name: spec for name, spec in facts.sources.items() if name in inputs}
    return replace(setup, sources={**own, **setup.sources})


def checked_components(
    args: argparse.Namespace, setup: Setup, segments: Sequence[Segment]
) -> tuple[Component, ...]:
    """Check the joystick and the robots of these ends, and return the components; ConfigError."""
    if Segment.SPACE in segments:
        check_joystick(args.joystick, setup.more_axes)
    if Segment.GROUND in segments:
        check_robot(args.robot, setup.more_axes)
        check_robot(args.second_robot)
    say_unprotected(args.joystick, args.robot)
    return load_components(args.telemetry, built_in_dictionary())


def asked_topology(
    args: argparse.Namespace, plan: Topology, components: tuple[Component, ...], *, tasks: bool
) -> Topology:
    """The table of the session: `plan` with all that the options ask for."""
    return topology_of(
        plan.setup,
        joystick=args.joystick,
        robot=args.robot,
        second_robot=args.second_robot,
        pages=not args.no_page,
        recorder=True,
        trainer=args.trainer,
        tasks=tasks,
        bypass=args.bypass,
        components=components,
        segments=plan.segments,
        **{name: getattr(args, name) is not None for name in _WISHES},
    )
