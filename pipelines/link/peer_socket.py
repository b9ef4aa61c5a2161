"""The socket between two gateways on two machines, around the core of its path."""

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pipelines.session.datagrams import Address, listen
from telepresence.link.peer.figures import PeerFigures
from telepresence.link.profile import LinkProfile

if TYPE_CHECKING:
    from telepresence.link.peer.path import OpenPath, ProtectedPath
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
    """How one end reaches the other: it listens at `bind`, or calls `peer`.

    bind: local address; port 0 for any. peer: None for an end that waits to be called.
    protection: None for a path in the clear.
    """

    bind: Address
    peer: Address | None
    protection: Protection | None


def make_path(plan: PeerPlan, receive: LinkProfile, now_ns: int) -> "PeerPath":
    """Return the core of the path. receive: the profile of the way in."""
    protection = plan.protection
    if protection is None:
        from telepresence.link.peer.path import OpenPath

        return OpenPath(receive, address=plan.peer, now_ns=now_ns)
    from telepresence.link.peer.path import ProtectedPath

    return ProtectedPath(
        protection.key,
        protection.peer,
        secret=secrets.token_bytes(_SECRET_OCTETS),
        address=plan.peer,
        now_ns=now_ns,
    )


class PeerSocket:
    """One unconnected UDP socket, because the peer's address may change.

    failed, why: datagrams that the system refused, and its reason for the newest.
    """

    def __init__(self, path: "PeerPath", bind: Address, clock_ns: Callable[[], int]) -> None:
        self.udp = listen(bind)
        self.failed, self.why = 0, ""
        self._path = path
        self._clock_ns = clock_ns
        self._take = path.handle_datagram
        self._seal = path.seal
        self._receive_from, self._send_to = self.udp.recvfrom, self.udp.sendto

    def frame(self) -> bytes | None:
        """Take one datagram; return the peer's frame, if it has one."""
        try:
            datagram, source = self._receive_from(_MOST_OCTETS)
        except OSError:
            return None
        return self._take(datagram, source, self._clock_ns())

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

    def report(self) -> PeerFigures:
        """What is known of the path."""
        return self._path.report(self._clock_ns())
