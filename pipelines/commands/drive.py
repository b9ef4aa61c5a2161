"""`kontur-av joystick drive`: a partner's joystick, beside the robot or across the Internet.

`serve_robot.py` uses the same way for a partner's robot.
"""

import argparse
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import sessions
from pipelines.commands.check_results import SETUP_ROW, axes_of
from pipelines.commands.common import say_unprotected
from pipelines.commands.rtc_options import ICE, ice_servers_of, token_of
from pipelines.hand.haptic_loop import new_boot_id
from pipelines.hand.partner_arm import run_side, told
from pipelines.partner.whip import Far
from pipelines.session.datagrams import Outlet, OwnOutlet, listen_alone, own_path
from pipelines.session.option_rows import add_options, refuse_options
from pipelines.session.options import add_session_options, stream_options
from pipelines.session.setup.table import Setup
from pipelines.session.topology.streams import PARTNER_GIVEN, PARTNER_TAKEN
from telepresence.haptics.bilateral import JoystickSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.hand import Hand
from telepresence.haptics.loop import joystick_link
from telepresence.haptics.specs import SIMULATED, open_alone

#: Of a setup, by who comes.
_ARMS = {"joystick": '"shared" or "second"', "robot": '"board"'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"--device SPEC <={SIMULATED}>  as of `stream --joystick`; no page, no ros2 (default: sim)",
        SETUP_ROW,
    )
    add_way_arguments(parser)


def add_way_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that say where the session is, and for how long."""
    add_options(
        parser,
        f"--base-port P <port={Setup.base_port}>  first of the 40 UDP ports",
        "--rtc URL  a session across the Internet: what `stream --rtc` prints, up to the port",
        "--token",
        "--token-file",
    )
    add_session_options(parser, *ICE, "seconds")


def drive(args: argparse.Namespace) -> int:
    """Drive the robot until it is stopped; 0 if the robot has answered, else 1."""
    spec, seconds = args.device, args.seconds
    say_unprotected(spec)
    axes = axes_of(args.setup) or ()
    device = open_alone(spec, hand=Hand(), axes=axes)
    try:
        handle = OperatedHandle(device, axes=axes)
        link = joystick_link(boot_id=new_boot_id(), more=len(axes))
        side = JoystickSide(link=link, handle=handle)
        with reached(args, "joystick") as way:
            run_side(side, lambda now_ns: handle.handle_feedback(link.latest(now_ns)), way, seconds)
    finally:
        device.close()
    return told(side, "robot")


@contextmanager
def reached(
    args: argparse.Namespace, who: str
) -> Iterator[tuple[socket.socket, Outlet | OwnOutlet]]:
    """The socket on which the peer's samples come, and where those of `who` go."""
    token, servers = token_of(args), ice_servers_of(stream_options(args), may_be_named=True)
    if args.rtc is not None:
        with Far(args.rtc, token, servers, who=who) as far:
            yield far.own, far.to_session
        return
    why = " is for the way across the Internet: give --rtc URL, too"
    refuse_options(args, why, "token", "token_file", "ice_server")
    own, to_session = _open(args.base_port, who)
    with closing(own):
        yield own, to_session


def _open(base_port: int, who: str) -> tuple[socket.socket, OwnOutlet]:
    taken, given = base_port + PARTNER_TAKEN, base_port + PARTNER_GIVEN
    for session in sessions():
        if Path(own_path(session, taken)).exists():
            own = listen_alone(session, given)
            if own is None:
                raise ConfigError(f"another {who} is at session {session}: end it first")
            return own, OwnOutlet(session, taken)
    raise ConfigError(
        f"--base-port {base_port}: no session of yours has a partner there; start one whose setup "
        f"has partner_arm = {_ARMS[who]}, or give its base port"
    )
