"""The options of a session's space packets and frames for another ground system."""

import argparse
import re
import socket
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import NamedTuple

from kontur_av.errors import ConfigError
from pipelines.mission.supervisor import session_dictionary
from pipelines.packets.bridge import AllowedCommands, allowed_commands
from pipelines.packets.process_packets import PacketsPlan
from pipelines.session.addresses import bound_socket, resolve
from pipelines.session.datagrams import Address, is_loopback
from pipelines.session.option_rows import add_options
from pipelines.session.output import say
from pipelines.session.topology import Topology
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

_OPTION, _FRAMES = "--packets", "--frames"
_TCP, _UDP = r"tcp:(?:([^:]+):)?(\d{1,5})", r"udp:([^:]+):(\d{1,5})"
#: The one after it must be a port, too.
_LAST_PORT = 65_534
#: In the instance of YAMCS that `kontur-av yamcs new` writes.
DEFAULT_PACKETS = "tcp:127.0.0.1:10015"


def add_packets_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"{_OPTION} tcp:[HOST:]PORT|udp:HOST:PORT  give telemetry to another ground system, and "
        "take its telecommands: tcp listens; udp sends to PORT, and takes telecommands of HOST at "
        "PORT + 1",
        "--packets-allow WHAT <*>  telecommands that may come by --packets: APPLICATION, "
        "APPLICATION.FUNCTION or all; repeatable (default: questions alone)",
        f"{_FRAMES} udp:HOST:PORT  send copies of the radio link's frames to another ground "
        "system: the downlink's to PORT, the uplink's to PORT + 1",
    )


def checked_packets(
    args: argparse.Namespace, topology: Topology
) -> AbstractContextManager[PacketsPlan | None]:
    """Return what the options ask for, to bind its socket; ConfigError if that cannot be."""
    if args.packets is None:
        if args.packets_allow:
            raise ConfigError(f"--packets-allow needs {_OPTION}")
        return nullcontext()
    dictionary = session_dictionary(built_in_dictionary(), topology)
    allowed = allowed_commands(args.packets_allow, dictionary)
    return _bound(parse_packets(args.packets), dictionary, allowed, quiet=args.quiet)


@contextmanager
def _bound(
    wish: "PacketsWish", dictionary: Dictionary, allowed: AllowedCommands, *, quiet: bool
) -> Iterator[PacketsPlan]:
    host, port = wish.address
    if wish.udp:
        local = "127.0.0.1" if is_loopback(host) else ""
        kind, address = socket.SOCK_DGRAM, (local, port + 1)
        said = f"packets udp to {host}:{port}, telecommands at port {port + 1}"
    else:
        kind, address = socket.SOCK_STREAM, wish.address
        said = f"packets tcp {host}:{port}"
    where = f"{_OPTION}: port {address[1]} of {address[0] or 'this machine'}:"
    with bound_socket(kind, address, where) as bound:
        if not quiet:
            say(said)
        peer = wish.address if wish.udp else None
        yield PacketsPlan(socket=bound, peer=peer, dictionary=dictionary, allowed=allowed)


class PacketsWish(NamedTuple):
    """address: by UDP of the other system, else of the session."""

    address: Address
    udp: bool


def parse_packets(text: str) -> PacketsWish:
    udp = text.startswith("udp:")
    fits = "tcp:[HOST:]PORT or udp:HOST:PORT"
    return PacketsWish(_address(text, _OPTION, _UDP if udp else _TCP, fits), udp)


def parse_frames(text: str | None) -> Address | None:
    """Return where copies of the downlink's frames go, the uplink's to the next; ConfigError."""
    return None if text is None else _address(text, _FRAMES, _UDP, "udp:HOST:PORT")


def _address(text: str, option: str, pattern: str, fits: str) -> Address:
    match = re.fullmatch(pattern, text)
    if match is None or not 1 <= int(match[2]) <= _LAST_PORT:
        raise ConfigError(f"{option} {text!r}: write {fits}")
    host = resolve(match[1] or "127.0.0.1", text, option, socket.AF_INET)
    return host, int(match[2])
