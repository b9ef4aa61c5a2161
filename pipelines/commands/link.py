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
from pipelines.report.live import link_report_of, link_view
from pipelines.report.report_file import check_writable, end_report
from pipelines.session.command_process import say
from pipelines.session.launcher import Launcher
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options, asked_setup, stream_options
from pipelines.session.setup.segments import Segment
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
    if not args.quiet:
        table = ports_table(topology, ends, addresses.apps_bind, addresses.apps)
        say("\n".join([*([] if one is None else [path_line(one)]), *table.lines(200)]))
    given = {
        "addresses": addresses,
        "peer": one,
        "publish_backlog": False,
    }
    view = link_view(collector, ends, seed=args.seed, quiet=args.quiet)
    launcher = Launcher(
        session="link",
        topology=topology,
        processes=[topology.gateway(end) for end in ends],
        arguments={topology.gateway(end).name: given for end in ends},
        clock=MonotonicClock(),
        listener=collector,
        seed=args.seed,
        show=with_status(view.show, collector, ends[0]),
    )
    with view:
        launcher.run(args.seconds)
    for udp in held:
        udp.close()
    report = link_report_of(launcher, collector, ends, seed=args.seed)
    return end_report(report, args.report, quiet=args.quiet)
