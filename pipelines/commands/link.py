"""`kontur-av link`: the radio link alone, for any programs; both of its ends, or one."""

import argparse
import ipaddress
import shutil
import socket
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands.common import add_seconds_argument, check_options
from pipelines.commands.end_options import (
    add_end_arguments,
    check_one_machine,
    chosen_end,
    hold_listen_port,
    path_line,
)
from pipelines.commands.live_session import say_failures, with_status
from pipelines.link.peer_socket import PeerPlan
from pipelines.report.collector import Collector
from pipelines.report.link_report import LinkView, build_link_report, summary_lines
from pipelines.report.report_file import check_writable, save_report
from pipelines.session.addresses import resolve
from pipelines.session.datagrams import (
    LOOPBACK,
    Address,
    EndAddresses,
    is_loopback,
    obstacle,
    reaches,
)
from pipelines.session.launcher import Launcher, hold_port, launcher_cpu_s
from pipelines.session.options import (
    add_radio_arguments,
    add_setup_argument,
    setup_changes,
)
from pipelines.session.output import say
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.topology import Segment, Topology
from pipelines.session.topology.tables import ports_table
from pipelines.table import topology_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_setup_argument(parser)
    add_radio_arguments(parser, delay=False)
    add_seconds_argument(parser)
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    parser.add_argument("--base-port", type=int, metavar="P", help="first of the 40 UDP ports")
    add_end_arguments(parser)
    parser.add_argument("--apps", metavar="HOST", help="where the programs run, if not here")
    parser.add_argument(
        "--apps-bind", metavar="ADDRESS", help="this machine's address that they send to"
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="show nothing but mistakes")


def run(args: argparse.Namespace) -> int:
    """Run the link until it is told to end; 1 if its report names a failure."""
    setup = load_setup(
        args.setup,
        changes=setup_changes(args),
        radio_start_s=args.radio_start,
    )
    check_options(args)
    topology = topology_of(setup)
    one = chosen_end(args, topology)
    ends = list(Segment) if one is None else [one.segment]
    addresses = chosen_addresses(args)
    check_writable(args.report)
    if one is not None:
        hold_listen_port(one)
    held = [hold_link_ports(topology, end, addresses, alone=one is not None) for end in ends]
    collector = Collector(topology)
    screen = _LinkScreen(LinkView(setup, ends), collector, quiet=args.quiet)
    if one is not None:
        screen.show_lines([path_line(one)])
    screen.show_lines(ports_table(topology, ends, addresses.apps_bind, addresses.apps).lines(200))
    launcher = Launcher(
        session="link",
        topology=topology,
        processes=[topology.gateway(end) for end in ends],
        arguments=gateway_arguments(topology, ends, addresses, None if one is None else one.plan),
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
    )
    saved = save_report(args.report, report)
    screen.show_lines(summary_lines(report))
    if args.quiet:
        say_failures(report.failures)
    return 1 if report.failures or not saved else 0


def gateway_arguments(
    topology: Topology, ends: Sequence[Segment], addresses: EndAddresses, peer: PeerPlan | None
) -> Mapping[str, Mapping[str, object]]:
    given = {"addresses": addresses, "peer": peer, "tell_backlog": False}
    return {topology.gateway(end).name: given for end in ends}


def chosen_addresses(args: argparse.Namespace) -> EndAddresses:
    """Return the addresses of the programs; ConfigError if they cannot work."""
    if args.apps is None:
        if args.apps_bind is not None:
            raise ConfigError("--apps-bind goes with --apps HOST, the machine of the programs")
        return EndAddresses()
    apps = resolve(args.apps, args.apps, "--apps", socket.AF_INET)
    check_one_machine("--apps", args.apps, apps)
    return EndAddresses(apps=apps, apps_bind=_bound_address(args, (apps, 9)))


def _bound_address(args: argparse.Namespace, other: Address) -> str:
    """Return the local address in `--apps-bind`; without it loopback, if `other` is on loopback."""
    if args.apps_bind is not None:
        try:
            bind = str(ipaddress.IPv4Address(args.apps_bind))
        except ValueError:
            raise ConfigError(
                f"--apps-bind {args.apps_bind!r}: write an IPv4 address of this machine, or "
                "0.0.0.0 for all"
            ) from None
        why = obstacle(bind, other)
        if why is not None:
            own = reaches(other)
            mend = "" if own is None else f"; use --apps-bind {own}"
            raise ConfigError(
                f"--apps {args.apps} cannot be reached from --apps-bind {bind}: {why}{mend}"
            )
        return bind
    if is_loopback(other[0]):
        return LOOPBACK
    own = reaches(other)
    if own is None:
        raise ConfigError(f"{args.apps} cannot be reached from here: check address and network")
    raise ConfigError(
        f"{args.apps} is another machine, and --apps-bind is missing: "
        f"add --apps-bind {own}, the address by which this one is reached from there"
    )


def hold_link_ports(
    topology: Topology, end: Segment, addresses: EndAddresses, *, alone: bool
) -> socket.socket:
    """Hold one port of an end and check the others. Raises ConfigError if one is busy.

    The port is held while the returned socket is open. So of two ends that start at the same moment
    only one gets it.

    alone: the other end is on another machine, so the setup's radio port is not used.
    """
    held = hold_port(topology.launcher_port + (end is Segment.SPACE))
    radio_port = topology.radio_port(end)
    for port in topology.ports_of(topology.gateway(end).name):
        if port != radio_port:
            hold_port(port, addresses.apps_bind).close()
        elif not alone:
            hold_port(port).close()
    return held


class _LinkScreen:
    """Standard output: on a terminal the lines of figures are overwritten in place."""

    def __init__(self, view: LinkView, collector: Collector, *, quiet: bool) -> None:
        self._view = view
        self._collector = collector
        self._quiet = quiet
        self._terminal = sys.stdout.isatty()
        self._shown = 0

    def show(self, launcher: Launcher) -> None:
        if self._quiet:
            return
        width = shutil.get_terminal_size().columns - 1 if self._terminal else None
        lines = self._view.lines(self._collector, launcher.seconds, width)
        if not self._terminal:
            print("  ".join(lines), flush=True)
            return
        up = f"\x1b[{self._shown}A" if self._shown else ""
        print(up + "".join(f"\x1b[K{line[:width]}\n" for line in lines), end="", flush=True)
        self._shown = len(lines)

    def show_lines(self, lines: Sequence[str]) -> None:
        """Lines that stay."""
        if not self._quiet:
            say("\n".join(lines))
