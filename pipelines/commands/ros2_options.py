"""The option of a session as a node of a ROS 2 system."""

import argparse
import os
from collections.abc import Mapping
from importlib.util import find_spec

from kontur_av.errors import ConfigError
from pipelines.commands.common import output_that_may_fail
from pipelines.commands.page_options import parse_page
from pipelines.session.topology import ROS2
from telepresence.haptics.device.spec import ROS2_HAND

_PORT = "7447"
_MOST_DOMAIN = 232


def add_ros2_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ros2",
        metavar="[HOST:]PORT",
        nargs="?",
        const=_PORT,
        help="be a node of a ROS 2 system, by the router of rmw_zenoh at this place (default "
        f"127.0.0.1:{_PORT}), in the domain of ROS_DOMAIN_ID; everyone who reaches the router can "
        "see and hear the session",
    )


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
        with output_that_may_fail():
            moves = " and move the robot" if args.joystick == ROS2_HAND else ""
            print(
                f"ros2 domain {text}, router {router}: every node there can see the session{moves}",
                flush=True,
            )
    return {ROS2: {"router": router, "domain": int(text)}}
