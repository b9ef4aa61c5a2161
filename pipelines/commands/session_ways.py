"""How people and other programs reach a session: pages, a partner, outlets, packets and files."""

import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import session_root
from pipelines.commands.live_session import made_directory
from pipelines.commands.rtc_options import ice_servers_of
from pipelines.files.process_files import FilesPlan
from pipelines.files.service_sockets import bound_services, checked_services
from pipelines.packets.process_packets import checked_packets, parse_frames
from pipelines.session.command_process import say
from pipelines.session.option_rows import refuse_options
from pipelines.session.options import FILES_BPS, FILES_KBPS, RTC_PORT, StreamOptions
from pipelines.session.page_sockets import HAND_TOKEN, PageListener, listeners
from pipelines.session.served_pages import (
    ServerOptions,
    announce,
    announced_pages,
    base_url,
    bound_pages,
    bound_server,
    parse_page,
    served,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    FILES,
    FOXGLOVE,
    FRAMES,
    METRICS,
    PACKETS,
    PAGES,
    ROS2,
    RTC,
)
from telepresence.haptics.specs import ROS2_HAND
from telepresence.private_file import read_secret

_MOST_DOMAIN = 232
#: By process, what its function takes; and its listener.
_Arguments = Mapping[str, Mapping[str, object]]
_Listeners = Mapping[str, PageListener]
#: Announces a server in a session, and yields its listener by process.
_Announced = Callable[[str], AbstractContextManager[_Listeners]]


def bound_rtc(args: StreamOptions, setup: Setup, segments: Sequence[Segment]) -> list[_Announced]:
    """Bind what the options ask for; nothing without a leg on this machine.

    ConfigError for options that cannot work, and for an address that cannot be had.
    """
    if setup.rtc is None or Segment.GROUND not in segments:
        why = "give --rtc, too" if setup.rtc is None else "the leg is at the ground's end"
        why = f" belongs to a partner: {why}"
        refuse_options(args, why, "rtc", "rtc_token_file", "rtc_hand_token_file", "ice_server")
        return []
    token, hand_token = (
        read_secret(path, option) if path is not None else secrets.token_urlsafe(24)
        for option, path in (
            ("--rtc-token-file", args.rtc_token_file),
            ("--rtc-hand-token-file", args.rtc_hand_token_file),
        )
    )
    if hand_token == token:
        raise ConfigError("--rtc-hand-token-file: write another token than --rtc-token-file has")
    server = bound_server(args.rtc or RTC_PORT, RTC, option="--rtc", certificate=args.page_cert)
    people = {} if setup.partner_arm == "none" else {HAND_TOKEN: hand_token}
    return [partial(_announced_rtc, server, token, people, quiet=args.quiet)]


@contextmanager
def _announced_rtc(
    server: ServerOptions, token: str, people: Mapping[str, str], session: str, *, quiet: bool
) -> Iterator[_Listeners]:
    """Make the certificate, print the addresses, and yield the listener by process.

    They are also in `rtc.json` in the session's directory, for programs of this user.
    """
    root = session_root(session)
    with served(server, root, "rtc") as (by_name, made):
        listener = replace(by_name[RTC], operator_token=token, people=people)
        page = listener.url(RTC)
        kept = {"page": page, "base": base_url(listener, RTC), "token": token}
        kept |= {f"{name}_token": hand_token for name, hand_token in people.items()}
        lines = [f"partner {page}", *(f"its token to steer: {token}" for token in people.values())]
        announce(root / "rtc.json", kept, lines, made, quiet=quiet)
        yield {RTC: listener}


@contextmanager
def _announced_foxglove(
    server: ServerOptions, session: str, *, quiet: bool
) -> Iterator[_Listeners]:
    """Make tokens and certificate, print the addresses, and yield the listeners by process.

    The addresses are also in `foxglove.json` in the session's directory.
    """
    root = session_root(session)
    with served(server, root, "foxglove") as (by_name, made):
        listener = by_name[FOXGLOVE]
        url = listener.url(FOXGLOVE).replace("http", "ws", 1)
        watch = url.replace(listener.operator_token, listener.viewer_token)
        kept = {"foxglove": url, "watch": watch}
        lines = [f"foxglove {url}", f"to watch only: {watch}"]
        announce(root / "foxglove.json", kept, lines, made, quiet=quiet)
        yield by_name


@contextmanager
def _announced_metrics(server: ServerOptions, _: str, *, quiet: bool) -> Iterator[_Listeners]:
    """Print the address, and yield the listener by process. It has no TLS."""
    by_name = listeners(server.sockets, server.host, None)
    if not quiet:
        say(f"metrics {by_name[METRICS].url('metrics').partition('?')[0]}")
    with by_name[METRICS].socket:
        yield by_name


def ros2_arguments(args: StreamOptions) -> Mapping[str, Mapping[str, object]]:
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


def files_arguments(
    args: StreamOptions, segments: Sequence[Segment], *, make: bool = True
) -> Mapping[str, Mapping[str, object]]:
    """Return by process what the options say; ConfigError. make: whether to make directories."""
    if args.files is None:
        if args.files_rate is not None:
            raise ConfigError("--files-rate is for --files: give the directory, too")
        return {}
    text = args.files_rate or FILES_KBPS
    rates = re.fullmatch(r"(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if rates is None or not all(1 <= float(group) <= 10_000 for group in rates.groups()):
        raise ConfigError(f"--files-rate {text}: give two rates, from 1 to 10000 kbit/s")
    by_segment = dict(zip(FILES_BPS, rates.groups(), strict=True))
    found: dict[str, Mapping[str, object]] = {}
    directories = {}
    for segment in segments:
        directory = made_directory(args.files / segment.value, "--files", make=make)
        rate_bps = round(float(by_segment[segment]) * 1000)
        directories[segment] = directory
        found[FILES[segment]] = {"plan": FilesPlan(directory=directory, rate_bps=rate_bps)}
    return found | {PAGES[Segment.GROUND]: {"files": directories}}


class SessionWays:
    """What the options ask for, with its ports bound; ConfigError if that cannot be.

    dry: make no directories, and bind any ports.
    """

    def __init__(self, args: StreamOptions, topology: Topology, *, dry: bool = False) -> None:
        segments, setup = topology.segments, topology.setup
        self._args, self._topology = args, topology
        self._arguments = {
            **ros2_arguments(args),
            FRAMES: {"address": parse_frames(args.frames)},
            RTC: {"servers": ice_servers_of(args)},
        }
        self._packets = checked_packets(args, topology)
        checked_services(args, segments)
        self._files = files_arguments(args, segments, make=not dry)
        self._pages = bound_pages(args, segments)
        self._servers = bound_rtc(args, setup, segments)
        if args.metrics is not None:
            if find_spec(package := "prometheus_client") is None:
                raise ConfigError(f"--metrics needs {package}: pip install 'kontur-av[metrics]'")
            server = bound_server(args.metrics, METRICS, option="--metrics")
            self._servers.append(partial(_announced_metrics, server, quiet=args.quiet))
        if args.foxglove is not None:
            server = bound_server(args.foxglove, FOXGLOVE, option="--foxglove")
            self._servers.append(partial(_announced_foxglove, server, quiet=args.quiet))

    @contextmanager
    def opened(self, session: str) -> Iterator[tuple[_Listeners, _Arguments]]:
        """Print the addresses, and yield what the processes get; at the end all is closed."""
        options = self._topology.options
        with (
            bound_services(self._args, self._files, self._topology.segments) as maintenance,
            announced_pages(self._pages, session, self._args, options) as pages,
            ExitStack() as opened,
            self._packets as packets,
        ):
            by_process = dict(pages)
            for announced in self._servers:
                by_process |= opened.enter_context(announced(session))
            yield by_process, {**self._arguments, **maintenance, PACKETS: {"plan": packets}}
