"""The options of one end of a link that is split between two machines; whose an option is."""

import argparse
import ipaddress
import socket
from dataclasses import dataclass
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.link.key_files import default_key_path, pinned_peer, read_key
from pipelines.link.peer_socket import PeerPlan, Protection
from pipelines.session.addresses import parse_address
from pipelines.session.datagrams import Address, obstacle
from pipelines.session.launcher import hold_port
from pipelines.session.setup.table import Setup
from pipelines.session.topology import Segment, Topology
from telepresence.haptics.device.spec import SIMULATED

_ANY = "0.0.0.0"
#: What stays visible as long as an end runs with `--insecure`.
INSECURE = "this path is not protected: anybody on it can read, change and steer"


@dataclass(frozen=True, kw_only=True)
class EndChoice:
    """The end that runs here alone, and how it reaches the other."""

    segment: Segment
    plan: PeerPlan


def add_end_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--end",
        choices=[segment.value for segment in Segment],
        help="run this end alone; the other runs on another machine",
    )
    parser.add_argument(
        "--listen",
        metavar="ADDR:PORT",
        help="with --end: wait for the other end at this UDP port; 0.0.0.0 is every address",
    )
    parser.add_argument(
        "--peer", metavar="HOST:PORT", help="with --end: call the other end, which listens there"
    )
    parser.add_argument(
        "--key",
        type=Path,
        metavar="FILE",
        help="the private key; default: kontur-av/key.pem in the configuration directory",
    )
    parser.add_argument(
        "--identity",
        metavar="ID",
        help="with --end: the other machine's identity, if several are trusted",
    )
    parser.add_argument(
        "--insecure",
        action="store_true",
        help="with --end: neither encrypt nor authenticate; on a private network only",
    )


def chosen_end(args: argparse.Namespace, topology: Topology) -> EndChoice | None:
    """The end that the options name; None: both run here. ConfigError if it cannot work."""
    if args.end is None:
        for option in ("listen", "peer", "key", "identity", "insecure"):
            if getattr(args, option):
                raise ConfigError(
                    f"--{option} is for one end alone: add --end ground or --end space"
                )
        return None
    segment = Segment(args.end)
    bind, peer = _addresses(args, topology)
    return EndChoice(
        segment=segment, plan=PeerPlan(bind=bind, peer=peer, protection=_protection(args))
    )


def hold_listen_port(choice: EndChoice) -> None:
    """ConfigError if the port at which this end is to listen is busy."""
    address, port = choice.plan.bind
    hold_port(port, address).close()


def path_line(choice: EndChoice) -> str:
    """How this end reaches the other, in one line for people."""
    plan = choice.plan
    where = (
        f"listens at {plan.bind[0]}:{plan.bind[1]}"
        if plan.peer is None
        else f"calls {plan.peer[0]}:{plan.peer[1]}"
    )
    protection = plan.protection
    if protection is None:
        return f"{choice.segment.value} end {where}; WARNING: {INSECURE}"
    return f"{choice.segment.value} end {where}; it trusts {protection.peer} only"


def _addresses(args: argparse.Namespace, topology: Topology) -> tuple[Address, Address | None]:
    if args.listen is not None and args.peer is not None:
        raise ConfigError("--listen and --peer: give one of them; the other end has the other")
    if args.listen is not None:
        return _listen_address(args.listen, topology), None
    if args.peer is None:
        raise ConfigError(
            f"--end {args.end} needs --listen ADDR:PORT to wait for the other end, "
            "or --peer HOST:PORT to call it"
        )
    peer = parse_address(args.peer, "--peer", socket.AF_INET)
    check_one_machine("--peer", args.peer, peer[0])
    why = obstacle(_ANY, peer)
    if why is not None:
        raise ConfigError(f"--peer {args.peer} cannot be reached from here: {why}")
    return (_ANY, 0), peer


def _listen_address(text: str, topology: Topology) -> Address:
    listen = parse_address(text, "--listen", socket.AF_INET)
    if listen[0] != _ANY:
        check_one_machine("--listen", text, listen[0])
    # Nobody uses the radio's ports here, because the radio is between two machines.
    radio = [topology.radio_port(segment) for segment in Segment]
    if listen[1] in topology.ports and listen[1] not in radio:
        ports = topology.ports
        raise ConfigError(
            f"--listen {text}: this end uses the ports {ports.start} to {ports.stop - 1} itself; "
            f"take {ports.start} or another one"
        )
    return listen


def check_one_machine(option: str, text: str, address: str) -> None:
    """ConfigError for the IPv4 address of no machine, or of many."""
    host = ipaddress.IPv4Address(address)
    if host.is_unspecified or host.is_multicast:
        raise ConfigError(f"{option} {text}: give the address of one machine")


def _protection(args: argparse.Namespace) -> Protection | None:
    if args.insecure:
        for option in ("key", "identity"):
            if getattr(args, option) is not None:
                raise ConfigError(f"--insecure uses no keys: leave --{option} out, or --insecure")
        return None
    path = default_key_path() if args.key is None else args.key
    key = read_key(path)
    peer = pinned_peer(path, args.identity)
    if peer == key.identity:
        raise ConfigError(f"{path} trusts itself: `kontur-av keys trust` the other machine")
    return Protection(key=key, peer=peer)


def inputs_here(topology: Topology) -> tuple[str, ...]:
    """The names of the inputs that are captured on this machine."""
    return tuple(row.name for row in topology.inputs if topology.runs(row.process))


def check_own_options(args: argparse.Namespace, topology: Topology) -> None:
    """ConfigError for the first option of `stream` that belongs to the other end."""
    end = topology.alone
    if end is None:
        return
    if end is Segment.GROUND and args.joystick != SIMULATED:
        raise ConfigError("--joystick: the joystick is in space; give it at --end space")
    if end is Segment.SPACE:
        for option in ("rtc", "rtc_token_file", "ice_server"):
            if getattr(args, option) is not None:
                name = option.replace("_", "-")
                raise ConfigError(f"--{name}: a partner joins the ground; give it at --end ground")
    here = inputs_here(topology)
    for option in args.source:
        name = option.partition("=")[0]
        if name not in here:
            raise ConfigError(
                f"--source {option}: {name} is captured at --end {end.peer.value}; "
                f"this end has {', '.join(here) or 'no input'}"
            )
    _check_radio(topology.setup, end, trainer=args.trainer)


def _check_radio(setup: Setup, end: Segment, *, trainer: bool) -> None:
    """ConfigError for a radio that changes with time: two ends would have two times for it."""
    radio = setup.radio_profile
    if radio.timed and not (trainer and end is Segment.SPACE):
        raise ConfigError(
            f"radio {radio.name} changes with time, and both ends would have a time of their own: "
            "give it at --end space with --trainer, and none at --end ground"
        )
