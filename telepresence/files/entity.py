"""One end of the file transfer: several transactions at once, at a bounded rate, in contact only.

All timers run on the time in contact, and only while the link has room; the rate uses real time. So
a loss of signal suspends every transaction, and afterwards it goes on where it was (CCSDS
727.0-B-5 clause 4.11).
"""

from collections import OrderedDict, deque
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.files.pdus import (
    GET,
    LIST,
    RENAME,
    Ack,
    ChecksumType,
    ConditionCode,
    DirectiveType,
    Eof,
    FileData,
    Finished,
    KeepAlive,
    Key,
    Metadata,
    Nak,
    Pdu,
    Request,
    pack_pdu,
    parse_pdu,
)
from telepresence.files.sides import (
    CANCELLED,
    MAX_FILE_OCTETS,
    FileReceiver,
    FileSender,
    TransactionPace,
    closing,
    why,
)
from telepresence.link.bucket import TokenBucket


@dataclass(slots=True, kw_only=True)
class FileMetrics:
    """Files to and from the other end."""

    #: Octets of files that were sent, each counted once.
    file_octets_sent: int = 0
    #: Octets that were sent again, because the other end had not got them.
    file_octets_resent: int = 0
    #: Octets of files that came, each counted once.
    file_octets_received: int = 0
    #: Octets that came more than once.
    file_octets_repeated: int = 0
    #: Transactions that ended well, of both ends.
    file_transactions_finished: int = 0
    #: Transactions that failed, of both ends.
    file_transactions_failed: int = 0
    #: What this end refused: names, jobs of its directory, too many at once.
    file_requests_refused: int = 0
    #: Malformed datagrams.
    file_garbage: int = 0
    #: How long transactions waited for contact.
    file_suspended_ns: int = 0


_MOST_NAME_OCTETS = 200
_MOST_NAME_PARTS = 8


def fenced(name: str, *, directory: bool = False) -> tuple[str, ...]:
    """Return the parts of a name inside the directory.

    directory: it names a directory, so that "" is the fenced one itself. ConfigError for a name
    that could leave the directory, or is hidden: hidden names are those of files half written.
    """
    if directory and name in ("", "."):
        return ()
    parts = tuple(name.split("/"))
    printable = name.isprintable() and len(name.encode(errors="replace")) <= _MOST_NAME_OCTETS
    if (
        not printable
        or len(parts) > _MOST_NAME_PARTS
        or any(part[:1] in ("", ".") for part in parts)
    ):
        raise ConfigError(
            f"file name {name[:80]!r}: give at most {_MOST_NAME_OCTETS} printable octets and "
            f"{_MOST_NAME_PARTS} parts, none empty or with a dot in front"
        )
    return parts


PUT = "put"
#: What a job does beside the kinds of requests: keep a file that came.
STORE = "store"
WAITING, RUNNING, SUSPENDED, DONE, FAILED = "waiting", "running", "suspended", "done", "failed"
#: The most transactions at once that this end began, and that the other end began.
MOST_SENDING = MOST_RECEIVING = 8
#: How many that are over are remembered: their last PDUs may come again.
_REMEMBERED = 64
#: Send the next PDU while fewer octets wait in the link than these, or than the rate gives in
#: `_ROOM_NS`, two looks at the link. So the link does not run dry, and a lost signal loses little.
_ROOM_OCTETS, _ROOM_NS = 1024, 20 * NS_PER_MS
_MOST_ANSWERS = 16
#: After this time in contact without an answer from the other end, the user is told.
_NOTICE_NS = 10 * NS_PER_S
_HEADER_OCTETS = 16
#: A listing goes into one answer to a terminal.
LARGEST_LISTING = 4 << 10


class DirectoryJob(NamedTuple):
    """What the shell is to do in this end's directory: `STORE`, GET, LIST, RENAME or REMOVE.

    The names are inside the directory. Answer by `FileEntity.handle_done`.
    """

    key: Key
    kind: str
    first: str
    second: str = ""
    octets: bytes = b""


@dataclass(slots=True, kw_only=True)
class Transfer:
    """What a user asked this end for. number: of its transaction.

    octets, size: as far as they came or went; size is -1 if it is not known. reason: why it failed.
    text: the listing that was asked for.
    """

    number: int
    kind: str
    first: str
    second: str
    octets: int = 0
    size: int = -1
    state: str = WAITING
    reason: str = ""
    text: str = ""
    #: The last sign of life, in the time in contact.
    heard_ns: int = 0

    @property
    def over(self) -> bool:
        """Whether it is done, or has failed."""
        return self.state in (DONE, FAILED)


class FileEntity:
    """A CFDP entity. Call `put` and `ask` for a user; hand over PDUs and the state of the link.

    After each input send the PDUs of `poll_transmit` until None, then do the jobs of `next_event`
    until None. Do both again at `poll_timeout`.

    entity, peer: the ids of this end and of the other one. first_number: above those of earlier
    lives. rate_bps: the most that is sent. delay_ns: the longest delay of the radio, one way.
    checksum: of files from here, one of `KNOWN_SUMS`.
    """

    def __init__(
        self,
        *,
        entity: int,
        peer: int,
        first_number: int,
        rate_bps: int,
        now_ns: int,
        segment_octets: int = 512,
        repeat_ns: int = 3 * NS_PER_S,
        timeout_ns: int = 120 * NS_PER_S,
        delay_ns: int = 0,
        checksum: int = ChecksumType.CRC_32,
    ) -> None:
        self._entity, self._peer, self._checksum = entity, peer, checksum
        self._next_number = first_number & 0xFFFFFFFF
        self._pace = TransactionPace(
            segment_octets=segment_octets,
            repeat_ns=repeat_ns + 2 * delay_ns,
            timeout_ns=timeout_ns + 2 * delay_ns,
        )
        self._most_octets = segment_octets + _HEADER_OCTETS
        room_octets = rate_bps * _ROOM_NS // (8 * NS_PER_S)
        self._room_octets = max(_ROOM_OCTETS, room_octets)
        self._bucket = TokenBucket(rate_bps, max(2 * self._most_octets, room_octets))
        self._senders: OrderedDict[Key, FileSender] = OrderedDict()
        self._receivers: OrderedDict[Key, FileReceiver] = OrderedDict()
        #: Those of the other end that are over, with what it was told.
        self._over: OrderedDict[Key, Finished | None] = OrderedDict()
        self.transfers: OrderedDict[int, Transfer] = OrderedDict()
        #: What was asked for and comes as a transaction of the other end.
        self._expected: dict[Key, Transfer] = {}
        #: Cancelled before it came: it is cancelled at its receiver when it comes.
        self._unwanted: OrderedDict[Key, None] = OrderedDict()
        self._answers: deque[Pdu] = deque()
        self._jobs: deque[DirectoryJob] = deque()
        self.counts = FileMetrics()
        self._heard, self._room = False, True
        #: The time in contact at the last change, and when that was.
        self._contact_ns, self._changed_ns = 0, now_ns
        #: When the other end was heard last, in the time in contact.
        self._peer_ns = -1

    def put(self, first: str, second: str, octets: bytes, now_ns: int) -> Transfer:
        """Send the octets of the file `first` to the other end, as `second` or under its own name.

        ConfigError for a name that cannot be, a file too large, or too many at once.
        """
        second = second or first
        for name in (first, second):
            fenced(name)
        if len(octets) > MAX_FILE_OCTETS:
            raise ConfigError(
                f"{first}: {len(octets)} octets: at most {MAX_FILE_OCTETS}; send it in parts"
            )
        key = self._new_key()
        metadata = Metadata(
            key=key,
            size=len(octets),
            checksum=self._checksum,
            source=first,
            destination=second,
            sha256=sha256(octets).digest(),
        )
        return self._begin(metadata, octets, PUT, first, second, now_ns)

    def ask(self, kind: str, first: str, second: str, now_ns: int) -> Transfer:
        """Ask the other end: GET the file `first` as `second`, LIST, RENAME or REMOVE `first`.

        ConfigError as of `put`.
        """
        fenced(first, directory=kind == LIST)
        if kind == GET:
            second = second or first
        if kind in (GET, RENAME):
            fenced(second)
        key = self._new_key()
        metadata = Metadata(
            key=key, checksum=ChecksumType.NULL_CHECKSUM, request=Request(kind, first, second)
        )
        return self._begin(metadata, b"", kind, first, second, now_ns)

    def cancel(self, number: int, now_ns: int) -> Transfer:
        """Give up a transfer that was asked for here, at both ends. ConfigError if it is over."""
        transfer = self.transfers.get(number)
        if transfer is None or transfer.over:
            raise ConfigError(f"no transfer {number} is under way: see kontur-av file status")
        key, at_ns = Key(self._entity, self._peer, number), self._time(now_ns)
        if (sender := self._senders.get(key)) is not None:
            sender.cancel()
        if self._expected.pop(key, None) is not None:
            while len(self._unwanted) >= _REMEMBERED:
                self._unwanted.popitem(last=False)
            self._unwanted[key] = None
            for receiver in self._receivers.values():
                self._drop_unwanted(receiver, at_ns)
        self._end(transfer, CANCELLED)
        return transfer

    def handle_pdu(self, octets: bytes, now_ns: int) -> None:
        """A datagram from the other end; garbage is counted."""
        try:
            pdu = parse_pdu(octets)
        except ProtocolError:
            self.counts.file_garbage += 1
            return
        key, at_ns = pdu.key, self._time(now_ns)
        self._peer_ns = at_ns
        if (key.source, key.destination) == (self._entity, self._peer):
            self._answered(pdu, at_ns)
        elif (key.source, key.destination) == (self._peer, self._entity):
            self._received(pdu, at_ns)
        else:
            self.counts.file_garbage += 1

    def handle_link(self, *, heard: bool, waiting_octets: int, now_ns: int) -> None:
        """Whether the other end is heard, and what waits in the link on the maintenance level."""
        room = waiting_octets < self._room_octets
        if (heard, room) == (self._heard, self._room):
            return
        self._contact_ns = self._time(now_ns)
        if not self._heard and self.open:
            self.counts.file_suspended_ns += now_ns - self._changed_ns
        self._changed_ns = now_ns
        self._heard, self._room = heard, room

    def handle_sent_before(self, octets: int, now_ns: int) -> None:
        """Services, which go first, have used up `octets` of this end's rate."""
        self._bucket.take(octets, now_ns)

    def handle_done(
        self, job: DirectoryJob, refusal: str, now_ns: int, octets: bytes = b""
    ) -> None:
        """A job is done; else refusal says why not. octets: of the file or of the listing."""
        receiver, at_ns = self._receivers.get(job.key), self._time(now_ns)
        if receiver is None:
            return
        if job.kind in (GET, LIST) and not refusal:
            refusal = self._send_back(job, octets, at_ns)
        self.counts.file_requests_refused += bool(refusal)
        receiver.handle_stored(refusal, at_ns)
        self._publish_origin(receiver)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next PDU, or None."""
        if not self._running:
            return None
        if not self._bucket.holds(self._most_octets, now_ns):
            return None
        at_ns = self._time(now_ns)
        pdu = self._answers.popleft() if self._answers else self._poll(at_ns)
        self._expire(at_ns)
        if pdu is None:
            return None
        octets = pack_pdu(pdu)
        self._bucket.take(len(octets), now_ns)
        return octets

    def poll_timeout(self, now_ns: int) -> int | None:
        """When `poll_transmit` has something next; None: not before the next input."""
        if not self._running:
            return None
        due = [sender.poll_timeout() for sender in self._senders.values()]
        due += [receiver.poll_timeout() for receiver in self._receivers.values()]
        timeout_ns, expected = self._pace.timeout_ns, self._expected.items()
        due += [one.heard_ns + timeout_ns for key, one in expected if key not in self._senders]
        due_ns = min((one for one in due if one is not None), default=None)
        if self._answers:
            due_ns = 0
        if due_ns is None:
            return None
        free_ns = self._bucket.holds_ns(self._most_octets, now_ns)
        return max(free_ns, now_ns + due_ns - self._time(now_ns))

    def next_event(self) -> DirectoryJob | None:
        """Return the next job, or None."""
        return self._jobs.popleft() if self._jobs else None

    def report(self, now_ns: int) -> FileMetrics:
        """What was counted so far."""
        if not self._heard and self.open:
            self.counts.file_suspended_ns += now_ns - self._changed_ns
            self._changed_ns = now_ns
        return replace(self.counts)

    def state_of(self, transfer: Transfer) -> str:
        """How it is with a transfer, with the link as it is now."""
        return transfer.state if transfer.over or self._heard else SUSPENDED

    def unanswered(self, transfer: Transfer, now_ns: int) -> bool:
        """Whether nothing at all was heard for a while since a transfer began."""
        sender = self._senders.get(Key(self._entity, self._peer, transfer.number))
        if sender is None or sender.began_ns is None or self._peer_ns >= sender.began_ns:
            return False
        return self._heard and self._time(now_ns) - sender.began_ns >= _NOTICE_NS

    @property
    def open(self) -> bool:
        """Whether a transaction is under way."""
        return bool(self._senders or self._receivers or self._expected)

    @property
    def _running(self) -> bool:
        return self._heard and self._room

    def _time(self, now_ns: int) -> int:
        """The time in contact: the clock of all timers."""
        passed_ns = now_ns - self._changed_ns if self._running else 0
        return self._contact_ns + passed_ns

    def _new_key(self) -> Key:
        if len(self._senders.keys() | self._expected.keys()) >= MOST_SENDING:
            raise ConfigError(f"{MOST_SENDING} transfers at once: wait until one has ended")
        number = self._next_number
        self._next_number = (number + 1) & 0xFFFFFFFF
        return Key(self._entity, self._peer, number)

    def _begin(
        self, metadata: Metadata, octets: bytes, kind: str, first: str, second: str, now_ns: int
    ) -> Transfer:
        key, at_ns = metadata.key, self._time(now_ns)
        transfer = Transfer(
            number=key.number, kind=kind, first=first, second=second, heard_ns=at_ns
        )
        if kind == PUT:
            transfer.size = len(octets)
        if len(self.transfers) >= _REMEMBERED:
            ended = (key for key, one in self.transfers.items() if one.over)
            del self.transfers[next(ended)]
        self.transfers[key.number] = transfer
        if kind in (GET, LIST):
            self._expected[key] = transfer
        self._senders[key] = FileSender(metadata, octets, self._pace, at_ns)
        return transfer

    def _answered(self, pdu: Pdu, at_ns: int) -> None:
        """A PDU of the receiver of a transaction that began here."""
        sender = self._senders.get(pdu.key)
        if sender is None:
            if isinstance(pdu, Finished):
                self._answer(closing(pdu))
        elif isinstance(pdu, Ack | Nak | Finished | KeepAlive):
            sender.handle_pdu(pdu, at_ns)

    def _received(self, pdu: Pdu, at_ns: int) -> None:
        """A PDU of a transaction that the other end began."""
        key = pdu.key
        receiver = self._receivers.get(key)
        if receiver is None:
            if key in self._over:
                self._remind(pdu)
                return
            if not isinstance(pdu, Metadata | FileData | Eof):
                return
            if len(self._receivers) >= MOST_RECEIVING:
                # Without an answer it is sent again, when one of the others may have ended.
                self.counts.file_requests_refused += 1
                return
            receiver = self._receivers[key] = FileReceiver(key, self._pace, at_ns)
        before = receiver.received_octets, receiver.repeated_octets, receiver.whole
        receiver.handle_pdu(pdu, at_ns)
        self.counts.file_octets_received += receiver.received_octets - before[0]
        self.counts.file_octets_repeated += receiver.repeated_octets - before[1]
        self._drop_unwanted(receiver, at_ns)
        metadata = receiver.metadata
        transfer = None
        if metadata is not None and metadata.origin is not None:
            transfer = self._expected.get(metadata.origin)
        if transfer is not None:
            transfer.state, transfer.heard_ns = RUNNING, at_ns
            transfer.octets = receiver.received_octets
            transfer.size = -1 if receiver.size is None else receiver.size
        if receiver.whole and not before[2] and receiver.finished is None:
            self._whole(receiver, transfer, at_ns)
        elif receiver.finished is not None:
            self._publish_origin(receiver)

    def _drop_unwanted(self, receiver: FileReceiver, at_ns: int) -> None:
        metadata = receiver.metadata
        if metadata is not None and metadata.origin in self._unwanted:
            receiver.cancel(at_ns)

    def _whole(self, receiver: FileReceiver, transfer: Transfer | None, at_ns: int) -> None:
        """A file has come, or a request: do what it asks for."""
        metadata = receiver.metadata
        assert metadata is not None
        key, request = receiver.key, metadata.request
        try:
            if transfer is not None and transfer.kind == LIST:
                text = receiver.octets[:LARGEST_LISTING].decode(errors="replace")
                # It goes to a terminal.
                transfer.text = "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
                receiver.handle_stored("", at_ns)
                self._publish_origin(receiver)
            elif metadata.destination:
                # What was asked for gets the name that was asked for, whatever comes.
                name = metadata.destination if transfer is None else transfer.second
                fenced(name)
                self._jobs.append(DirectoryJob(key, STORE, name, octets=receiver.octets))
            elif request is not None:
                fenced(request.first, directory=request.kind == LIST)
                if request.kind == RENAME:
                    fenced(request.second)
                self._jobs.append(DirectoryJob(key, request.kind, request.first, request.second))
            else:
                receiver.handle_stored("", at_ns)
        except ConfigError:
            self.counts.file_requests_refused += 1
            receiver.handle_stored("the name is not allowed", at_ns)
            self._publish_origin(receiver)

    def _send_back(self, job: DirectoryJob, octets: bytes, at_ns: int) -> str:
        """Send what was asked for; return why that cannot be."""
        if len(octets) > MAX_FILE_OCTETS:
            return "the file is too large"
        try:
            key = self._new_key()
        except ConfigError:
            return "too many transfers at once"
        metadata = Metadata(
            key=key,
            size=len(octets),
            checksum=self._checksum,
            source=job.first or ".",
            destination=job.second or "listing",
            sha256=sha256(octets).digest(),
            origin=job.key,
        )
        self._senders[key] = FileSender(metadata, octets, self._pace, at_ns)
        return ""

    def _publish_origin(self, receiver: FileReceiver) -> None:
        """What was asked for has come, or it has failed."""
        metadata, finished = receiver.metadata, receiver.finished
        if metadata is None or metadata.origin is None or finished is None:
            return
        transfer = self._expected.pop(metadata.origin, None)
        if transfer is not None:
            self._end(transfer, _reason(finished))

    def _end(self, transfer: Transfer, reason: str) -> None:
        transfer.state, transfer.reason = (FAILED if reason else DONE), reason

    def _remind(self, pdu: Pdu) -> None:
        """A PDU of a transaction that is over: the sender has missed its end (clause 4.7.2)."""
        if isinstance(pdu, Eof):
            condition = ConditionCode(pdu.condition)
            self._answer(
                Ack(key=pdu.key, of=DirectiveType.EOF_PDU, condition=condition, active=False)
            )
            finished = self._over[pdu.key]
            if finished is not None:
                self._answer(finished)

    def _answer(self, pdu: Pdu) -> None:
        """Beyond a few, what is asked again and again is answered later."""
        if len(self._answers) < _MOST_ANSWERS:
            self._answers.append(pdu)
        else:
            self.counts.file_requests_refused += 1

    def _poll(self, at_ns: int) -> Pdu | None:
        """Ask all in turn; receivers first, because their PDUs are short."""
        for receiver in list(self._receivers.values()):
            pdu = receiver.poll_transmit(at_ns)
            if receiver.finished is not None:
                self._publish_origin(receiver)
            if pdu is not None:
                return pdu
        for key, sender in list(self._senders.items()):
            before = sender.sent_octets, sender.resent_octets
            pdu = sender.poll_transmit(at_ns)
            self.counts.file_octets_sent += sender.sent_octets - before[0]
            self.counts.file_octets_resent += sender.resent_octets - before[1]
            transfer = self.transfers.get(key.number)
            if transfer is not None and not transfer.over and transfer.kind == PUT:
                transfer.state, transfer.octets = RUNNING, sender.sent_octets
            if pdu is not None:
                self._senders.move_to_end(key)
                return pdu
        return None

    def _expire(self, at_ns: int) -> None:
        """Forget what is over, and tell the user."""
        for key, receiver in list(self._receivers.items()):
            if receiver.ended:
                del self._receivers[key]
                finished = receiver.finished
                good = finished is not None and finished.condition == ConditionCode.NO_ERROR
                self._count(good=good)
                while len(self._over) >= _REMEMBERED:
                    self._over.popitem(last=False)
                self._over[key] = finished
        for key, sender in list(self._senders.items()):
            if sender.ended:
                del self._senders[key]
                self._close(key, sender, at_ns)
        for key, transfer in list(self._expected.items()):
            silent_ns = at_ns - transfer.heard_ns
            if key not in self._senders and silent_ns >= self._pace.timeout_ns:
                del self._expected[key]
                self._end(transfer, "the other end fell silent")

    def _close(self, key: Key, sender: FileSender, at_ns: int) -> None:
        reason = sender.failure if sender.done is None else _reason(sender.done)
        self._count(good=not reason)
        transfer = self.transfers.get(key.number)
        if transfer is None or transfer.over:
            return
        if not reason and transfer.kind in (GET, LIST):
            transfer.heard_ns = at_ns
            return
        self._expected.pop(key, None)
        self._end(transfer, reason)

    def _count(self, *, good: bool) -> None:
        self.counts.file_transactions_finished += good
        self.counts.file_transactions_failed += not good


def _reason(finished: Finished) -> str:
    """Why a transaction failed; "" if it did not."""
    if finished.condition != ConditionCode.NO_ERROR:
        return finished.reason or why(finished.condition)
    return finished.reason or ("" if finished.complete else "the file did not arrive whole")
