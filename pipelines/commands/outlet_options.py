"""The options by which other programs get what a session has: Foxglove, Prometheus, ROS 2."""

import argparse
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import session_root
from pipelines.session.output import say
from pipelines.session.page_sockets import PageListener, listeners
from pipelines.session.served_pages import (
    ServerWish,
    bound_server,
    parse_page,
    served,
    write_private,
)
from pipelines.session.topology import FOXGLOVE, METRICS, ROS2
from telepresence.haptics.specs import ROS2_HAND

_FOXGLOVE_PORT, _METRICS_PORT, _ROS2_PORT = "8765", "9270", "7447"
_MOST_DOMAIN = 232


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


def bound_foxglove(args: argparse.Namespace) -> ServerWish | None:
    """Bind what the option asks for; ConfigError if that cannot be."""
    return None if args.foxglove is None else bound_server(args.foxglove, FOXGLOVE, "--foxglove")


@contextmanager
def announced_foxglove(
    wish: ServerWish | None, session: str, *, quiet: bool
) -> Iterator[Mapping[str, PageListener]]:
    """Make tokens and certificate, print the addresses, and yield the listeners by process.

    The addresses are also in `foxglove.json` in the session's directory.
    """
    if wish is None:
        yield {}
        return
    root = session_root(session)
    with served(wish, root, "foxglove") as (found, made):
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
    wish = bound_server(args.metrics, METRICS, "--metrics")
    return listeners(wish.sockets, wish.host, None)


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
