"""How people and other programs reach a session: pages, a partner, outlets, packets and files."""

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from pipelines.commands.files_options import (
    add_files_arguments,
    add_services_arguments,
    files_arguments,
)
from pipelines.commands.outlet_options import (
    add_outlet_arguments,
    announced_foxglove,
    announced_metrics,
    bound_foxglove,
    bound_metrics,
    ros2_arguments,
)
from pipelines.commands.packets_options import add_packets_arguments, checked_packets, parse_frames
from pipelines.commands.rtc_leg import add_rtc_arguments, announced_rtc, bound_rtc
from pipelines.files.service_sockets import bound_services, services_wish
from pipelines.session.page_sockets import PageListener
from pipelines.session.served_pages import add_page_arguments, announced_pages, bound_pages
from pipelines.session.topology import FRAMES, PACKETS, RTC, Topology

#: By process: its listener, and what else its function takes.
_Opened = tuple[Mapping[str, PageListener], Mapping[str, Mapping[str, object]]]


def add_way_arguments(parser: argparse.ArgumentParser) -> None:
    add_page_arguments(parser)
    add_rtc_arguments(parser)
    add_outlet_arguments(parser)
    add_packets_arguments(parser)
    add_files_arguments(parser)
    add_services_arguments(parser)


class SessionWays:
    """What the options ask for, with its ports bound; ConfigError if that cannot be."""

    def __init__(self, args: argparse.Namespace, topology: Topology) -> None:
        segments = topology.segments
        self._args, self._topology = args, topology
        self._given = {**ros2_arguments(args), FRAMES: {"address": parse_frames(args.frames)}}
        self._packets = checked_packets(args, topology)
        self._services = services_wish(args, segments)
        self._files = files_arguments(args, segments)
        self._pages = bound_pages(args, segments)
        self._rtc = bound_rtc(args, topology.setup, segments)
        self._metrics = bound_metrics(args)
        self._foxglove = bound_foxglove(args)

    @contextmanager
    def opened(self, session: str) -> Iterator[_Opened]:
        """Print the addresses, and yield what the processes get; at the end all is closed."""
        quiet, options = self._args.quiet, self._topology.options
        with (
            bound_services(self._services, self._files) as maintenance,
            announced_pages(
                self._pages, session, quiet=quiet, tasks=options.tasks, trainer=options.trainer
            ) as pages,
            announced_rtc(self._rtc, session, quiet=quiet) as partners,
            announced_metrics(self._metrics, quiet=quiet),
            announced_foxglove(self._foxglove, session, quiet=quiet) as foxglove,
            self._packets as packets,
        ):
            leg = {} if self._rtc is None else {RTC: {"servers": self._rtc.servers}}
            arguments = {**self._given, **maintenance, **leg, PACKETS: {"plan": packets}}
            yield {**pages, **partners, **self._metrics, **foxglove}, arguments
