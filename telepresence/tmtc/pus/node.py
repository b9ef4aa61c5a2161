"""One end of the TM/TC flow: routing by APID, and a token bucket before the radio. A core."""

from collections import deque
from collections.abc import Sequence

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.link.bucket import TokenBucket
from telepresence.tmtc.k2aci import K2aciEndpoint
from telepresence.tmtc.pus.application import PusApplication
from telepresence.tmtc.pus.head import MAX_PACKET_OCTETS, apid_of, destination_of
from telepresence.tmtc.pus.packets import (
    COUNT_MODULUS,
    Telecommand,
    Telemetry,
    cuc_from_ns,
    pack_packet,
    parse_packet,
)
from telepresence.tmtc.pus.user import PusUser
from telepresence.tmtc.pus.verification import (
    Failure,
    VerificationStage,
    pack_refusal,
    verification_of,
)

#: The private service (clause 5.3.2.3: from 128 on) that carries K2ACI.
K2ACI_SERVICE, K2ACI_SUBTYPE = 129, 1
_FAILURES_DEPTH = 16
_LOCAL_DEPTH = 64


class K2aciLink:
    """K2ACI between the application `apid` here and `peer` there. ConfigError if they are one."""

    def __init__(self, endpoint: K2aciEndpoint, *, apid: int, peer: int) -> None:
        if apid == peer:
            raise ConfigError("K2ACI needs two applications")
        self.endpoint = endpoint
        self.apid = apid
        self.peer = peer
        self._count = 0

    def takes(self, packet: Telemetry) -> bool:
        """Whether `packet` is for this end."""
        return (
            packet.service == K2ACI_SERVICE
            and packet.subtype == K2ACI_SUBTYPE
            and (packet.apid, packet.destination) == (self.peer, self.apid)
        )

    def poll_transmit(self, now_ns: int, epoch_ns: int) -> bytes | None:
        """The next packet, or None."""
        body = self.endpoint.poll_transmit(now_ns)
        if body is None:
            return None
        packet = Telemetry(
            apid=self.apid,
            count=self._count,
            service=K2ACI_SERVICE,
            subtype=K2ACI_SUBTYPE,
            data=body,
            counter=self._count,
            destination=self.peer,
            cuc=cuc_from_ns(now_ns + epoch_ns),
        )
        self._count = (self._count + 1) % COUNT_MODULUS
        return pack_packet(packet)


class PusNode:
    """Joins the applications, the user and the K2ACI of one end to the TM/TC flow.

    Hand each packet of the flow to `handle_packet`. After that, and after anything that makes one
    of the parts send, send what `poll_transmit` returns until None; again at `poll_timeout`.

    Telecommands go first, then failures of routing; K2ACI and what applications report take turns,
    so that no flood of chat keeps a verification waiting. A packet waits until the token
    bucket holds it: `rate_bps` in the long run and two packets at once. It waits in the part
    that made it, which says how much that may be, except for the next one.

    A telecommand for no application at the other end is answered by a failure of routing. One for
    an application at this end is handed over here, and what it answers does not take the radio.
    Reports for everybody go both ways. `next_local` returns what stayed here, the newest 64.
    """

    def __init__(
        self,
        *,
        applications: Sequence[PusApplication] = (),
        user: PusUser | None = None,
        k2aci: K2aciLink | None = None,
        rate_bps: int,
        epoch_ns: int = 0,
    ) -> None:
        if rate_bps <= 0:
            raise ConfigError("PUS needs a rate above 0")
        self.applications = {application.table.apid: application for application in applications}
        self.user = user
        self.k2aci = k2aci
        self.sent = 0
        self.sent_octets = 0
        self.received = 0
        self.garbage = 0
        #: Packets that waited for the bucket.
        self.delayed = 0
        self.max_age_ns = 0
        self._bucket = TokenBucket(rate_bps, 2 * MAX_PACKET_OCTETS)
        self._epoch_ns = epoch_ns
        self._failures: deque[bytes] = deque(maxlen=_FAILURES_DEPTH)
        self._local: deque[bytes] = deque(maxlen=_LOCAL_DEPTH)
        self._failure_count = 0
        self._k2aci_was_last = False
        #: The packet that waits for the bucket, since when.
        self._next: tuple[bytes, int] | None = None

    def handle_packet(self, octets: bytes, now_ns: int) -> None:
        """A packet of the flow. Garbage is counted; this never raises."""
        try:
            packet = parse_packet(octets)
        except ProtocolError:
            self.garbage += 1
            return
        self.received += 1
        if isinstance(packet, Telecommand):
            application = self.applications.get(packet.apid)
            if application is None:
                self._refuse(packet, now_ns)
            else:
                application.handle_telecommand(packet, now_ns)
        elif self.k2aci is not None and self.k2aci.takes(packet):
            self.k2aci.endpoint.handle_message(packet.data, now_ns)
        elif self.user is not None and packet.service != K2ACI_SERVICE:
            self.user.handle_telemetry(packet, now_ns)

    def handle_contact(self, now_ns: int) -> None:
        """The signal is acquired: repeat at once what is open."""
        if self.user is not None:
            self.user.handle_contact(now_ns)
        if self.k2aci is not None:
            self.k2aci.endpoint.handle_contact(now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next packet that may be sent now, or None."""
        if self._next is None:
            octets = self._poll_parts(now_ns)
            if octets is None:
                return None
            if not self._bucket.holds(len(octets), now_ns):
                self.delayed += 1
                self._next = octets, now_ns
                return None
        else:
            octets, since_ns = self._next
            if not self._bucket.holds(len(octets), now_ns):
                return None
            self._next = None
            self.max_age_ns = max(self.max_age_ns, now_ns - since_ns)
        self._bucket.take(len(octets), now_ns)
        self.sent += 1
        self.sent_octets += len(octets)
        return octets

    def next_local(self) -> bytes | None:
        """Return the next packet from this end for this end, or None."""
        return self._local.popleft() if self._local else None

    def poll_timeout(self, now_ns: int) -> int | None:
        """When `poll_transmit` has something next, or None."""
        if self._next is not None:
            return self._bucket.holds_ns(len(self._next[0]), now_ns)
        parts = [application.poll_timeout() for application in self.applications.values()]
        if self.user is not None:
            parts.append(self.user.poll_timeout())
        if self.k2aci is not None:
            parts.append(self.k2aci.endpoint.poll_timeout())
        return min((due_ns for due_ns in parts if due_ns is not None), default=None)

    def _poll_parts(self, now_ns: int) -> bytes | None:
        user = self.user
        while user is not None and (octets := user.poll_transmit(now_ns)) is not None:
            if apid_of(octets) not in self.applications:
                return octets
            self._local.append(octets)
            self._handle_own(octets, now_ns)
        if self._failures:
            return self._failures.popleft()
        turns = [self._poll_k2aci, self._poll_applications]
        if self._k2aci_was_last:
            turns.reverse()
        for turn in turns:
            if (octets := turn(now_ns)) is not None:
                self._k2aci_was_last = turn == self._poll_k2aci
                return octets
        return None

    def _poll_k2aci(self, now_ns: int) -> bytes | None:
        return None if self.k2aci is None else self.k2aci.poll_transmit(now_ns, self._epoch_ns)

    def _poll_applications(self, now_ns: int) -> bytes | None:
        user = self.user
        for application in self.applications.values():
            while (octets := application.poll_transmit(now_ns)) is not None:
                destination = destination_of(octets)
                if user is None or (destination and not user.hears(destination)):
                    return octets
                self._handle_own(octets, now_ns)
                if not destination:
                    return octets
                self._local.append(octets)
        return None

    def _handle_own(self, octets: bytes, now_ns: int) -> None:
        """A packet from this end for this end."""
        packet = parse_packet(octets)
        if isinstance(packet, Telecommand):
            self.applications[packet.apid].handle_telecommand(packet, now_ns)
        elif self.user is not None:
            self.user.handle_telemetry(packet, now_ns)

    def _refuse(self, command: Telecommand, now_ns: int) -> None:
        reason = f"no application {command.apid} at this end"
        report = verification_of(command, VerificationStage.ROUTED, Failure.UNKNOWN_APID, reason)
        packet = pack_refusal(
            command,
            report,
            count=self._failure_count,
            destination=command.source,
            unix_ns=now_ns + self._epoch_ns,
        )
        self._failure_count = (self._failure_count + 1) % COUNT_MODULUS
        self._failures.append(packet)
