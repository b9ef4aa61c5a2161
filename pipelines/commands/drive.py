"""`kontur-av joystick drive`: a partner's joystick, beside the robot or across the Internet.

`serve_robot.py` uses the same way for a partner's robot.
"""

import argparse
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import sessions
from pipelines.commands.common import add_seconds_argument, say_unprotected
from pipelines.commands.rtc_options import (
    add_ice_arguments,
    add_token_arguments,
    ice_servers_of,
    token_of,
)
from pipelines.hand.haptic_loop import new_life
from pipelines.hand.haptics import CYCLE_NS
from pipelines.partner.far import Far
from pipelines.session.children import stopped_by_signals
from pipelines.session.datagrams import Outlet, OwnOutlet, listen_alone, own_path, receive
from pipelines.session.process import take_realtime
from pipelines.session.setup.table import Setup
from pipelines.session.topology import LOOP_PRIORITY
from pipelines.session.topology.streams import PARTNER_GIVEN, PARTNER_TAKEN
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.spec import PAGE, ROS2_HAND, SIMULATED, open_device
from telepresence.haptics.hand import Hand
from telepresence.haptics.loop import joystick_link
from telepresence.haptics.sample import SAMPLE_OCTETS
from telepresence.haptics.schedule import PeriodicSchedule

#: How often it looks whether the robot answers.
_LOOK_NS = 100 * NS_PER_MS
#: Of a setup, by who comes.
_ARMS = {"joystick": '"shared" or "second"', "robot": '"board"'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        default=SIMULATED,
        metavar="SPEC",
        help="sim, evdev, evdev:/dev/input/eventN or udp:HOST:PORT[:KEYFILE] (default: sim)",
    )
    add_way_arguments(parser)


def add_way_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that say where the session is, and for how long."""
    parser.add_argument(
        "--base-port",
        type=int,
        default=Setup.base_port,
        metavar="P",
        help="of this user's session",
    )
    parser.add_argument(
        "--rtc",
        metavar="URL",
        help="a session across the Internet: what `stream --rtc` prints, up to the port",
    )
    add_token_arguments(parser)
    add_ice_arguments(parser)
    add_seconds_argument(parser)


def drive(args: argparse.Namespace) -> int:
    """Drive the robot until it is stopped; 0 if the robot has answered, else 1."""
    spec, seconds = args.device, args.seconds
    if spec in (PAGE, ROS2_HAND):
        raise ConfigError(f"--device {spec}: its hand is in a session only; take sim or evdev")
    say_unprotected(spec)
    device = open_device(spec, hand=Hand())
    try:
        handle = OperatedHandle(device)
        link = joystick_link(life=new_life())
        side = JoystickSide(link=link, handle=handle)
        with reached(args, "joystick") as way:
            run_side(side, lambda now_ns: handle.handle_feedback(link.latest(now_ns)), way, seconds)
    finally:
        device.close()
    return told(side, "robot")


def told(side: JoystickSide | RobotSide, peer: str) -> int:
    """Print what went to the peer and came from it; return 0 if something came, else 1."""
    figures = side.link
    print(
        f"{figures.sent} samples to the {peer}, {figures.received} from it, "
        f"{figures.lost} lost, {figures.garbage} garbage"
    )
    return 0 if figures.received else 1


@contextmanager
def reached(
    args: argparse.Namespace, who: str
) -> Iterator[tuple[socket.socket, Outlet | OwnOutlet]]:
    """The socket on which the peer's samples come, and where those of `who` go."""
    token, servers = token_of(args), ice_servers_of(args, may_be_named=True)
    if args.rtc is not None:
        with Far(args.rtc, token, servers, who=who) as far:
            yield far.own, far.to_session
        return
    for option in ("token", "token_file", "ice_server"):
        if getattr(args, option) is not None:
            words = option.replace("_", "-")
            raise ConfigError(f"--{words} is for the way across the Internet: give --rtc URL, too")
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


def run_side(
    side: JoystickSide | RobotSide,
    before: Callable[[int], None],
    way: tuple[socket.socket, Outlet | OwnOutlet],
    seconds: float | None,
) -> None:
    """Run one side of the exchange at 1 kHz until it is stopped; before: called in each cycle."""
    own, to_session = way
    link = side.link
    who, peer = ("joystick", "robot") if isinstance(side, JoystickSide) else ("robot", "joystick")
    clock = MonotonicClock()
    now_ns = clock.now_ns()
    end_ns = None if seconds is None else now_ns + round(seconds * NS_PER_S)
    schedule = PeriodicSchedule(start_ns=now_ns, period_ns=CYCLE_NS)
    answers, look_ns = False, now_ns
    print(f"{who}: waiting for the {peer}; Ctrl-C ends", flush=True)
    take_realtime(LOOP_PRIORITY)
    with stopped_by_signals() as stopped:
        while not stopped() and (end_ns is None or now_ns < end_ns):
            clock.sleep_until_ns(schedule.next_deadline_ns)
            now_ns = clock.now_ns()
            if schedule.handle_wakeup(now_ns) < 0:
                continue
            while (datagram := receive(own, SAMPLE_OCTETS + 1)) is not None:
                side.handle_datagram(datagram, now_ns)
            before(now_ns)
            side.handle_cycle(now_ns, schedule.advance_ns)
            sample = side.poll_transmit(now_ns)
            if sample is not None:
                to_session.send(sample)
            if now_ns < look_ns:
                continue
            look_ns = now_ns + _LOOK_NS
            if link.hearing is not answers:
                answers = link.hearing
                print(f"{who}: the {peer} {'answers' if answers else 'is silent'}", flush=True)
