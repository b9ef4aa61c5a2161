"""The protected channel of one gateway: transfer frames in and out, sealed datagrams on the path.

A shell that owns the socket needs this for each wake-up:

1. For every datagram: `handle_datagram(datagram, source, now_ns)`; what it returns is a frame.
2. For every frame to send: `seal(frame, now_ns)`, to `peer_address`, if neither is None.
3. At `poll_timeout()`: `handle_timeout(now_ns)`.
4. Until None: send `poll_transmit()`. Until None: look at `next_event()`.

A session's keys serve until a new handshake is complete, in any state of the path. Keys are never
stored, so what was recorded of an earlier session opens nowhere.
"""

from collections import Counter, deque
from dataclasses import dataclass, field

from kontur_av.clock import NS_PER_S
from telepresence.link.protection.datagrams import (
    HANDSHAKE,
    KNOCK,
    OVERHEAD_OCTETS,
    RECORD,
    RECORDS,
    RecordOpener,
    RecordSealer,
    key_number,
    sequence_number,
)
from telepresence.link.protection.handshake import Address, AttemptFailed, Handshake, KeysAgreed
from telepresence.link.protection.identity import MachineIdentity, MachineKey

#: New keys after this time or this many frames of one direction: about 17 minutes of slots.
REKEY_NS = 900 * NS_PER_S
REKEY_RECORDS = 1 << 20
#: The old keys still open records for this time after the first record under new ones.
OVERLAP_NS = 5 * NS_PER_S
#: After this long without a genuine record the peer may have lost its keys: ask for new ones.
SILENCE_NS = 2 * NS_PER_S


@dataclass(slots=True)
class ProtectionMetrics:
    """What passed the protected channel of one end, and what was dropped, by reason.

    Every datagram received is counted once: in `opened`, `handshake_datagrams` or `dropped`.
    """

    #: Frames sealed, and not sent because there was no session or no address yet.
    sealed: int = 0
    unsent: int = 0
    #: Frames opened.
    opened: int = 0
    #: Datagrams of handshakes that were heeded.
    handshake_datagrams: int = 0
    #: Handshakes with both ends proven; and attempts that came to nothing.
    sessions: int = 0
    failed_attempts: int = 0
    #: By reason: "malformed", "unauthenticated", "replayed", "late", "unknown_key" (of an earlier
    #: session, or of none), "stale" (an old datagram of a handshake), "throttled".
    dropped: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True, slots=True)
class SessionBegun:
    """Frames can be sealed under new keys. renewed: there was a session before."""

    renewed: bool


@dataclass(frozen=True, slots=True)
class PeerMoved:
    """The peer's genuine records come from another address now; frames go there."""

    address: Address


@dataclass(frozen=True, slots=True)
class HandshakeFailed:
    """A handshake came to nothing; the session before it, if any, goes on."""

    why: str


ChannelEvent = SessionBegun | PeerMoved | HandshakeFailed


class ProtectedChannel:
    """See the module for what to call when.

    key, peer: the own key pair, and the one identity that is believed.
    secret: 32 octets that nobody else knows, drawn anew at each start.
    address: where the peer is; None for an end that waits to be called.
    now_ns: the instant of the start.
    reads: what this end can read, as of `Agreement`.
    peer_reads: what both ends can, in this session.
    peer_address: where frames go; None as long as it is unknown.
    place: of the newest record opened: number of its keys, which grows, and sequence number.
    """

    def __init__(
        self,
        key: MachineKey,
        peer: MachineIdentity,
        *,
        secret: bytes,
        address: Address | None,
        now_ns: int,
        rekey_ns: int = REKEY_NS,
        rekey_records: int = REKEY_RECORDS,
        reads: int = 0,
    ) -> None:
        self.metrics = ProtectionMetrics()
        self.peer_address = address
        self.place = (0, 0)
        self._given_address = address
        self._rekey_ns = rekey_ns
        self._rekey_records = rekey_records
        self._handshake = Handshake(key, peer, secret, reads)
        self._sealer: RecordSealer | None = None
        #: Agreed, but the peer may not have the keys yet.
        self._next_sealer: RecordSealer | None = None
        self.peer_reads = self._next_reads = 0
        #: Newest first: the newest, those before them, and those in use if they are older still.
        self._openers: list[_Opener] = []
        self._forget_ns: int | None = None
        self._rekey_due_ns = 0
        #: The newest genuine record, or the start.
        self.heard_ns = now_ns
        self._queue: deque[tuple[bytes, Address]] = deque()
        self._events: deque[ChannelEvent] = deque()
        self._handshake.want(now_ns)
        self._drain(now_ns)

    @property
    def protected(self) -> bool:
        return self._sealer is not None

    def seal(self, frame: bytes, now_ns: int, kind: int = RECORD) -> bytes | None:
        """Return the datagram of a frame, for `peer_address`; None without a session or address.

        kind: of another content than a frame, which `peer_reads` allows.
        """
        sealer = self._sealer
        if sealer is None or self.peer_address is None:
            self.metrics.unsent += 1
            return None
        try:
            datagram = sealer.seal(frame, kind)
        except OverflowError:
            self._sealer = None
            self.metrics.unsent += 1
            return None
        self.metrics.sealed += 1
        if sealer.sealed == self._rekey_records:
            self._rekey_due_ns = now_ns
        return datagram

    def handle_datagram(self, datagram: bytes, source: Address, now_ns: int) -> bytes | None:
        """Return the frame in a datagram; None for one of a handshake, and for a dropped one."""
        kind = datagram[0] if datagram else 0
        if kind in RECORDS:
            opened = self._open(datagram, source, now_ns)
            if not isinstance(opened, str):
                self.metrics.opened += 1
                return opened
            self.metrics.dropped[opened] += 1
            return None
        if kind not in (HANDSHAKE, KNOCK):
            self.metrics.dropped["malformed"] += 1
            return None
        reason = self._handshake.handle_datagram(datagram, source, now_ns)
        if reason is None:
            self.metrics.handshake_datagrams += 1
        else:
            self.metrics.dropped[reason] += 1
        self._drain(now_ns)
        return None

    def handle_address(self, address: Address) -> None:
        """The peer may be at another address: it is asked there, too."""
        self._given_address = address
        if self._sealer is None:
            self.peer_address = address

    def handle_timeout(self, now_ns: int) -> None:
        """Renew keys, ask a silent peer, and repeat what a handshake has lost."""
        if self._forget_ns is not None and now_ns >= self._forget_ns:
            del self._openers[self._newest_used() + 1 :]
            self._forget_ns = None
        self._handshake.handle_timeout(now_ns)
        self._drain(now_ns)
        if self._sealer is None or now_ns >= min(self._rekey_due_ns, self.heard_ns + SILENCE_NS):
            self._handshake.want(now_ns)
            self._handshake.handle_timeout(now_ns)
        self._drain(now_ns)

    def poll_timeout(self) -> int | None:
        """The instant of the next `handle_timeout`."""
        instants = [self._handshake.poll_timeout(), self._forget_ns]
        if not self._handshake.asking:
            # Without a session all but the first is in the past: ask at once.
            instants += [self._rekey_due_ns, self.heard_ns + SILENCE_NS]
        return min((instant for instant in instants if instant is not None), default=None)

    def poll_transmit(self) -> tuple[bytes, Address] | None:
        """Return a datagram of a handshake and where it goes."""
        return self._queue.popleft() if self._queue else None

    def next_event(self) -> ChannelEvent | None:
        """Return what happened, oldest first."""
        return self._events.popleft() if self._events else None

    def _open(self, datagram: bytes, source: Address, now_ns: int) -> bytes | str:
        if len(datagram) < OVERHEAD_OCTETS:
            return "malformed"
        number = key_number(datagram)
        reason = "unknown_key"
        for place, opener in enumerate(self._openers):
            if opener.number != number:
                continue
            before = opener.records.newest
            frame = opener.records.open(datagram)
            if not isinstance(frame, str):
                self.place = opener.agreed, sequence_number(datagram)
                self._handle_genuine(place, now_ns)
                # Not for a record that was overtaken: it may come from where the peer was before.
                if opener.records.newest > before and place <= self._newest_used():
                    self._handle_source(source)
                return frame
            # Two keys may have one number, if rarely.
            reason = frame
            if reason != "unauthenticated":
                break
        return reason

    def _handle_genuine(self, place: int, now_ns: int) -> None:
        self.heard_ns = now_ns
        opener = self._openers[place]
        if opener.used:
            if self._handshake.wanted and now_ns < self._rekey_due_ns and self._sealer is not None:
                # The peer was silent, and is back with its keys.
                self._handshake.rest()
            return
        opener.used = True
        if place < len(self._openers) - 1:
            self._forget_ns = now_ns + OVERLAP_NS
        if place == 0:
            self._handshake.confirm()
            self._drain(now_ns)

    def _handle_source(self, source: Address) -> None:
        if source != self.peer_address:
            self.peer_address = source
            self._events.append(PeerMoved(source))

    def _newest_used(self) -> int:
        """The place of the newest keys under which a record came; that of the last without any."""
        last = len(self._openers) - 1
        return next((at for at, opener in enumerate(self._openers) if opener.used), last)

    def _drain(self, now_ns: int) -> None:
        while (event := self._handshake.next_event()) is not None:
            if isinstance(event, KeysAgreed):
                self._take_keys(event, now_ns)
            elif isinstance(event, AttemptFailed):
                self.metrics.failed_attempts += 1
                self._events.append(HandshakeFailed(event.why))
            else:
                self._use_keys(now_ns)
        while (found := self._handshake.poll_transmit()) is not None:
            datagram, address = found
            targets = {self.peer_address, self._given_address} if address is None else {address}
            self._queue.extend((datagram, target) for target in targets if target is not None)

    def _take_keys(self, event: KeysAgreed, now_ns: int) -> None:
        receive = event.keys.receive
        agreed = self._openers[0].agreed + 1 if self._openers else 1
        opener = _Opener(receive.number, RecordOpener(receive), agreed)
        in_use = self._openers[1:][max(self._newest_used() - 1, 0) :][:1]
        self._openers = [opener, *self._openers[:1], *in_use]
        self._next_sealer = RecordSealer(event.keys.send)
        self._next_reads = event.keys.reads
        if self.peer_address is None:
            self._handle_source(event.source)
        if event.ready:
            self._use_keys(now_ns)

    def _use_keys(self, now_ns: int) -> None:
        if self._next_sealer is None:
            return
        self._events.append(SessionBegun(renewed=self._sealer is not None))
        self._sealer, self._next_sealer = self._next_sealer, None
        self.peer_reads = self._next_reads
        self.metrics.sessions += 1
        self._rekey_due_ns = now_ns + self._rekey_ns
        self.heard_ns = now_ns


@dataclass(slots=True)
class _Opener:
    """Keys that open records. agreed: counts the keys. used: one has come under them."""

    number: bytes
    records: RecordOpener
    agreed: int
    used: bool = False
