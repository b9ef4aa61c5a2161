"""The paths to the peer, for a loop with slots: protected, or not, for a private network. Cores.

A protected path sends records at once, and handshakes in the rest of a slot. A handshake's step
takes up to 0.5 ms, half of a slot. So its datagrams wait until the slot's frame has been sent, and
at most about one step is taken in a slot. A record takes some µs.

A shell that owns the socket does this:

1. For every datagram, and once a slot: `handle_datagram` or `next_frame`, then `next_frame` until
   None; what they return are frames.
2. For every frame to send: `seal`; what it returns is a datagram and its address, or None.
3. After each slot's frame: `handle_rest` until it is False; then send `poll_transmit` until None.

Without protection frames themselves are followed. An end that was given its peer's address takes
frames from there only. An end that waits to be called follows the source of good frames, and
another one only when the present peer has been silent for `SILENCE_NS`. All other datagrams are a
unknown sender's.
"""

from collections import deque

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from telepresence.link.frame import FrameCodec
from telepresence.link.link_metrics import Address, PeerHistory, PeerMetrics, address_text
from telepresence.link.path.bundles import Bundling, FramePacker, FrameUnpacker
from telepresence.link.path.following import (
    ALL,
    NO_VIDEO,
    PARTS,
    Allowed,
    Arrivals,
    PathFollower,
    PathNeeds,
    PathReport,
)
from telepresence.link.path.order import FrameOrder
from telepresence.link.profile import LinkProfile
from telepresence.link.protection.agreement import (
    READS_ALL,
    READS_COMPACT,
    READS_PACKED,
    READS_REPORTS,
)
from telepresence.link.protection.channel import (
    REKEY_NS,
    HandshakeFailed,
    PeerMoved,
    ProtectedChannel,
    SessionBegun,
)
from telepresence.link.protection.datagrams import RECORD, RECORDS, REPORT
from telepresence.link.protection.identity import MachineIdentity, MachineKey

#: UDP and IP around a datagram.
IPV4_OCTETS, IPV6_OCTETS = 28, 48
#: Datagrams of handshakes that wait for the rest of a slot; more are dropped as `throttled`.
_MOST_WAITING = 64
#: The longest step; this much of a slot must remain.
STEP_NS = 600 * NS_PER_US
#: A step that found no such slot is taken after this many, because a late slot is better than none.
_MOST_PUT_OFF = 50
#: The channel's own deadlines are asked for this often.
_LOOK_NS = 50 * NS_PER_MS
#: An end that has sent no frame for this long sends a record without one. A radio that has lost its
#: signal sends none, and neither the peer nor an address translator shall take the end for gone.
KEEP_ALIVE_NS = 500 * NS_PER_MS
#: A silent peer's name is looked up after this time, then after twice as long, up to the longest.
FIRST_LOOKUP_NS, LONGEST_LOOKUP_NS = 4 * NS_PER_S, 64 * NS_PER_S


class ProtectedPath:
    """See the module for what to call when, and `ProtectedChannel` for the arguments.

    rekey_ns: new keys after this time.
    bundling: what this end wants of its datagrams; None: it neither sends nor reads several frames
        in one, and follows no path.
    needs: what the videos of the way out need.
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
        bundling: Bundling | None = None,
        needs: PathNeeds = NO_VIDEO,
    ) -> None:
        self._channel = ProtectedChannel(
            key,
            peer,
            secret=secret,
            address=address,
            now_ns=now_ns,
            rekey_ns=rekey_ns,
            reads=0 if bundling is None else READS_ALL,
        )
        self._packer: FramePacker | None = None
        self._unpacker: FrameUnpacker | None = None
        self._arrivals: Arrivals | None = None
        self._follower = PathFollower(needs)
        #: What the other end has to read for that.
        self._needs = 0
        if bundling is not None:
            batch, compact = bundling.batch, bundling.compact
            self._unpacker = FrameUnpacker(bundling.receive)
            self._arrivals = Arrivals(bundling.receive.slot_ns)
            if compact or batch > 1:
                self._packer = FramePacker(bundling.transmit, batch=batch, compact=compact)
                self._needs = READS_COMPACT if compact else READS_PACKED
        self._malformed = 0
        self._identity = str(peer)
        self._waiting: deque[tuple[bytes, Address]] = deque()
        self._due_ns = now_ns
        self._sealed_ns = now_ns
        #: Datagrams of the own accord: signs of life, and bundles that waited.
        self._own: deque[tuple[bytes, Address]] = deque()
        self._history = PeerHistory(now_ns)
        self._session_ns: int | None = None
        self._moves = 0
        self._overflows = 0
        self._put_off = 0
        self._order = FrameOrder()
        self._octets_sent = 0

    def handle_datagram(self, datagram: bytes, source: Address, now_ns: int) -> bytes | None:
        """Return the next frame in order; what belongs to handshakes waits for `handle_rest`."""
        if datagram and datagram[0] not in RECORDS:
            if len(self._waiting) < _MOST_WAITING:
                self._waiting.append((datagram, source))
            else:
                self._overflows += 1
            return None
        channel, order = self._channel, self._order
        content = channel.handle_datagram(datagram, source, now_ns)
        if content is not None:
            # A record without a frame is a sign of life only.
            frames: tuple[bytes, ...] | None = (content,) if content else ()
            if datagram[0] == REPORT:
                frames = self._take_report(content, now_ns)
            elif datagram[0] != RECORD:
                unpacker = self._unpacker
                frames = None if unpacker is None else unpacker.unpack(datagram[0], content)
            self._malformed += frames is None
            if self._arrivals is not None:
                count = int.from_bytes(frames[-1][2:5], "big") if frames else None
                octets = _octets_on_path(datagram, source)
                self._arrivals.handle_record(*channel.place, count, octets, now_ns)
            order.handle_record(*channel.place, frames or (), now_ns)
        return order.poll_frame(now_ns)

    def next_frame(self, now_ns: int) -> bytes | None:
        """Return a frame that waited for one before it, or came with another one."""
        return self._order.poll_frame(now_ns)

    @property
    def heard_ns(self) -> int:
        """When the peer was heard last."""
        return self._channel.heard_ns

    def handle_address(self, address: Address, now_ns: int) -> None:
        """The peer's name stands for this address now."""
        self._channel.handle_address(address)
        self._history.add(f"name looked up: {address_text(address)}", now_ns)

    def seal(self, frame: bytes, now_ns: int) -> tuple[bytes, Address] | None:
        """Return a datagram and where it goes; None without a session or address.

        None, too, while the frame waits for others; `poll_transmit` may then return it.
        """
        self._sealed_ns = now_ns
        packer = self._packer
        if packer is None or not self._packs:
            return self._seal(RECORD, frame, now_ns)
        packer.handle_frame(frame, now_ns)
        bundle = packer.poll_transmit(now_ns)
        return None if bundle is None else self._seal(*bundle, now_ns)

    @property
    def compact(self) -> bool:
        """Whether idle octets are left out on the way out."""
        return self._packs and self._needs == READS_COMPACT

    @property
    def allowed(self) -> Allowed:
        """What of the profile goes over the path now."""
        return self._follower.allowed if self._reports else ALL

    @property
    def _reports(self) -> bool:
        return bool(READS_REPORTS & self._channel.peer_reads)

    def _take_report(self, content: bytes, now_ns: int) -> tuple[bytes, ...] | None:
        report = PathReport.parse(content)
        if report is None:
            return None
        follower, sent = self._follower, self._octets_sent
        words = follower.handle_report(report, sent, now_ns, compact=self.compact)
        if words is not None:
            self._history.add(f"over the path: {words}", now_ns)
        return ()

    @property
    def _packs(self) -> bool:
        return bool(self._needs & self._channel.peer_reads)

    def _seal(self, kind: int, content: bytes, now_ns: int) -> tuple[bytes, Address] | None:
        datagram = self._channel.seal(content, now_ns, kind)
        address = self._channel.peer_address
        if datagram is None or address is None:
            return None
        self._octets_sent += _octets_on_path(datagram, address)
        return datagram, address

    def handle_rest(self, now_ns: int, until_ns: int) -> bool:
        """Take one step of what waits for the rest of a slot; whether there was one.

        until_ns: when the slot's rest ends.
        """
        packer = self._packer
        while packer is not None and (bundle := packer.poll_transmit(now_ns)) is not None:
            # Those of an end that is gone would be late for the next one.
            if self._packs and (sealed := self._seal(*bundle, now_ns)) is not None:
                self._own.append(sealed)
        arrivals = self._arrivals
        if self._reports and arrivals is not None:
            report = arrivals.poll_transmit(now_ns)
            if report is not None and (sealed := self._seal(REPORT, report, now_ns)) is not None:
                self._own.append(sealed)
        if not self._waiting and now_ns < self._due_ns:
            return False
        if until_ns - now_ns < STEP_NS and self._put_off < _MOST_PUT_OFF:
            self._put_off += 1
            return False
        self._put_off = 0
        channel = self._channel
        if self._waiting:
            datagram, source = self._waiting.popleft()
            channel.handle_datagram(datagram, source, now_ns)
        else:
            due_ns = channel.poll_timeout()
            if due_ns is None or due_ns > now_ns:
                # Records move the channel's deadlines, so look again soon.
                self._due_ns = now_ns + _LOOK_NS
                self._take_events(now_ns)
                if channel.protected and now_ns - self._sealed_ns >= KEEP_ALIVE_NS:
                    self._sealed_ns = now_ns
                    if (sealed := self._seal(RECORD, b"", now_ns)) is not None:
                        self._own.append(sealed)
                return False
            channel.handle_timeout(now_ns)
        self._due_ns = now_ns
        self._take_events(now_ns)
        return True

    def poll_transmit(self) -> tuple[bytes, Address] | None:
        """Return a datagram of a handshake, or one that waited, and where it goes."""
        return self._own.popleft() if self._own else self._channel.poll_transmit()

    def report(self, now_ns: int) -> PeerMetrics:
        """What this end knows of the path until `now_ns`."""
        self._take_events(now_ns)
        metrics, follower = self._channel.metrics, self._follower
        dropped = dict(metrics.dropped)
        if self._malformed:
            dropped["malformed"] = dropped.get("malformed", 0) + self._malformed
        if self._overflows:
            dropped["throttled"] = dropped.get("throttled", 0) + self._overflows
        where = self._channel.peer_address
        return PeerMetrics(
            begun_ns=self._history.begun_ns,
            protected=True,
            identity=self._identity,
            address=None if where is None else address_text(where),
            session_ns=self._session_ns,
            sessions=metrics.sessions,
            failed_attempts=metrics.failed_attempts,
            address_changes=self._moves,
            sent=metrics.sealed,
            unsent=metrics.unsent,
            taken=metrics.opened - self._malformed,
            octets_sent=self._octets_sent,
            compact=self.compact,
            bundled=self._packs,
            handshake_datagrams=metrics.handshake_datagrams,
            dropped=dropped,
            order_budget_ns=self._order.budget_ns(now_ns),
            frames_put_back=self._order.put_back,
            frames_too_late=self._order.too_late,
            path_state=self.allowed.state,
            path_why=follower.why,
            path_bps=follower.path_bps,
            path_queue_ns=follower.queue_ns,
            path_loss=follower.loss,
            video_cap_bps=follower.needs.video_bps * self.allowed.cap_parts // PARTS,
            events=self._history.events(),
        )

    def _take_events(self, now_ns: int) -> None:
        history = self._history
        while (event := self._channel.next_event()) is not None:
            if isinstance(event, SessionBegun):
                self._session_ns = now_ns - history.begun_ns
                word = "renewed" if event.renewed else "begun"
                history.add(f"session with {self._identity} {word}", now_ns)
            elif isinstance(event, PeerMoved):
                # The first address is no change.
                where = address_text(event.address)
                moved = self._session_ns is not None
                self._moves += moved
                history.add(f"peer {'moved to' if moved else 'found at'} {where}", now_ns)
            elif isinstance(event, HandshakeFailed):
                history.add(f"handshake failed: {event.why}", now_ns)


def _octets_on_path(datagram: bytes, address: Address) -> int:
    return len(datagram) + (IPV6_OCTETS if ":" in address[0] else IPV4_OCTETS)


class LookupSchedule:
    """When the peer's name is looked up again: while it is silent, ever more seldom."""

    def __init__(self) -> None:
        self._wait_ns, self._due_ns = FIRST_LOOKUP_NS, 0

    def poll(self, heard_ns: int, now_ns: int) -> bool:
        """Whether to look it up now. heard_ns: when the peer was heard last."""
        if now_ns - heard_ns < FIRST_LOOKUP_NS:
            self._wait_ns, self._due_ns = FIRST_LOOKUP_NS, 0
            return False
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + self._wait_ns
        self._wait_ns = min(2 * self._wait_ns, LONGEST_LOOKUP_NS)
        return True


SILENCE_NS = NS_PER_S


class OpenPath:
    """See the module for whose frames are followed.

    receive: the profile of the way in. address: where the peer is; None: it calls.
    allowed: nothing is followed.
    """

    allowed = ALL

    def __init__(self, receive: LinkProfile, *, address: Address | None, now_ns: int) -> None:
        self._codec = FrameCodec(receive)
        self._octets = receive.frame_octets
        self._fixed = address is not None
        self._address = address
        #: When the peer was heard last, or the start.
        self.heard_ns = now_ns
        self._history = PeerHistory(now_ns)
        self._history.add("the path is NOT PROTECTED", now_ns)
        self._session_ns: int | None = None if address is None else 0
        self._moves = self._sent = self._unsent = self._taken = self._unknown_senders = 0

    def handle_datagram(self, datagram: bytes, source: Address, now_ns: int) -> bytes | None:
        """Return the peer's frame, good or not; None for an unknown sender's datagram."""
        if source != self._address and not self._follow(datagram, source, now_ns):
            self._unknown_senders += 1
            return None
        # The radio may have hit some of its bits, so the peer is not silent.
        if len(datagram) == self._octets:
            self.heard_ns = now_ns
        self._taken += 1
        return datagram

    def next_frame(self, now_ns: int) -> bytes | None:
        """No frame waits for another one."""
        return None

    def seal(self, frame: bytes, now_ns: int) -> tuple[bytes, Address] | None:
        """Return the frame and where it goes; None as long as nobody has called."""
        if self._address is None:
            self._unsent += 1
            return None
        self._sent += 1
        return frame, self._address

    def handle_address(self, address: Address, now_ns: int) -> None:
        """The peer's name stands for this address now."""
        self._address = address
        self._history.add(f"name looked up: {address_text(address)}", now_ns)

    def handle_rest(self, now_ns: int, until_ns: int) -> bool:
        """There is nothing to do in the rest of a slot."""
        return False

    def poll_transmit(self) -> tuple[bytes, Address] | None:
        """There are no datagrams but those of frames."""
        return None

    def report(self, now_ns: int) -> PeerMetrics:
        """What this end knows of the path until `now_ns`."""
        return PeerMetrics(
            begun_ns=self._history.begun_ns,
            protected=False,
            address=None if self._address is None else address_text(self._address),
            session_ns=self._session_ns,
            address_changes=self._moves,
            sent=self._sent,
            unsent=self._unsent,
            taken=self._taken,
            dropped={"unknown sender": self._unknown_senders} if self._unknown_senders else {},
            events=self._history.events(),
        )

    def _follow(self, datagram: bytes, source: Address, now_ns: int) -> bool:
        found = self._address is not None
        if self._fixed or (found and now_ns - self.heard_ns < SILENCE_NS):
            return False
        if isinstance(self._codec.parse(datagram), str):
            return False
        self._moves += found
        if self._session_ns is None:
            self._session_ns = now_ns - self._history.begun_ns
        word = "moved to" if found else "found at"
        self._history.add(f"peer {word} {address_text(source)}", now_ns)
        self._address = source
        return True
