"""`kontur-av link`: the radio link alone, for any programs; both of its ends, or one."""

import argparse

from kontur_av.clock import MonotonicClock
from pipelines.commands.common import check_options
from pipelines.commands.live_session import with_status
from pipelines.link.own_ends import (
    chosen_addresses,
    chosen_end,
    hold_link_ports,
    hold_listen_port,
    path_line,
)
from pipelines.report.collector import Collector
from pipelines.report.link_report import LinkView, build_link_report, summary_lines
from pipelines.report.live import LinkScreen
from pipelines.report.report_file import check_writable, save_report, say_failures
from pipelines.report.seat_feed import processes_now
from pipelines.session.launcher import Launcher, launcher_cpu_s
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options, asked_setup, stream_options
from pipelines.session.topology import Segment
from pipelines.session.topology.tables import ports_table
from pipelines.table import topology_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session_options(parser, "setup!", "radio", "radio_start", "seed", "seconds", "report")
    add_session_options(parser, "base_port", "end", "listen", "peer", "key", "identity", "insecure")
    add_session_options(parser, "path", "path_batch_ms", "quiet")
    add_options(
        parser,
        "--apps HOST  where the programs run, if not here",
        "--apps-bind ADDRESS  this machine's address that they send to",
    )


def run(args: argparse.Namespace) -> int:
    """Run the link until it is told to end; 1 if its report names a failure."""
    options = stream_options(args)
    setup = asked_setup(options)
    check_options(args)
    topology = topology_of(setup)
    one = chosen_end(options, topology)
    ends = list(Segment) if one is None else [one.segment]
    addresses = chosen_addresses(args)
    check_writable(args.report)
    if one is not None:
        hold_listen_port(one)
    held = [hold_link_ports(topology, end, addresses, alone=one is not None) for end in ends]
    collector = Collector(topology)
    screen = LinkScreen(LinkView(setup, ends), collector, quiet=args.quiet)
    if one is not None:
        screen.show_lines([path_line(one)])
    screen.show_lines(ports_table(topology, ends, addresses.apps_bind, addresses.apps).lines(200))
    given = {
        "addresses": addresses,
        "peer": one,
        "publish_backlog": False,
    }
    launcher = Launcher(
        session="link",
        topology=topology,
        processes=[topology.gateway(end) for end in ends],
        arguments={topology.gateway(end).name: given for end in ends},
        clock=MonotonicClock(),
        listener=collector,
        seed=args.seed,
        show=with_status(screen.show, collector, ends[0]),
    )
    launcher.run(args.seconds)
    for udp in held:
        udp.close()
    report = build_link_report(
        collector,
        ends,
        seconds=launcher.seconds,
        seed=args.seed,
        cpu_s=launcher.cpu_s(),
        restarts={child.row.name: child.restarts for child in launcher.children},
        launcher_cpu_s=launcher_cpu_s(),
        processes=processes_now(launcher, most_restarts=0),
    )
    saved = save_report(args.report, report)
    screen.show_lines(summary_lines(report))
    if args.quiet:
        say_failures(report.failures)
    return 1 if report.failures or not saved else 0
