"""`kontur-av stream`: a whole telepresence session on this machine, and its report."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from kontur_av.clock import MonotonicClock
from pipelines.commands.common import check_options
from pipelines.commands.live_session import end_session, made_directory, with_status
from pipelines.commands.record import checked_options, recording_line
from pipelines.commands.session_parts import (
    asked_topology,
    checked_components,
    chosen_setup,
    ends_here,
    inputs_here,
    task_arguments,
    task_options,
)
from pipelines.commands.session_ways import SessionWays
from pipelines.link.own_ends import hold_listen_port, path_line
from pipelines.recording.part_files import clear_parts
from pipelines.report.collector import Collector
from pipelines.report.live import session_view
from pipelines.report.report_file import check_writable
from pipelines.report.session_feed import SessionFeed
from pipelines.session.command_process import keep_words_apart, print_data, say
from pipelines.session.kept_files import keep_latch
from pipelines.session.launcher import Launcher, hold_ports, load_libraries
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_grouped_options
from pipelines.session.recording_requests import write_request
from pipelines.session.sessions import clear_dead_sessions, hold_session
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.sources import check_room, check_sources, draw_backgrounds
from pipelines.session.site_file import SiteOptions, blamed, site_options
from pipelines.session.topology.topics import RECORDER


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av stream`."""
    add_options(
        parser,
        "site FILE.toml <Path?>  a site file: any of the options below (docs/setup-file.md)",
        "--explain  print what would run, and where each value comes from",
    )
    add_grouped_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the session; 1 if its report names a failure."""
    site = site_options(args)
    keep_words_apart(site.options)
    with blamed(site.settings):
        return _run(site, dry=args.explain)


def _run(site: SiteOptions, *, dry: bool) -> int:
    args = site.options
    setup = chosen_setup(args)
    check_options(args)
    plan, end = ends_here(args, setup)
    inputs, pages = inputs_here(plan), args.page is not False
    check_sources(setup, inputs, pages=pages)
    components = checked_components(args, setup, plan.segments)
    tasks = task_options(args, setup, plan.segments, make=not dry)
    check_writable(args.report)
    if args.snapshots is not None:
        made_directory(args.snapshots, "--snapshots", make=False)
    recording = checked_options(args, setup)
    if not dry:
        clear_dead_sessions()
    check_room(setup, inputs, pages=pages)
    topology = asked_topology(args, plan, components, tasks=tasks is not None)
    quiet = replace(args, verbose=False, quiet=True)
    ways = SessionWays(quiet if dry else args, topology, dry=dry)
    if dry:
        print_data(site.explained(setup) + "\n")
        return 0
    if end is not None:
        hold_listen_port(end)
    # After all in which an option could be wrong, whatever other sessions have.
    held = hold_ports(topology)
    snapshots = args.snapshots and made_directory(args.snapshots, "--snapshots")
    load_libraries()
    clock = MonotonicClock()
    draw_backgrounds(setup, inputs, clock)
    collector = Collector(topology)
    feed = SessionFeed(collector)
    if end is not None and not args.quiet:
        say(path_line(end))
    peer = {} if end is None else {topology.gateway(end.segment).name: {"peer": end}}
    with (
        hold_session(setup.name, end="" if end is None else end.segment.value) as session,
        ways.opened(session) as (listeners, arguments),
        session_view(feed, quiet=args.quiet, verbose=args.verbose) as view,
    ):
        # A stop belongs to the robot: whole sessions and those of the ground have the same.
        here = Segment.GROUND in plan.segments
        robot = topology.options.robot if here else Segment.SPACE.value
        if held_by := keep_latch(session, setup.name, robot):
            print(f"kontur-av: {held_by}", file=sys.stderr, flush=True)
        if recording is not None:
            clear_parts(Path(recording.file))
            write_request(session, recording)
            if not args.quiet:
                say(recording_line(recording, setup))
        launcher = Launcher(
            session=session,
            topology=topology,
            processes=topology.processes_here,
            awaited=None if recording is None else RECORDER,
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
