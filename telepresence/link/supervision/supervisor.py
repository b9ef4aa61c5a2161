"""Negotiation, loss of signal and supervision at one end of the link.

The design follows Stelzer et al., "Software Architecture and Design of the Kontur-2 Mission"
(2017). Each end checks itself, alive messages show the other side, and the master configures and
checks the slave. The first application data both ways approves the connection. Supervision resets
a link that is idle or broken. docs/wire-formats.md has states and timing.

Strategy: each end repeatedly sends what it *is*, never what the other should have received. The
state is a function of what this end knows. A lost message thus only costs time, and no sequence of
losses and restarts can leave both ends waiting for each other.

After each call: `next_event()` until None. The receiver delivers while `delivering`.
"""

from collections import deque
from enum import Enum, auto

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.link_metrics import OtherEndMetrics, SupervisionMetrics
from telepresence.link.repair.reserve import Loss
from telepresence.link.supervision.challenge import HelloSchedule, Proof
from telepresence.link.supervision.message import (
    KINDS_WITH_LOSS,
    Configuration,
    LinkState,
    MessageKind,
    MessagePacing,
    SupervisionMessage,
    SupervisionTiming,
    pack_message,
)
from telepresence.link.supervision.negotiation import MessageVerdict, Negotiation
from telepresence.link.supervision.record import (
    ApplicationReset,
    PeerDeaf,
    PeerDoubted,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
    StateChanged,
    SupervisionEvent,
    SupervisionRecord,
)

#: For a gateway that does not fetch events; beyond that the oldest are dropped.
_EVENTS_DEPTH = 256
#: An unknown sender that hears nobody cannot prove itself. It is followed after this many frames,
#: over this time, if no peer was ever met.
_DEAF_FRAMES = 8
_DEAF_NS = 20 * NS_PER_MS
#: If one was, the unknown sender must last for this long, and the peer be silent for this long.
_DEAF_LATER_NS = NS_PER_S
_PEER_SILENCE_NS = 2 * NS_PER_S
#: An unknown sender without a message is challenged after this time: its delay may have changed.
_MUTE_NS = 5 * NS_PER_MS
#: Fewer slots than this without a frame are never a loss of signal, however long the slots are.
_LEAST_SLOTS = 3

_TIMEOUTS = {
    "silence": "time-out: frames, but no message of the peer",
    "answer": "time-out: the slave does not confirm, it is configured anew",
}
_RESETS = {
    "idle": "reset: no application data either way",
    "broken": "reset: the peer sends application data, none comes out here",
}


#: Each reset without success doubles the next wait, up to this factor.
_LARGEST_TIMEOUT_FACTOR = 32


class ApplicationWatch:
    """One end's view of the application link.

    arrived: data has arrived in this contact, since the last reset. A direction without data is not
    a fault: an idle link is reset once, and then waits for data indefinitely.
    """

    def __init__(self, timing: SupervisionTiming, now_ns: int) -> None:
        self.arrived = False
        self.arrived_ns = now_ns - timing.idle_ns
        self.sent_ns = now_ns - timing.idle_ns
        self._timing = timing
        self._peer_sends_ns: int | None = None
        self._reset_ns = now_ns
        self._timeout = 1

    def handle_first(self) -> None:
        """The first data arrived since the contact began or the link was reset."""
        self.arrived = True
        self._timeout = 1

    def handle_contact(self, now_ns: int) -> None:
        """A new contact or a new start of the peer began, in which nothing has arrived yet."""
        self.arrived = False
        self._peer_sends_ns = None
        self._reset_ns = now_ns

    def handle_peer(self, *, was_reset: bool, sends: bool, now_ns: int) -> None:
        """Take the peer's report: whether it was reset since the last one, whether it sends."""
        if was_reset and not self.fresh(now_ns):
            self.arrived = False
        if not sends:
            self._peer_sends_ns = None
        elif self._peer_sends_ns is None:
            self._peer_sends_ns = now_ns

    def fresh(self, now_ns: int) -> bool:
        """Whether data has arrived recently."""
        return now_ns - self.arrived_ns < self._timing.idle_ns

    def sending(self, now_ns: int) -> bool:
        """Whether data has been sent recently."""
        return now_ns - self.sent_ns < self._timing.idle_ns

    def reset_due(self, *, peer_fresh: bool, approved: bool, now_ns: int) -> str | None:
        """Return `idle` or `broken` if the link was reset now, else None.

        peer_fresh: the peer has received data recently. approved: data had arrived both ways.
        Idle: an approved link that carries nothing either way. Broken: the peer sends, but nothing
        arrives here.
        """
        if self.fresh(now_ns):
            return None
        peer_sends_ns = self._peer_sends_ns
        if peer_sends_ns is None:
            if not approved or peer_fresh or self.sending(now_ns):
                return None
            return self._reset("idle", now_ns)
        wait_ns = self._timing.idle_ns * self._timeout + self._timing.round_trip_ns
        if now_ns - max(peer_sends_ns, self._reset_ns) <= wait_ns:
            return None
        self._timeout = min(2 * self._timeout, _LARGEST_TIMEOUT_FACTOR)
        return self._reset("broken", now_ns)

    def _reset(self, why: str, now_ns: int) -> str:
        self.arrived = False
        self._reset_ns = now_ns
        return why


class Encounter(Enum):
    """What to do with an unknown sender's stream, from this frame on.

    IGNORE: nothing. RETURN: follow it, the same start of the peer sends it. RESTART: follow it,
    another start of the peer sends it.
    """

    IGNORE = auto()
    RETURN = auto()
    RESTART = auto()


class Supervisor:
    """One end's supervision; `Gateway` has its run loop.

    master: whether this end configures the other; exactly one does.
    boot_id: 1 to 65535, a new one at each start of this end; the shell draws it at random.
    secret: seed of the fresh numbers by which a peer proves that it is there; the shell draws it at
        random, and nobody else may know it.

    state, why: the state of the link, and its reason.
    signal: frames of the peer's stream arrive.
    peer_hears: the peer is heard and says that it hears this end.
    delivering: received data may be delivered to the applications, because this start of the peer
    was checked. It stays true during a loss of signal.
    next_ns: when `poll_transmit` has something to do.
    loss: what of the peer's frames is lost, for the next message; set by the gateway.
    """

    def __init__(
        self,
        *,
        master: bool,
        configuration: Configuration,
        boot_id: int,
        now_ns: int,
        timing: SupervisionTiming | None = None,
        secret: int = 0,
    ) -> None:
        if not 1 <= boot_id <= 0xFFFF:
            raise ValueError(f"life is {boot_id}: it must be from 1 to 65535")
        self.master = master
        self.configuration = configuration
        self.timing = timing or SupervisionTiming()
        self.boot_id = boot_id
        self.state = LinkState.CHECK
        self.why = "the local check has not been made"
        self.signal = False
        self.peer_hears = False
        self.delivering = False
        self.loss = Loss()
        # poll_transmit runs once a slot, so it notices a loss up to a slot late.
        self._silence_ns = max(
            self.timing.loss_ns - configuration.transmit.slot_ns,
            _LEAST_SLOTS * configuration.receive.slot_ns,
        )
        self._fault: str | None = self.why
        self._frame_ns = now_ns
        self.next_ns = now_ns
        self._negotiation = Negotiation(
            master=master,
            configuration=configuration,
            boot_id=boot_id,
            timing=self.timing,
            now_ns=now_ns,
        )
        self._application = ApplicationWatch(self.timing, now_ns)
        self._pacing = MessagePacing(self.timing, now_ns)
        self._proof, self._hellos = Proof(secret, self.timing), HelloSchedule(self.timing, now_ns)
        #: The newest message of the unknown sender's stream that matches.
        self._unknown: SupervisionMessage | None = None
        #: When a frame of any unknown sender came.
        self._stray_ns = now_ns - self.timing.silence_ns
        self._events: deque[SupervisionEvent] = deque(maxlen=_EVENTS_DEPTH)
        self._record = SupervisionRecord(self.state, self.why, now_ns)
        self._counts = self._record.counts

    @property
    def peer_boot_id(self) -> int:
        """The start of the peer that was checked; 0 before the first."""
        return self._negotiation.peer_boot_id

    @property
    def repair(self) -> bool:
        """Whether both ends restore lost frames, as far as this end knows."""
        return self._negotiation.repair

    @property
    def peer_loss(self) -> Loss | None:
        """What the peer's last message says of this end's frames; None: it says nothing."""
        peer = self._negotiation.peer
        return None if peer is None or peer.kind not in KINDS_WITH_LOSS else peer.loss

    def handle_unknown_sender(
        self, message: bytes | None, now_ns: int, *, frames: int, lasts_ns: int
    ) -> Encounter:
        """A good frame of a stream that is not followed.

        message: its supervision message, or None. frames, lasts_ns: of its stream so far
        (`UnknownFrame`).

        After RETURN and RESTART this very frame is one of the peer's stream.
        """
        self._stray_ns = now_ns
        if frames == 1:
            self._unknown = None
        told = None if message is None else self._hear_unknown_sender(message, now_ns)
        if told is not None and frames:
            self._unknown = told
        if told is not None and self._proof.answers(told.echo, now_ns):
            if not (self.signal and told.boot_id == self.peer_boot_id):
                return self._meet(told, now_ns, proven=True)
            # A late copy of the answer, which itself was lost. The peer's stream is there.
            self._proof.proven = True
        known = self._unknown
        if known is not None and self._may_be_deaf(known, now_ns, frames, lasts_ns):
            return self._meet(known, now_ns, proven=False)
        candidate = told is not None or lasts_ns >= _MUTE_NS
        if candidate and self._hellos.handle_candidate(now_ns, alone=not self.signal):
            self._schedule(now_ns)
        if message is not None:
            self._counts["messages_received"] += told is not None
            self._update(now_ns)
        return Encounter.IGNORE

    def handle_frame(self, now_ns: int) -> None:
        """A frame of the peer's stream arrived; call it before the frame is processed further."""
        self._frame_ns = now_ns
        if not self.signal:
            self.signal = True
            self._negotiation.handle_contact(now_ns)
            self._application.handle_contact(now_ns)
            gap_ns = self._record.handle_signal_acquired(now_ns)
            self._events.append(SignalAcquired(now_ns, gap_ns))
            self._update(now_ns)

    def handle_application(self, now_ns: int) -> None:
        """A sample or a packet of the peer's applications arrived."""
        application = self._application
        application.arrived_ns = now_ns
        if not application.arrived:
            application.handle_first()
            self._update(now_ns)

    def handle_application_sent(self, now_ns: int) -> None:
        """A sample or a packet of the local applications goes out."""
        self._application.sent_ns = now_ns

    def handle_local_check(self, fault: str | None, now_ns: int) -> None:
        """None: this end works. A line: what does not; then nothing is delivered."""
        if fault != self._fault:
            self._fault = fault
            self._update(now_ns)

    def handle_message(self, message: bytes, now_ns: int) -> None:
        """Take twelve octets from a frame of the peer's stream.

        Invalid ones are counted; this never raises.
        """
        negotiation, counts = self._negotiation, self._counts
        self.handle_frame(now_ns)
        before, before_boot_id = negotiation.peer, negotiation.peer_boot_id
        verdict = negotiation.handle_message(message, now_ns)
        if verdict is MessageVerdict.MALFORMED:
            counts["messages_malformed"] += 1
            return
        counts["messages_received"] += 1
        if verdict in (MessageVerdict.SUSPECT, MessageVerdict.REFUSED, MessageVerdict.DOUBTED):
            counts["messages_mismatched"] += 1
        if verdict is MessageVerdict.SUSPECT:
            return
        if verdict is MessageVerdict.DOUBTED:
            self._lose(now_ns)
            self._events.append(PeerDoubted(now_ns))
            self._update(now_ns)
            return
        if verdict is MessageVerdict.MET:
            before = None
            self._note_met(before_boot_id, now_ns)
        if verdict is not MessageVerdict.FITS:
            self._application.handle_contact(now_ns)
        peer = negotiation.peer
        if peer is not None and peer.kind is MessageKind.HELLO:
            if self._proof.answers(peer.echo, now_ns):
                self._proof.proven = True
                negotiation.handle_answer()
            self._note_challenge(peer, now_ns)
        self._note_hearing(now_ns)
        if peer is not None:
            was_reset = before is not None and before.application and not peer.application
            self._application.handle_peer(was_reset=was_reset, sends=peer.sending, now_ns=now_ns)
        self._update(now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the twelve octets for this slot, or None. Call once each slot."""
        if now_ns < self.next_ns:
            return None
        return self._run_slot(now_ns)

    def next_event(self) -> SupervisionEvent | None:
        """The oldest event that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def report(self, now_ns: int) -> SupervisionMetrics:
        """Return state, peer, counts, contact windows and the last transitions with reasons."""
        peer = self._negotiation.peer
        record = self._record
        return SupervisionMetrics(
            role="master" if self.master else "slave",
            boot_id=self.boot_id,
            state=self.state.name.lower(),
            why=self.why,
            signal=self.signal,
            peer_hears=self.peer_hears,
            delivering=self.delivering,
            peer=OtherEndMetrics(
                boot_id=self.peer_boot_id, state=None if peer is None else peer.state.name.lower()
            ),
            begun_ns=record.begun_ns,
            since_ns=record.since_ns,
            in_state_ns=record.in_state_ns(now_ns),
            counts=dict(record.counts),
            contact_ns=record.contact_ns(now_ns),
            longest_gap_ns=record.longest_gap_ns,
            contacts=list(record.contacts),
            history=list(record.history),
        )

    def _hear_unknown_sender(self, data: bytes, now_ns: int) -> SupervisionMessage | None:
        counts = self._counts
        told = self._negotiation.handle_unknown_sender(data, alone=not self.signal)
        if isinstance(told, SupervisionMessage):
            self._note_challenge(told, now_ns)
            return told
        if told is MessageVerdict.MALFORMED:
            counts["messages_malformed"] += 1
        else:
            counts["messages_received"] += 1
            counts["messages_mismatched"] += 1
        return None

    def _may_be_deaf(
        self, told: SupervisionMessage, now_ns: int, frames: int, lasts_ns: int
    ) -> bool:
        """Whether to follow an unknown sender that hears nobody, and so cannot answer."""
        if told.signal or frames < _DEAF_FRAMES:
            return False
        if not self.peer_boot_id:
            return lasts_ns >= _DEAF_NS
        return lasts_ns >= _DEAF_LATER_NS and now_ns - self._frame_ns >= _PEER_SILENCE_NS

    def _meet(self, told: SupervisionMessage, now_ns: int, *, proven: bool) -> Encounter:
        before_boot_id = self.peer_boot_id
        self._proof.proven = proven
        self._unknown = None
        self._hellos.handle_met(now_ns)
        if not self._negotiation.meet(told.boot_id):
            self._update(now_ns)
            return Encounter.RETURN
        self._application.handle_contact(now_ns)
        self._note_met(before_boot_id, now_ns)
        self._note_hearing(now_ns)
        self._update(now_ns)
        return Encounter.RESTART

    def _note_met(self, before_boot_id: int, now_ns: int) -> None:
        self._counts["peer_restarts"] += before_boot_id != 0
        self._events.append(PeerMet(now_ns, self.peer_boot_id, before_boot_id != 0))

    def _note_challenge(self, told: SupervisionMessage, now_ns: int) -> None:
        if told.number:
            settled = self.signal and self._proof.proven
            self._hellos.handle_challenge(told.number, now_ns, settled=settled)
            self._schedule(now_ns)

    def _lose(self, now_ns: int) -> None:
        self.signal = self.peer_hears = False
        self._negotiation.handle_contact(now_ns)
        self._application.handle_contact(now_ns)
        self._record.handle_signal_lost(self._frame_ns)
        self._events.append(SignalLost(now_ns, self._frame_ns))

    def _note_hearing(self, now_ns: int) -> None:
        hears = self._negotiation.hears
        if hears != self.peer_hears:
            self.peer_hears = hears
            self._counts["peer_deaf"] += not hears
            self._events.append(PeerHears(now_ns) if hears else PeerDeaf(now_ns))

    def _run_slot(self, now_ns: int) -> bytes | None:
        cause = None
        if self.signal and now_ns >= self._frame_ns + self._silence_ns:
            self._lose(now_ns)
        elif now_ns >= self._pacing.due_ns:
            cause = self._supervise(now_ns)
        if not self.signal and now_ns >= self._stray_ns + self._silence_ns:
            self._negotiation.refusal = None
        self._update(now_ns, cause)
        if now_ns < self.next_ns:
            return None
        kind = self._kind()
        regular = now_ns >= self._pacing.due_ns
        hello = self._hellos.is_next(now_ns, regular=regular)
        message = self._message(MessageKind.HELLO if hello else kind, now_ns)
        if message.kind is kind:
            self._pacing.handle_sent(self._content(), now_ns)
        else:
            self._pacing.handle_extra(now_ns)
        if message.kind is MessageKind.HELLO:
            self._hellos.handle_sent(message, now_ns)
        self._counts["messages_sent"] += 1
        self._schedule(now_ns)
        return pack_message(message)

    def _supervise(self, now_ns: int) -> str | None:
        """Check what took too long, whenever a message is due; that is often enough."""
        timeout = self._negotiation.timeout(now_ns)
        if timeout is not None:
            self._counts[f"timeouts_{timeout}"] += 1
            self._note_hearing(now_ns)
            return _TIMEOUTS[timeout]
        peer = self._negotiation.peer
        if peer is None or self.state not in (LinkState.APPROVE, LinkState.CONNECTED):
            return None
        approved = self.state is LinkState.CONNECTED
        reset = self._application.reset_due(peer_fresh=peer.fresh, approved=approved, now_ns=now_ns)
        if reset is None:
            return None
        self._counts[f"resets_{reset}"] += 1
        self._events.append(ApplicationReset(now_ns, reset))
        return _RESETS[reset]

    def _find_state(self) -> tuple[LinkState, str]:
        """Return the state that follows from what is known, and why it is not a later one."""
        if self._fault is not None:
            return LinkState.CHECK, self._fault
        if not self.signal and self._negotiation.refusal is None:
            return LinkState.SEARCH, "no signal"
        peer = self._negotiation.peer
        obstacle = self._negotiation.obstacle()
        if obstacle is not None or peer is None:
            return obstacle or (LinkState.SEARCH, "no peer")
        here, there = self._application.arrived, peer.application
        if here and there:
            return LinkState.CONNECTED, "application data both ways"
        where = "at the peer" if here else "here" if there else "either way"
        return LinkState.APPROVE, f"agreed; no application data {where} yet"

    def _update(self, now_ns: int, cause: str | None = None) -> None:
        """Derive state, delivery and next message; cause: says more than the state's reason."""
        state, why = self._find_state()
        before = self.state
        refined = state is LinkState.REFUSED and why != self.why
        self.state, self.why = state, why
        self.delivering = self._fault is None and self._negotiation.checked
        if state is not before or cause is not None or refined:
            self._record.handle_state(state, cause or why, now_ns)
            self._events.append(StateChanged(now_ns, before, state, cause or why))
        self._schedule(now_ns)

    def _schedule(self, now_ns: int) -> None:
        peer, pacing = self._negotiation.peer, self._pacing
        connected = LinkState.CONNECTED
        settled = self.state is connected and peer is not None and peer.state is connected
        pacing.handle_content(self._content(), now_ns, heard=self.peer_hears, settled=settled)
        self.next_ns = pacing.due_ns
        if (hello_ns := self._hellos.next_ns(pacing.earliest_ns)) is not None:
            self.next_ns = min(self.next_ns, hello_ns)
        if self.signal:
            self.next_ns = min(self.next_ns, self._frame_ns + self._silence_ns)

    def _content(self) -> tuple[int, ...]:
        """Return the parts of a message whose change the peer must learn at once."""
        peer = self._negotiation.peer
        heard = 0 if peer is None else peer.boot_id
        return (self._kind(), self.state, self.signal, self._application.arrived, heard)

    def _kind(self) -> MessageKind:
        if not self.signal and self.state is not LinkState.REFUSED:
            return MessageKind.HELLO
        return self._negotiation.kind(self.state)

    def _message(self, kind: MessageKind, now_ns: int) -> SupervisionMessage:
        negotiation, application, hellos = self._negotiation, self._application, self._hellos
        peer = negotiation.peer
        number = echo = 0
        if kind is MessageKind.HELLO:
            echo = hellos.challenge
            if hellos.asks(now_ns) or not (self.signal and self._proof.proven):
                number = self._proof.number(now_ns)
        return SupervisionMessage(
            version=negotiation.version,
            kind=kind,
            state=self.state,
            master=self.master,
            signal=self.signal,
            application=application.arrived,
            fresh=application.fresh(now_ns),
            sending=application.sending(now_ns),
            boot_id=self.boot_id,
            heard=0 if peer is None else peer.boot_id,
            digest=negotiation.digest,
            rates_kbps=negotiation.rates_kbps,
            number=number,
            echo=echo,
            loss=self.loss,
        )
