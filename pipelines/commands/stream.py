"""`kontur-av stream`: a whole telepresence session on this machine, and its report."""

import argparse
import sys
from pathlib import Path

from kontur_av.clock import MonotonicClock
from pipelines.commands.common import check_options
from pipelines.commands.end_options import add_session_end_arguments, ends_here, inputs_here
from pipelines.commands.live_session import (
    add_live_arguments,
    end_session,
    made_directory,
    with_status,
)
from pipelines.commands.record import add_record_arguments, checked_options
from pipelines.commands.session_parts import (
    add_part_arguments,
    add_task_arguments,
    asked_topology,
    checked_components,
    chosen_setup,
    task_arguments,
    task_options,
)
from pipelines.commands.session_ways import SessionWays, add_way_arguments
from pipelines.link.own_ends import hold_listen_port, path_line
from pipelines.recording.part_files import clear_parts
from pipelines.report.collector import Collector
from pipelines.report.live import LiveView
from pipelines.report.report_file import check_writable
from pipelines.report.seat_feed import SeatFeed
from pipelines.session.command_process import say
from pipelines.session.kept_files import keep_latch
from pipelines.session.launcher import Launcher, hold_ports, load_libraries
from pipelines.session.option_rows import add_options
from pipelines.session.options import (
    add_deadband_argument,
    add_hand_argument,
    add_radio_arguments,
    add_setup_argument,
    add_source_argument,
)
from pipelines.session.recording_requests import write_request
from pipelines.session.sessions import clear_dead_sessions, hold_session
from pipelines.session.setup.sources import check_room, check_sources, draw_backgrounds
from pipelines.session.topology import RECORDER, Segment


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av stream`."""
    add_setup_argument(parser)
    add_options(parser, "--seconds")
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
    add_session_end_arguments(parser)
    add_part_arguments(parser)
    add_task_arguments(parser)
    add_way_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the session; 1 if its report names a failure."""
    setup = chosen_setup(args)
    check_options(args)
    plan, one = ends_here(args, setup)
    inputs, pages = inputs_here(plan), not args.no_page
    check_sources(setup, inputs, pages=pages)
    components = checked_components(args, setup, plan.segments)
    tasks = task_options(args, setup, plan.segments)
    check_writable(args.report)
    options = checked_options(args, setup)
    clear_dead_sessions()
    check_room(setup, inputs, pages=pages)
    topology = asked_topology(args, plan, components, tasks=tasks is not None)
    ways = SessionWays(args, topology)
    if one is not None:
        hold_listen_port(one)
    # After all in which an option could be wrong, whatever other sessions have.
    held = hold_ports(topology)
    snapshots = made_directory(args.snapshots, "--snapshots")
    load_libraries()
    clock = MonotonicClock()
    draw_backgrounds(setup, inputs, clock)
    collector = Collector(topology)
    if one is not None and not args.quiet:
        say(path_line(one))
    peer = {} if one is None else {topology.gateway(one.segment).name: {"peer": one.plan}}
    with (
        hold_session(setup.name, end="" if one is None else one.segment.value) as session,
        ways.opened(session) as (listeners, arguments),
        LiveView(collector, quiet=args.quiet, verbose=args.verbose) as view,
    ):
        # A stop belongs to the robot: whole sessions and those of the ground have the same.
        here = Segment.GROUND in plan.segments
        robot = topology.options.robot if here else Segment.SPACE.value
        if held_by := keep_latch(session, setup.name, robot):
            print(f"kontur-av: {held_by}", file=sys.stderr, flush=True)
        if options is not None:
            clear_parts(Path(options.file))
            write_request(session, options)
        feed = SeatFeed(collector)
        launcher = Launcher(
            session=session,
            topology=topology,
            processes=topology.processes_here,
            awaited=None if options is None else RECORDER,
            arguments={**task_arguments(tasks), **arguments, **peer},
            clock=clock,
            listener=collector,
            snapshots=snapshots,
            seed=args.seed,
            show=with_status(view.show, collector, plan.segments[0], feed.log),
            pages=listeners,
            feed=feed,
        )
        launcher.run(args.seconds)
    held.close()
    return end_session(args, collector, launcher)
