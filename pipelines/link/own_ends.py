"""The ends of a link that run on this machine: which, where, with which keys. A shell."""

import argparse
import ipaddress
import secrets
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.hosts import host_port, parse_address, resolve, split_address
from pipelines.session.datagrams import (
    LOOPBACK,
    Address,
    EndAddresses,
    family_of,
    is_loopback,
    listen,
    obstacle,
    reaches,
)
from pipelines.session.launcher import hold_port
from pipelines.session.option_rows import refuse_options
from pipelines.session.options import StreamOptions
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.table import Topology
from telepresence.link.link_metrics import PeerMetrics, address_text
from telepresence.link.path.following import NO_VIDEO, PathNeeds
from telepresence.link.profile import LinkProfile

if TYPE_CHECKING:
    from telepresence.link.peer_path import OpenPath, ProtectedPath
    from telepresence.link.protection.identity import MachineIdentity, MachineKey

    PeerPath = OpenPath | ProtectedPath


_SECRET_OCTETS = 32
#: The largest datagram is one of 1200 octets of a handshake; one octet more tells longer ones.
_MOST_OCTETS = 1201


@dataclass(frozen=True, kw_only=True)
class Protection:
    """The own key pair, and the one identity that is believed."""

    key: "MachineKey"
    peer: "MachineIdentity"


@dataclass(frozen=True, kw_only=True)
class PeerPlan:
    """How the only end here reaches the other: it listens at `bind`, or calls `peer`.

    segment: of the end. bind: local address; port 0 for any. peer: None for an end that waits to be
    called. host: its name, if it was given by name. protection: None for a path in the clear.
    batch_ms, compact: how frames go in datagrams.
    """

    segment: Segment
    bind: Address
    peer: Address | None
    protection: Protection | None
    host: str | None = None
    batch_ms: int = 1
    compact: bool = False


def make_path(
    plan: PeerPlan,
    transmit: LinkProfile,
    receive: LinkProfile,
    now_ns: int,
    needs: PathNeeds = NO_VIDEO,
) -> "PeerPath":
    """Return the core of the path. transmit, receive: the profiles of the ways out and in.

    needs: of the videos on the way out.
    """
    protection = plan.protection
    if protection is None:
        from telepresence.link.peer_path import OpenPath

        return OpenPath(receive, address=plan.peer, now_ns=now_ns)
    from telepresence.link.path.bundles import Bundling
    from telepresence.link.peer_path import ProtectedPath

    return ProtectedPath(
        protection.key,
        protection.peer,
        secret=secrets.token_bytes(_SECRET_OCTETS),
        address=plan.peer,
        now_ns=now_ns,
        bundling=Bundling(
            transmit, receive, max(1, plan.batch_ms * NS_PER_MS // transmit.slot_ns), plan.compact
        ),
        needs=needs,
    )


class PeerSocket:
    """One unconnected UDP socket, because the peer's address may change.

    failed, why: datagrams that the system refused, and its reason for the newest.
    """

    def __init__(self, path: "PeerPath", plan: PeerPlan, clock_ns: Callable[[], int]) -> None:
        from telepresence.link.peer_path import LookupSchedule

        self.udp = listen(plan.bind)
        self._version_6 = self.udp.family == socket.AF_INET6
        self._plan, self._lookups = plan, LookupSchedule()
        self._looking = threading.Thread()
        self._found: deque[Address] = deque()
        self.failed, self.why = 0, ""
        self.core = self._path = path
        self._clock_ns = clock_ns
        self._take, self._next = path.handle_datagram, path.next_frame
        self._seal = path.seal
        self._receive_from, self._send_to = self.udp.recvfrom, self.udp.sendto

    def frame(self) -> bytes | None:
        """Take one datagram; return the peer's next frame, or None."""
        try:
            datagram, source = self._receive_from(_MOST_OCTETS)
        except OSError:
            return self._next(self._clock_ns())
        if self._version_6:
            source = host_port(source)
        return self._take(datagram, source, self._clock_ns())

    def next_frame(self) -> bytes | None:
        """Return the peer's next frame, without taking a datagram."""
        return self._next(self._clock_ns())

    def send(self, frame: bytes) -> None:
        sealed = self._seal(frame, self._clock_ns())
        if sealed is None:
            return
        try:
            self._send_to(*sealed)
        except OSError as error:
            self._note_refusal(error)

    def _note_refusal(self, error: OSError) -> None:
        self.failed += 1
        self.why = str(error.strerror)

    def work(self, until_ns: int) -> bool:
        """Do what waited for the rest of a slot, which ends at `until_ns`; whether there was any.

        Call it right after the slot's frame has been sent.
        """
        path, worked = self._path, False
        while path.handle_rest(self._clock_ns(), until_ns):
            worked = True
        while (found := path.poll_transmit()) is not None:
            try:
                self._send_to(*found)
            except OSError as error:
                self._note_refusal(error)
        return worked

    def report(self) -> PeerMetrics:
        """What is known of the path. Call it regularly: it has a silent peer's name looked up."""
        now_ns, path = self._clock_ns(), self._path
        if (
            self._plan.host is not None
            and not self._looking.is_alive()
            and self._lookups.poll(path.heard_ns, now_ns)
        ):
            # It may take half a minute, and the loop has a millisecond.
            self._looking = threading.Thread(target=self._look_up, daemon=True)
            self._looking.start()
        while self._found:
            path.handle_address(self._found.popleft(), now_ns)
        return path.report(now_ns)

    def _look_up(self) -> None:
        plan = self._plan
        if plan.host is None or plan.peer is None:
            return
        with suppress(OSError, UnicodeError):
            known = socket.getaddrinfo(plan.host, plan.peer[1], self.udp.family, socket.SOCK_DGRAM)
            self._found.append(host_port(known[0][4]))


_ANY, _ANY_6 = "0.0.0.0", "::"
#: What stays visible as long as an end runs with `--insecure`.
INSECURE = "this path is not protected: anybody on it can read, change and steer"


def chosen_end(args: StreamOptions, topology: Topology) -> PeerPlan | None:
    """The end that the options name; None: both run here. ConfigError if it cannot work."""
    radio = topology.setup.radio_profile
    if radio.network is not None:
        raise ConfigError(
            f"radio {radio.name} has a network, for `simulate` and `sweep`; between two live "
            "ends it is `kontur-av bench path`"
        )
    if args.end is None:
        why = " is for one end alone: add --end ground or --end space"
        names = ("listen", "peer", "key", "identity", "insecure", "path_batch_ms", "path")
        refuse_options(args, why, *names)
        return None
    segment = Segment(args.end)
    bind, peer, host = _addresses(args, topology)
    return PeerPlan(
        segment=segment,
        bind=bind,
        peer=peer,
        host=host,
        protection=_protection(args),
        batch_ms=topology.setup.path_batch_ms,
        compact=topology.setup.path == "compact",
    )


def hold_listen_port(plan: PeerPlan) -> None:
    """ConfigError if the port at which this end is to listen is busy."""
    address, port = plan.bind
    hold_port(port, address).close()


def path_line(plan: PeerPlan) -> str:
    """How this end reaches the other, in one line for people."""
    where = (
        f"listens at {address_text(plan.bind)}"
        if plan.peer is None
        else f"calls {address_text(plan.peer)}"
    )
    protection = plan.protection
    if protection is None:
        return f"{plan.segment.value} end {where}; WARNING: {INSECURE}"
    return f"{plan.segment.value} end {where}; it trusts {protection.peer} only"


def _addresses(
    args: StreamOptions, topology: Topology
) -> tuple[Address, Address | None, str | None]:
    """Where this end is, where the other one, and by which name."""
    if args.listen is not None:
        return _listen_address(args.listen, topology), None, None
    if args.peer is None:
        raise ConfigError(
            f"--end {args.end} needs --listen ADDR:PORT to wait for the other end, "
            "or --peer HOST:PORT to call it"
        )
    peer = _resolved(args.peer, "--peer")
    check_one_machine("--peer", args.peer, peer[0])
    bind = _ANY_6 if family_of(peer[0]) == socket.AF_INET6 else _ANY
    why = obstacle(bind, peer)
    if why is not None:
        raise ConfigError(f"--peer {args.peer} cannot be reached from here: {why}")
    host, _ = split_address(args.peer, "--peer")
    return (bind, 0), peer, None if _is_numeric(host) else host


def _resolved(text: str, option: str) -> Address:
    """The address of HOST:PORT: the one of IPv4, if it has both."""
    try:
        return parse_address(text, option, socket.AF_INET)
    except ConfigError:
        return parse_address(text, option)


def _is_numeric(host: str) -> bool:
    with suppress(ValueError):
        return bool(ipaddress.ip_address(host))
    return False


def _listen_address(text: str, topology: Topology) -> Address:
    listen = _resolved(text, "--listen")
    if listen[0] not in (_ANY, _ANY_6):
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
    """ConfigError for the address of no machine, or of many."""
    host = ipaddress.ip_address(address)
    if host.is_unspecified or host.is_multicast:
        raise ConfigError(f"{option} {text}: give the address of one machine")


def _protection(args: StreamOptions) -> Protection | None:
    if args.insecure:
        return None
    # Not loaded by a session of one machine.
    from pipelines.link.key_files import default_key_path, pinned_peer, read_key

    path = default_key_path() if args.key is None else args.key
    key = read_key(path)
    peer = pinned_peer(path, args.identity)
    if peer == key.identity:
        raise ConfigError(f"{path} trusts itself: `kontur-av keys trust` the other machine")
    return Protection(key=key, peer=peer)


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
            fix = "" if own is None else f"; use --apps-bind {own}"
            raise ConfigError(
                f"--apps {args.apps} cannot be reached from --apps-bind {bind}: {why}{fix}"
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
