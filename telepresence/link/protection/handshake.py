"""The handshake: how two ends that pinned each other agree on new keys, over a path that may fail.

docs/security.md has its steps. Each side's TLS octets travel in numbered segments until they are
acknowledged (datagrams.py, agreement.py). Sessions are not touched here: the keys of a complete
attempt are handed on.

The caller's next obligation after each call: `poll_transmit` until None, and `next_event` until
None. Then call `handle_timeout` at the instant of `poll_timeout`.
"""

import hmac
from collections import deque
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.bucket import Allowance
from telepresence.link.octet_streams import IncomingOctets, OutgoingOctets
from telepresence.link.protection.agreement import AgreedKeys, Agreement, AgreementRun
from telepresence.link.protection.datagrams import (
    DATA_OCTETS,
    MOST_EARLY,
    NO_NONCE,
    NONCE_OCTETS,
    HandshakeSegment,
    SegmentCodec,
)
from telepresence.link.protection.identity import MachineIdentity, MachineKey

#: Where a datagram came from, or goes to: host and UDP port.
Address = tuple[str, int]

#: A repetition comes after this time, and then after twice as long, up to the longest.
FIRST_REPEAT_NS = 250 * NS_PER_MS
LONGEST_REPEAT_NS = 2 * NS_PER_S
#: An attempt that is not complete after this time is given up, and another begun.
ATTEMPT_NS = 20 * NS_PER_S
#: Attempts, and answers to knocks, at once and then a second. An attempt costs about 1 ms of CPU.
ATTEMPTS_AT_ONCE = 5
ANSWERS_AT_ONCE = 20
#: Attempts under one nonce; then another is drawn. It bounds what is kept of them.
_MOST_PAST = 32


@dataclass(frozen=True, slots=True)
class KeysAgreed:
    """The peer has proved its identity. ready: it has the keys, too, so records may be sent now.

    source: where the peer's last segment came from.
    """

    keys: AgreedKeys
    ready: bool
    source: Address


@dataclass(frozen=True, slots=True)
class PeerReady:
    """The peer has the keys that were agreed last."""


@dataclass(frozen=True, slots=True)
class AttemptFailed:
    """An attempt ended without keys that both ends have. why: in a few words."""

    why: str


HandshakeEvent = KeysAgreed | PeerReady | AttemptFailed


class Handshake:
    """One end's attempts with its peer. See the module for what to call when.

    secret: 32 octets that nobody else knows, drawn anew at each start; the nonces come from it.
    reads: what this end can read, as of `Agreement`.
    wanted: whether this end asks for a session.
    """

    def __init__(
        self, key: MachineKey, peer: MachineIdentity, secret: bytes, reads: int = 0
    ) -> None:
        if key.identity == peer:
            raise ValueError("an end cannot be its own peer")
        self._agreement = Agreement(key, peer, reads)
        self._codec = SegmentCodec(key.identity, peer)
        self._secret = secret
        self._drawn = 0
        self._nonce = self._draw()
        #: Nonces of the peer whose attempt under the present nonce is over.
        self._past: set[bytes] = set()
        self._attempt: _Attempt | None = None
        self._queue: deque[tuple[bytes, Address | None]] = deque()
        self._events: deque[HandshakeEvent] = deque()
        self._attempts = Allowance(ATTEMPTS_AT_ONCE, NS_PER_S)
        self._answers = Allowance(ANSWERS_AT_ONCE, NS_PER_S // ANSWERS_AT_ONCE)
        self.wanted = False
        self._knock_ns = self._not_before_ns = 0
        self._repeat_ns = FIRST_REPEAT_NS

    def want(self, now_ns: int) -> None:
        """Ask for a session, until one is agreed."""
        if not self.asking:
            if self._attempt is not None and self._attempt.ready:
                self._end_attempt()
            self.wanted = True
            self._knock_ns = max(now_ns, self._not_before_ns)
            self._repeat_ns = FIRST_REPEAT_NS

    @property
    def asking(self) -> bool:
        """Whether a session is wanted, or an attempt goes on."""
        return self.wanted or (self._attempt is not None and not self._attempt.ready)

    def rest(self) -> None:
        """Stop asking; what has begun goes on."""
        self.wanted = False

    def confirm(self) -> None:
        """The peer has sent a record under the keys agreed last: the attempt has no more to do."""
        attempt = self._attempt
        if attempt is not None and attempt.run.complete:
            if not attempt.ready:
                self._events.append(PeerReady())
            self._end_attempt()

    def handle_datagram(self, datagram: bytes, source: Address, now_ns: int) -> str | None:
        """Take a datagram of the kinds `HANDSHAKE` and `KNOCK`; return why it was dropped, or None.

        The reasons: "malformed", "unauthenticated", "stale" (a replay, or late), and "throttled".
        """
        segment = self._codec.parse(datagram)
        if isinstance(segment, str):
            return segment
        if segment.receiver != self._nonce:
            return self._answer(segment, source, now_ns)
        attempt = self._attempt
        begins = attempt is None or attempt.peer != segment.sender
        if attempt is None or begins:
            if segment.sender in self._past or not (self.wanted or segment.knock or segment.data):
                return "stale"
            if not self._attempts.holds(1, now_ns):
                return "throttled"
            self._attempts.take(1, now_ns)
            if len(self._past) == _MOST_PAST:
                self._end_attempt()
                return "stale"
            attempt = self._begin_attempt(segment.sender, source, now_ns)
        attempt.source = source
        self._progress(attempt, segment, now_ns, begins=begins)
        return None

    def handle_timeout(self, now_ns: int) -> None:
        """Repeat what was not acknowledged, knock again, give up what takes too long.

        One record of TLS that waits is read instead: it takes time enough.
        """
        attempt = self._attempt
        if attempt is not None and attempt.run.waits:
            self._read(attempt, now_ns)
            return
        if attempt is not None and now_ns >= attempt.end_ns:
            if not attempt.ready:
                self._events.append(AttemptFailed("the peer answers no more"))
            self._end_attempt()
            attempt = None
        if attempt is None:
            if self.wanted and now_ns >= self._knock_ns:
                self._queue.append((self._segment(NO_NONCE, knock=True), None))
                self._knock_ns = now_ns + self._repeat_ns
                self._repeat_ns = min(2 * self._repeat_ns, LONGEST_REPEAT_NS)
        elif attempt.wake_ns is not None and now_ns >= attempt.wake_ns:
            attempt.outgoing.handle_lost(0, attempt.outgoing.sent)
            attempt.repeat_ns = min(2 * attempt.repeat_ns, LONGEST_REPEAT_NS)
            attempt.wake_ns = None
            self._send(attempt, now_ns, say_something=True)

    def poll_timeout(self) -> int | None:
        """The instant of the next `handle_timeout`."""
        attempt = self._attempt
        if attempt is None:
            return self._knock_ns if self.wanted else None
        if attempt.run.waits:
            return attempt.read_ns
        return attempt.end_ns if attempt.wake_ns is None else min(attempt.wake_ns, attempt.end_ns)

    def poll_transmit(self) -> tuple[bytes, Address | None] | None:
        """Return a datagram and where it goes; the address None: wherever the peer may be."""
        return self._queue.popleft() if self._queue else None

    def next_event(self) -> HandshakeEvent | None:
        """Return what happened, oldest first."""
        return self._events.popleft() if self._events else None

    def _answer(self, segment: HandshakeSegment, source: Address, now_ns: int) -> str | None:
        """A datagram with another nonce than the present one: only a knock is answered."""
        if not segment.knock:
            return "stale"
        if not self._answers.holds(1, now_ns):
            return "throttled"
        self._answers.take(1, now_ns)
        self._queue.append((self._segment(segment.sender), source))
        return None

    def _begin_attempt(self, peer: bytes, source: Address, now_ns: int) -> "_Attempt":
        if self._attempt is not None:
            self._past.add(self._attempt.peer)
            if not self._attempt.ready:
                self._events.append(AttemptFailed("the peer began anew"))
        self._attempt = attempt = _Attempt(peer, self._agreement.begin(), source, now_ns)
        if self._agreement.client:
            attempt.outgoing.add(attempt.run.step())
        return attempt

    def _end_attempt(self) -> None:
        self._attempt = None
        self._past.clear()
        self._nonce = self._draw()

    def _progress(
        self, attempt: "_Attempt", segment: HandshakeSegment, now_ns: int, *, begins: bool
    ) -> None:
        news = attempt.outgoing.handle_acknowledged(segment.acknowledged)
        if ready := attempt.incoming.handle_piece(segment.offset, segment.data):
            news = True
            attempt.run.add(ready)
        if news:
            attempt.repeat_ns, attempt.wake_ns = FIRST_REPEAT_NS, None
        # What has come is acknowledged always, or the other would repeat it for ever.
        attempt.owes |= begins or bool(segment.data)
        self._read(attempt, now_ns)

    def _read(self, attempt: "_Attempt", now_ns: int) -> None:
        """Read one record of TLS if one waits, and send what is due."""
        run = attempt.run
        attempt.read_ns = now_ns
        was_complete = run.complete
        if run.waits:
            attempt.outgoing.add(run.step())
        if run.failed:
            self._send(attempt, now_ns)
            self._events.append(AttemptFailed(run.failed))
            self._end_attempt()
            self._knock_ns = self._not_before_ns = now_ns + LONGEST_REPEAT_NS
            return
        if run.complete and not was_complete:
            # The server hears of the client's proof last, so then both have the keys.
            attempt.ready = not self._agreement.client
            self.wanted = False
            self._events.append(KeysAgreed(run.keys(), attempt.ready, attempt.source))
        elif run.complete and not attempt.ready and attempt.all_acknowledged:
            attempt.ready = True
            self._events.append(PeerReady())
        # Acknowledged when it has been read, because it tells the peer that the keys are here.
        if not run.waits:
            self._send(attempt, now_ns, say_something=attempt.owes)
            attempt.owes = False

    def _send(self, attempt: "_Attempt", now_ns: int, *, say_something: bool = False) -> None:
        """Send the pieces that are due; with `say_something` an empty one if there are none."""
        sent = False
        while (piece := attempt.outgoing.next_piece(DATA_OCTETS)) is not None:
            self._queue.append((self._segment(attempt.peer, *piece), attempt.source))
            sent = True
        if say_something and not sent:
            # Who has heard no octet of the peer asks: the first answer may have been lost.
            unheard = not attempt.incoming.received
            self._queue.append((self._segment(attempt.peer, knock=unheard), attempt.source))
        if attempt.run.complete and attempt.all_acknowledged:
            attempt.wake_ns = None
        elif sent or attempt.wake_ns is None:
            # Not for a datagram without news: the peer's repetitions would put off the own ones.
            attempt.wake_ns = now_ns + attempt.repeat_ns

    def _segment(
        self, receiver: bytes, offset: int = 0, data: bytes = b"", *, knock: bool = False
    ) -> bytes:
        attempt = self._attempt
        heard = 0 if attempt is None else attempt.incoming.received - attempt.run.unread
        return self._codec.pack(HandshakeSegment(knock, self._nonce, receiver, heard, offset, data))

    def _draw(self) -> bytes:
        self._drawn += 1
        return hmac.digest(self._secret, self._drawn.to_bytes(8, "big"), "sha256")[:NONCE_OCTETS]


class _Attempt:
    """One handshake with the peer that has this nonce. ready: both ends have the keys."""

    def __init__(self, peer: bytes, run: AgreementRun, source: Address, now_ns: int) -> None:
        self.peer = peer
        self.run = run
        self.source = source
        self.outgoing = OutgoingOctets()
        self.incoming = IncomingOctets(MOST_EARLY)
        self.end_ns = now_ns + ATTEMPT_NS
        #: When a record of TLS was read last.
        self.read_ns = now_ns
        #: The peer is owed an acknowledgement.
        self.owes = False
        #: When to repeat; None: once something is sent, or never.
        self.wake_ns: int | None = None
        self.repeat_ns = FIRST_REPEAT_NS
        self.ready = False

    @property
    def all_acknowledged(self) -> bool:
        return self.outgoing.base == self.outgoing.end
