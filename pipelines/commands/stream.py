"""`kontur-av stream`: a whole telepresence session on this machine, and its report."""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands.common import add_seconds_argument, check_options, say_unprotected
from pipelines.commands.end_options import add_end_arguments, check_own_options, inputs_here
from pipelines.commands.files_options import (
    add_files_arguments,
    add_services_arguments,
    files_arguments,
)
from pipelines.commands.live_session import (
    add_live_arguments,
    end_session,
    made_directory,
    with_status,
)
from pipelines.commands.outlet_options import (
    add_outlet_arguments,
    announced_foxglove,
    announced_metrics,
    bound_foxglove,
    bound_metrics,
    ros2_arguments,
)
from pipelines.commands.packets_options import add_packets_arguments, bound_packets, parse_frames
from pipelines.commands.record import add_record_arguments, wish_of
from pipelines.commands.rtc_leg import (
    RtcWish,
    add_rtc_arguments,
    announced_rtc,
    bound_rtc,
    with_rtc,
)
from pipelines.commands.task_options import TaskWish, add_task_arguments, task_arguments, task_wish
from pipelines.files.service_sockets import bound_services, services_wish
from pipelines.link.own_ends import chosen_end, hold_listen_port, path_line
from pipelines.link.peer_socket import PeerPlan
from pipelines.recording.part_files import (
    LEAST_RECORDED_S,
    check_disk,
    check_recordable,
    clear_parts,
)
from pipelines.report.collector import Collector
from pipelines.report.live import LiveView
from pipelines.report.report_file import check_writable
from pipelines.report.seat_feed import SeatFeed
from pipelines.session.launcher import Launcher, hold_ports, load_libraries
from pipelines.session.options import (
    add_deadband_argument,
    add_hand_argument,
    add_radio_arguments,
    add_setup_argument,
    add_source_argument,
    asked_setup,
)
from pipelines.session.output import say
from pipelines.session.recorder_control import write_wish
from pipelines.session.served_pages import add_page_arguments, announced_pages, bound_pages
from pipelines.session.sessions import clear_dead_sessions, hold_session
from pipelines.session.setup.sources import (
    check_room,
    check_sources,
    draw_backgrounds,
)
from pipelines.session.setup.table import Setup
from pipelines.session.topology import FRAMES, PACKETS, RECORDER, RTC, Segment, Topology
from pipelines.table import topology_of
from telepresence.haptics.device.spec import SIMULATED, check_joystick
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.robot_spec import check_robot, facts_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.telemetry_source import load_components


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av stream`."""
    add_setup_argument(parser)
    add_seconds_argument(parser)
    add_source_argument(
        parser,
        "a media file, mcap:FILE#CHANNEL, pipe:PATH, v4l2:DEVICE, alsa:DEVICE, scene:NAME, page "
        "for a browser page alone, or topic for a program",
    )
    add_live_arguments(parser)
    add_record_arguments(parser)
    add_radio_arguments(parser)
    add_deadband_argument(parser)
    add_hand_argument(parser)
    add_end_arguments(parser)
    parser.add_argument(
        "--trainer",
        action="store_true",
        help="heed `kontur-av trainer`; with --end space, the radio of both directions is here",
    )
    parser.add_argument(
        "--bypass",
        action="store_true",
        help="for tests, with both ends here: join the programs directly, past gateways and radio",
    )
    parser.add_argument(
        "--joystick",
        default=SIMULATED,
        metavar="SPEC",
        help="sim, page (the hand at the operator's page), ros2 (a node's), evdev, "
        "evdev:/dev/input/eventN, udp:HOST:PORT[:KEYFILE] or your own: module:Class (default: "
        "sim); see `kontur-av joystick list`",
    )
    parser.add_argument(
        "--robot",
        default=SIMULATED_ROBOT,
        metavar="SPEC",
        help="sim, udp:HOST:PORT[:KEYFILE] or your own: module:Class (default: sim)",
    )
    parser.add_argument(
        "--telemetry",
        action="append",
        default=[],
        metavar="SPEC",
        help="your component in telemetry: module:Class, at both ends; repeatable",
    )
    parser.add_argument(
        "--second-robot",
        default=SIMULATED_ROBOT,
        metavar="SPEC",
        help="the partner's arm, as --robot",
    )
    add_task_arguments(parser)
    add_page_arguments(parser)
    add_rtc_arguments(parser)
    add_outlet_arguments(parser)
    add_packets_arguments(parser)
    add_files_arguments(parser)
    add_services_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the session; 1 if its report names a failure."""
    setup = with_rtc(args, chosen_setup(args))
    check_options(args)
    plan = topology_of(setup)
    one = chosen_end(args, plan)
    plan = replace(plan, segments=tuple(Segment) if one is None else (one.segment,))
    check_own_options(args, plan)
    if args.bypass and one is not None:
        raise ConfigError("--bypass: both ends must be here; leave --end out")
    inputs = inputs_here(plan)
    check_sources(setup, inputs, pages=not args.no_page)
    if Segment.SPACE in plan.segments:
        check_joystick(args.joystick, setup.more_axes)
    if Segment.GROUND in plan.segments:
        check_robot(args.robot, setup.more_axes)
        check_robot(args.second_robot)
    say_unprotected(args.joystick, args.robot)
    ros2 = ros2_arguments(args)
    frames = parse_frames(args.frames)
    services = services_wish(args, plan.segments)
    files = files_arguments(args, plan.segments)
    components = load_components(args.telemetry, built_in_dictionary())
    tasks = task_wish(args, setup, plan.segments)
    snapshots = made_directory(args.snapshots, "--snapshots")
    check_writable(args.report)
    wish = wish_of(args, held=False)
    if wish is not None:
        check_recordable(Path(wish.file), overwrite=args.overwrite, sources=setup.sources.values())
        check_disk(Path(wish.file), setup, args.seconds or LEAST_RECORDED_S)
    clear_dead_sessions()
    check_room(setup, inputs, pages=not args.no_page)
    topology = topology_of(
        setup,
        joystick=args.joystick,
        robot=args.robot,
        second_robot=args.second_robot,
        snapshots=snapshots is not None,
        pages=not args.no_page,
        recorder=True,
        trainer=args.trainer,
        tasks=tasks is not None,
        metrics=args.metrics is not None,
        foxglove=args.foxglove is not None,
        packets=args.packets is not None,
        frames=args.frames is not None,
        ros2=bool(ros2),
        files=bool(files),
        bypass=args.bypass,
        components=components,
        segments=plan.segments,
    )
    page_wish = bound_pages(args, plan.segments)
    rtc_wish = bound_rtc(args, setup, plan.segments)
    metrics = bound_metrics(args)
    foxglove_wish = bound_foxglove(args)
    if one is not None:
        hold_listen_port(one)
    # After all in which an option could be wrong, whatever other sessions have.
    held = hold_ports(topology)
    load_libraries()
    clock = MonotonicClock()
    draw_backgrounds(setup, inputs, clock)
    collector = Collector(topology)
    if one is not None and not args.quiet:
        say(path_line(one))
    with (
        hold_session(setup.name, end="" if one is None else one.segment.value) as session,
        bound_services(services, files) as maintenance,
        announced_pages(
            page_wish,
            session,
            quiet=args.quiet,
            tasks=tasks is not None,
            trainer=args.trainer,
        ) as pages,
        announced_rtc(rtc_wish, session, quiet=args.quiet) as partners,
        announced_metrics(metrics, quiet=args.quiet),
        announced_foxglove(foxglove_wish, session, quiet=args.quiet) as foxglove,
        bound_packets(args, topology) as packets,
        LiveView(collector, quiet=args.quiet, verbose=args.verbose) as view,
    ):
        if wish is not None:
            clear_parts(Path(wish.file))
            write_wish(session, wish)
        feed = SeatFeed(collector)
        launcher = Launcher(
            session=session,
            topology=topology,
            processes=topology.processes_here,
            awaited=None if wish is None else RECORDER,
            arguments={
                **_arguments(topology, None if one is None else one.plan, rtc_wish, tasks),
                PACKETS: {"plan": packets},
                FRAMES: {"address": frames},
                **ros2,
                **maintenance,
            },
            clock=clock,
            listener=collector,
            snapshots=snapshots,
            seed=args.seed,
            show=with_status(view.show, collector, plan.segments[0], feed.log),
            pages={**pages, **partners, **metrics, **foxglove},
            feed=feed,
        )
        launcher.run(args.seconds)
    held.close()
    return end_session(args, collector, launcher)


def _arguments(
    topology: Topology, peer: PeerPlan | None, rtc: RtcWish | None, tasks: TaskWish | None
) -> Mapping[str, Mapping[str, object]]:
    """By process, what the options say of it.

    The gateway of one end knows how to reach its peer.
    """
    arguments = {**task_arguments(tasks)}
    if rtc is not None:
        arguments[RTC] = {"servers": rtc.servers}
    if topology.alone is not None:
        arguments[topology.gateway(topology.alone).name] = {"peer": peer}
    return arguments


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
    facts = None if args.end == Segment.SPACE.value else facts_of(args.robot)
    if facts is None:
        return setup
    inputs = {row.name for row in topology_of(setup).inputs}
    own = {name: spec for name, spec in facts.sources.items() if name in inputs}
    return replace(setup, sources={**own, **setup.sources})
