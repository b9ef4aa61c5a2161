"""How people and other programs reach a session: pages, a partner, outlets, packets and files."""

import argparse
import json
import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec

from kontur_av.errors import ConfigError, refused
from kontur_av.topics.session_files import session_root
from pipelines.commands.rtc_options import add_ice_arguments, ice_servers_of
from pipelines.files.file_requests import RATES_BPS
from pipelines.files.process_files import FilesPlan
from pipelines.files.service_sockets import ALLOW, LISTEN, bound_services, services_options
from pipelines.packets.process_packets import add_packets_arguments, checked_packets, parse_frames
from pipelines.partner.ice_servers import IceServers
from pipelines.session.command_process import say
from pipelines.session.option_rows import add_options
from pipelines.session.page_sockets import HAND_TOKEN, PageListener, listeners
from pipelines.session.served_pages import (
    ServerOptions,
    add_page_arguments,
    announced_pages,
    base_url,
    bound_pages,
    bound_server,
    parse_page,
    served,
    write_private,
)
from pipelines.session.setup.table import Setup
from pipelines.session.topology import (
    FILES,
    FOXGLOVE,
    FRAMES,
    METRICS,
    PACKETS,
    PAGES,
    ROS2,
    RTC,
    Segment,
    Topology,
)
from telepresence.haptics.specs import ROS2_HAND
from telepresence.private_file import read_secret

_FOXGLOVE_PORT, _METRICS_PORT, _ROS2_PORT, _RTC_PORT = "8765", "9270", "7447", "8290"
_MOST_DOMAIN = 232
_FILES_RATES = ",".join(f"{RATES_BPS[one] / 1000:g}" for one in (Segment.GROUND, Segment.SPACE))
#: By process: its listener, and what else its function takes.
_Opened = tuple[Mapping[str, PageListener], Mapping[str, Mapping[str, object]]]


@dataclass(frozen=True, kw_only=True)
class RtcOptions:
    """The leg as the options ask for it. servers: of each connection.

    token, hand_token: "" for a new one. hand_token: None where nobody steers.
    """

    server: ServerOptions
    token: str
    hand_token: str | None
    servers: Callable[[], IceServers]


def add_rtc_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"--rtc [HOST:]PORT <?={_RTC_PORT}>  serve a partner across the Internet by WebRTC: it "
        "sees and hears both sides, and is seen and heard at the ground (default "
        f"127.0.0.1:{_RTC_PORT}); TLS beyond loopback",
        "--rtc-token-file FILE <Path>  the partner's token to watch and to send (default: a new "
        "one for each session)",
        "--rtc-hand-token-file FILE <Path>  its token to steer (default: a new one for each "
        "session)",
    )
    add_ice_arguments(parser)


def bound_rtc(
    args: argparse.Namespace, setup: Setup, segments: tuple[Segment, ...]
) -> RtcOptions | None:
    """Bind what the options ask for; None without a leg on this machine.

    ConfigError for options that cannot work, and for an address that cannot be had.
    """
    servers = ice_servers_of(args)
    if setup.rtc is None or Segment.GROUND not in segments:
        given = (args.rtc, args.rtc_token_file, args.rtc_hand_token_file, args.ice_server)
        if any(one is not None for one in given):
            why = "give --rtc, too" if setup.rtc is None else "the leg is at the ground's end"
            raise ConfigError(f"--rtc-token-file and --ice-server belong to a partner: {why}")
        return None
    token, hand_token = (
        "" if path is None else read_secret(path, option)
        for option, path in (
            ("--rtc-token-file", args.rtc_token_file),
            ("--rtc-hand-token-file", args.rtc_hand_token_file),
        )
    )
    if hand_token and hand_token == token:
        raise ConfigError("--rtc-hand-token-file: write another token than --rtc-token-file has")
    server = bound_server(args.rtc or _RTC_PORT, RTC, "--rtc", args.page_cert)
    steers = setup.partner_arm != "none"
    return RtcOptions(
        server=server, token=token, hand_token=hand_token if steers else None, servers=servers
    )


@contextmanager
def announced_rtc(
    options: RtcOptions | None, session: str, *, quiet: bool
) -> Iterator[Mapping[str, PageListener]]:
    """Make token and certificate, print the addresses, and yield the listener by process.

    They are also in `rtc.json` in the session's directory, for programs of this user.
    """
    if options is None:
        yield {}
        return
    root = session_root(session)
    with served(options.server, root, "rtc") as (found, made):
        listener = found[RTC]
        if options.token:
            listener = replace(listener, operator_token=options.token)
        if options.hand_token is not None:
            hand_token = options.hand_token or secrets.token_urlsafe(24)
            listener = replace(listener, people={HAND_TOKEN: hand_token})
        told = {
            "page": listener.url(RTC),
            "base": base_url(listener, RTC),
            "token": listener.operator_token,
            **(
                {"hand_token": listener.people[HAND_TOKEN]} if HAND_TOKEN in listener.people else {}
            ),
        }
        write_private(root / "rtc.json", json.dumps(told, indent=1) + "\n")
        if not quiet:
            lines = [f"partner {told['page']}"]
            if HAND_TOKEN in listener.people:
                lines.append(f"its token to steer: {listener.people[HAND_TOKEN]}")
            if made:
                lines.append(f"its certificate was made for this session: {made}")
            say("\n".join(lines))
        yield {RTC: listener}


def add_outlet_arguments(parser: argparse.ArgumentParser) -> None:
    texts = {
        "--metrics": "serve all figures to Prometheus at /metrics, and /healthz (default "
        f"127.0.0.1:{_METRICS_PORT}); everyone who reaches the port can read them",
        "--foxglove": "serve the channels of a recording to Foxglove and Lichtblick "
        f"(default 127.0.0.1:{_FOXGLOVE_PORT}); TLS beyond loopback",
        "--ros2": "be a node of a ROS 2 system, by the router of rmw_zenoh at this place (default "
        f"127.0.0.1:{_ROS2_PORT}), in the domain of ROS_DOMAIN_ID; everyone who reaches the "
        "router can see and hear the session",
    }
    ports = (_METRICS_PORT, _FOXGLOVE_PORT, _ROS2_PORT)
    for (option, text), port in zip(texts.items(), ports, strict=True):
        parser.add_argument(option, metavar="[HOST:]PORT", nargs="?", const=port, help=text)


@contextmanager
def announced_foxglove(
    options: ServerOptions | None, session: str, *, quiet: bool
) -> Iterator[Mapping[str, PageListener]]:
    """Make tokens and certificate, print the addresses, and yield the listeners by process.

    The addresses are also in `foxglove.json` in the session's directory.
    """
    if options is None:
        yield {}
        return
    root = session_root(session)
    with served(options, root, "foxglove") as (found, made):
        listener = found[FOXGLOVE]
        url = listener.url(FOXGLOVE).replace("http", "ws", 1)
        watch = url.replace(listener.operator_token, listener.viewer_token)
        write_private(root / "foxglove.json", json.dumps({"foxglove": url, "watch": watch}) + "\n")
        if not quiet:
            say(f"foxglove {url}\nto watch only: {watch}")
            if made:
                say(f"certificate made for foxglove, SHA-256 {made}")
        yield found


def bound_metrics(args: argparse.Namespace) -> Mapping[str, PageListener]:
    """Bind what the option asks for, by process; ConfigError if that cannot be."""
    if args.metrics is None:
        return {}
    if find_spec("prometheus_client") is None:
        raise ConfigError("--metrics needs prometheus-client: pip install 'kontur-av[metrics]'")
    options = bound_server(args.metrics, METRICS, "--metrics")
    return listeners(options.sockets, options.host, None)


@contextmanager
def announced_metrics(bound: Mapping[str, PageListener], *, quiet: bool) -> Iterator[None]:
    """Print the address; close the sockets at the end."""
    for listener in bound.values():
        if not quiet:
            say(f"metrics {listener.url('metrics').partition('?')[0]}")
    try:
        yield
    finally:
        for listener in bound.values():
            listener.socket.close()


def ros2_arguments(args: argparse.Namespace) -> Mapping[str, Mapping[str, object]]:
    """Return by process what the option says; ConfigError if that cannot be."""
    if args.ros2 is None:
        if args.joystick == ROS2_HAND:
            raise ConfigError(f"--joystick {ROS2_HAND} needs --ros2: a node moves it")
        return {}
    if find_spec("zenoh") is None or find_spec("rosbags") is None:
        raise ConfigError("--ros2 needs eclipse-zenoh and rosbags: pip install 'kontur-av[ros2]'")
    place, port = parse_page(args.ros2, "--ros2")
    host = f"[{place.address}]" if ":" in place.address else place.address
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (text.isdecimal() and int(text) <= _MOST_DOMAIN):
        raise ConfigError(f"ROS_DOMAIN_ID={text}: set a number from 0 to {_MOST_DOMAIN}")
    router = f"tcp/{host}:{port}"
    if not args.quiet:
        moves = " and move the robot" if args.joystick == ROS2_HAND else ""
        say(f"ros2 domain {text}, router {router}: every node there can see the session{moves}")
    return {ROS2: {"router": router, "domain": int(text)}}


def add_files_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--files DIR <Path>  carry files: the ground's end has DIR/ground, space has DIR/space; "
        "see `kontur-av file`",
        "--files-rate UP,DOWN  the most that files take, in kbit/s from the ground and from space "
        f"(default {_FILES_RATES}); media always go first",
        f"{LISTEN} NAME=PORT <*>  lead TCP connections to PORT of this machine to the other end's "
        "service NAME; with both ends here, from the ground to space; needs --files; repeatable",
        f"{ALLOW} NAME=HOST:PORT <*>  let the other end connect to HOST:PORT as service NAME; "
        "repeatable",
    )


def files_arguments(
    args: argparse.Namespace, segments: Sequence[Segment]
) -> Mapping[str, Mapping[str, object]]:
    """Return by process what the options say, and make the directories; ConfigError."""
    if args.files is None:
        if args.files_rate is not None:
            raise ConfigError("--files-rate is for --files: give the directory, too")
        return {}
    text = args.files_rate or _FILES_RATES
    rates = re.fullmatch(r"(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if rates is None or not all(1 <= float(one) <= 10_000 for one in rates.groups()):
        raise ConfigError(f"--files-rate {text}: give two rates, from 1 to 10000 kbit/s")
    by_segment = dict(zip((Segment.GROUND, Segment.SPACE), rates.groups(), strict=True))
    found: dict[str, Mapping[str, object]] = {}
    directories = {}
    for segment in segments:
        directory = args.files / segment.value
        with refused(f"--files {directory}"):
            directory.mkdir(parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise ConfigError(f"--files {directory}: cannot be written to; choose another one")
        directories[segment] = directory.absolute()
        plan = FilesPlan(
            directory=directories[segment], rate_bps=round(float(by_segment[segment]) * 1000)
        )
        found[FILES[segment]] = {"plan": plan}
    return found | {PAGES[Segment.GROUND]: {"files": directories}}


def add_way_arguments(parser: argparse.ArgumentParser) -> None:
    add_page_arguments(parser)
    add_rtc_arguments(parser)
    add_outlet_arguments(parser)
    add_packets_arguments(parser)
    add_files_arguments(parser)


class SessionWays:
    """What the options ask for, with its ports bound; ConfigError if that cannot be."""

    def __init__(self, args: argparse.Namespace, topology: Topology) -> None:
        segments = topology.segments
        self._args, self._topology = args, topology
        self._given = {**ros2_arguments(args), FRAMES: {"address": parse_frames(args.frames)}}
        self._packets = checked_packets(args, topology)
        self._services = services_options(args, segments)
        self._files = files_arguments(args, segments)
        self._pages = bound_pages(args, segments)
        self._rtc = bound_rtc(args, topology.setup, segments)
        self._metrics = bound_metrics(args)
        self._foxglove = None
        if args.foxglove is not None:
            self._foxglove = bound_server(args.foxglove, FOXGLOVE, "--foxglove")

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
