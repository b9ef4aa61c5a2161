"""TLS 1.3 in memory: from octets of the peer to octets for the peer, and at the end to keys.

OpenSSL does the handshake (RFC 8446), through pyOpenSSL. Both ends show a self-made certificate.
Each accepts only the public key of the identity that it pinned, and looks at nothing else in it.
The keys of the records are exported (RFC 8446 section 7.5, RFC 5705). TLS itself carries no data.
What both ends can read beside records of one frame is negotiated as a protocol (ALPN, RFC 7301): an
end that knows nothing of it agrees to none.
"""

from typing import NamedTuple

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from OpenSSL import SSL, crypto

from telepresence.link.protection.datagrams import (
    DIRECTION_OCTETS,
    KEY_NUMBER_OCTETS,
    KEY_OCTETS,
    DirectionKeys,
)
from telepresence.link.protection.identity import MachineIdentity, MachineKey

#: RFC 5705 section 4: labels outside the registry begin so.
_LABEL = b"EXPERIMENTAL kontur-av link 1"
_READ_OCTETS = 16384
#: What an end can read: records with several frames, those without what is idle, and reports.
READS_PACKED, READS_COMPACT, READS_REPORTS = 1, 2, 4
READS_ALL = READS_PACKED | READS_COMPACT | READS_REPORTS
_PROTOCOLS = {b"kontur path %d" % reads: reads for reads in range(READS_ALL, 0, -1)}
#: RFC 8446 section 5.1 and 5.2: the header, and the most that may follow.
_HEADER_OCTETS = 5
_MOST_OCTETS = 2**14 + 256


class AgreedKeys(NamedTuple):
    """The keys of one session, as one end uses them. reads: what both ends can read."""

    send: DirectionKeys
    receive: DirectionKeys
    reads: int = 0


class Agreement:
    """What all handshakes of one end with one peer share. reads: what this end can read."""

    def __init__(self, key: MachineKey, peer: MachineIdentity, reads: int = 0) -> None:
        #: One end is the client always, so no message has to say which.
        self.client = key.identity.digest < peer.digest
        self._peer = peer
        context = SSL.Context(SSL.TLS_METHOD)
        context.set_min_proto_version(SSL.TLS1_3_VERSION)
        context.set_max_proto_version(SSL.TLS1_3_VERSION)
        context.set_tls13_ciphersuites(b"TLS_AES_256_GCM_SHA384")
        # Each session has a handshake of its own: nothing is resumed.
        context.set_options(SSL.OP_NO_TICKET)
        context.set_session_cache_mode(SSL.SESS_CACHE_OFF)
        context.set_verify(SSL.VERIFY_PEER | SSL.VERIFY_FAIL_IF_NO_PEER_CERT, self._is_pinned)
        context.use_certificate(key.certificate())
        context.use_privatekey(key.private)
        # Every subset is offered, so the largest common one is what both can read.
        self._protocols = [name for name, bits in _PROTOCOLS.items() if bits & reads == bits]
        if self._protocols:
            context.set_alpn_protos(self._protocols)
            context.set_alpn_select_callback(self._choose)
        self._context = context

    def begin(self) -> "AgreementRun":
        """Return one handshake."""
        connection = SSL.Connection(self._context, None)
        if self.client:
            connection.set_connect_state()
        else:
            connection.set_accept_state()
        return AgreementRun(connection, client=self.client)

    def _choose(
        self, connection: SSL.Connection, offered: list[bytes]
    ) -> bytes | SSL._NoOverlappingProtocols:
        common = (name for name in self._protocols if name in offered)
        return next(common, SSL.NO_OVERLAPPING_PROTOCOLS)

    def _is_pinned(
        self, connection: SSL.Connection, shown: crypto.X509, error: int, depth: int, ok: int
    ) -> bool:
        # No certificate vouches for another: the peer's own key is pinned.
        if depth:
            return False
        try:
            public = shown.to_cryptography().public_key()
        except (ValueError, TypeError, UnsupportedAlgorithm):
            return False
        return isinstance(public, Ed25519PublicKey) and MachineIdentity.of(public) == self._peer


class AgreementRun:
    """One handshake. complete: this end has checked the peer, and `keys` may be called.

    failed: "" or why the handshake cannot go on.

    A step reads one record of TLS, which takes at most about 0.5 ms; a whole flight takes 1 ms.
    """

    def __init__(self, connection: SSL.Connection, *, client: bool) -> None:
        self._connection = connection
        self._client = client
        self._waiting = b""
        self.complete = False
        self.failed = ""

    def add(self, octets: bytes) -> None:
        """Take what the peer sent, in order. Then call `step` as long as `waits`."""
        self._waiting += octets

    @property
    def waits(self) -> bool:
        """Whether `step` has a record to read."""
        return not self.failed and 0 < self._record_octets() <= len(self._waiting)

    @property
    def unread(self) -> int:
        """Octets that wait for `step`; not those of a record whose rest has not come."""
        return len(self._waiting) if self.waits else 0

    def step(self) -> bytes:
        """Read a record, if one waits; return what the peer is to be sent.

        The client calls it once without a record to begin.
        """
        if self.failed:
            return b""
        if self.waits:
            octets = self._record_octets()
            self._connection.bio_write(self._waiting[:octets])
            self._waiting = self._waiting[octets:]
        try:
            if self.complete:
                # Nothing is expected but an alert: the peer may refuse this end at the very last.
                self._connection.recv(1)
            else:
                self._connection.do_handshake()
                self.complete = True
        except SSL.WantReadError:
            pass
        except SSL.Error as error:
            self.failed = _reason(error)
            self.complete = False
        return self._written()

    def keys(self) -> AgreedKeys:
        """Return the keys of the session; only when `complete`."""
        octets = self._connection.export_keying_material(
            _LABEL, 2 * DIRECTION_OCTETS + KEY_NUMBER_OCTETS
        )
        number, both = octets[:KEY_NUMBER_OCTETS], octets[KEY_NUMBER_OCTETS:]
        client, server = (
            DirectionKeys(number, part[:KEY_OCTETS], part[KEY_OCTETS:])
            for part in (both[:DIRECTION_OCTETS], both[DIRECTION_OCTETS:])
        )
        reads = _PROTOCOLS.get(self._connection.get_alpn_proto_negotiated(), 0)
        send, receive = (client, server) if self._client else (server, client)
        return AgreedKeys(send, receive, reads)

    def _record_octets(self) -> int:
        """The size of the record that waits; 0: unknown so far."""
        if len(self._waiting) < _HEADER_OCTETS:
            return 0
        body_octets = int.from_bytes(self._waiting[3:_HEADER_OCTETS], "big")
        # OpenSSL refuses what is too long to be a record, so do not wait for its end.
        return len(self._waiting) if body_octets > _MOST_OCTETS else _HEADER_OCTETS + body_octets

    def _written(self) -> bytes:
        written = b""
        while True:
            try:
                written += self._connection.bio_read(_READ_OCTETS)
            except SSL.WantReadError:
                return written


def _reason(error: SSL.Error) -> str:
    """The last reason that OpenSSL names, such as "certificate verify failed"."""
    reasons = error.args[0] if error.args else None
    if isinstance(reasons, list) and reasons:
        return str(reasons[-1][-1])
    return "the connection was closed"
