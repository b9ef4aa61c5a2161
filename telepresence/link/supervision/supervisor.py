"""Negotiation, loss of signal and supervision at one end of the link.

The design follows Stelzer et al., "Software Architecture and Design of the Kontur-2 Mission"
(2017). Each end checks itself, alive messages show the other side, and the master configures and
checks the slave. The first application data both ways approves the connection. Supervision resets
a link that is idle or broken. docs/link-contact.md has the states, the timing and all events.

Strategy: each end repeatedly sends what it *is*, never what the other should have received. The
state is a function of what this end knows. A lost message thus only costs time, and no sequence of
losses and restarts can leave both ends waiting for each other.

A gateway needs six lines:

1. `handle_local_check(None, now_ns)` once it is ready, and with a fault whenever it is not.
2. `handle_frame(now_ns)` for each good frame, before the frame is processed further.
3. `handle_message(message, now_ns)` for each supervision message that the receiver found in it.
4. `handle_application(now_ns)` for each sample and packet received, and
   `handle_application_sent(now_ns)` for each one sent.
5. `poll_transmit(now_ns)` in each slot; if it returns 12 octets, this is a supervision slot.
6. After each of these: `next_event()` until None. The receiver delivers while `delivering`.
"""

from collections import deque
from collections.abc import Sequence

from telepresence.link.figures import PeerFigures, SupervisionFigures
from telepresence.link.supervision.application import ApplicationWatch
from telepresence.link.supervision.configuration import Configuration, SupervisionTiming
from telepresence.link.supervision.events import (
    ApplicationReset,
    ContextsHeld,
    PeerDeaf,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
    StateChanged,
    SupervisionEvent,
)
from telepresence.link.supervision.message import (
    LinkState,
    MessageKind,
    SupervisionMessage,
    pack_message,
)
from telepresence.link.supervision.negotiation import MessageVerdict, Negotiation
from telepresence.link.supervision.pacing import MessagePacing
from telepresence.link.supervision.record import SupervisionRecord

__all__ = [
    "ApplicationReset",
    "Configuration",
    "ContextsHeld",
    "LinkState",
    "PeerDeaf",
    "PeerHears",
    "PeerMet",
    "SignalAcquired",
    "SignalLost",
    "StateChanged",
    "SupervisionEvent",
    "SupervisionTiming",
    "Supervisor",
]

_NO_CONTEXTS = (0, 0, 0, 0)
#: For a gateway that does not fetch events; beyond that the oldest are dropped.
_EVENTS_DEPTH = 256
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


class Supervisor:
    """One end's supervision; see the module for the run loop.

    master: whether this end configures the other; exactly one does.
    life: 1 to 65535, a new one at each start of this end; the shell draws it at random.

    state, why: the state of the link, and its reason.
    signal: good frames arrive.
    peer_hears: the peer is heard and says that it hears this end.
    delivering: received data may be delivered to the applications, because this life of the peer
    was checked. It stays true during a loss of signal.
    next_ns: the same as `poll_timeout()`.
    """

    # These attributes are read thousands of times a second; slots are the fastest to read.
    __slots__ = (
        "_application",
        "_contexts",
        "_counts",
        "_events",
        "_fault",
        "_frame_ns",
        "_negotiation",
        "_pacing",
        "_record",
        "_silence_ns",
        "configuration",
        "delivering",
        "life",
        "master",
        "next_ns",
        "peer_hears",
        "signal",
        "state",
        "timing",
        "why",
    )

    def __init__(
        self,
        *,
        master: bool,
        configuration: Configuration,
        life: int,
        now_ns: int,
        timing: SupervisionTiming | None = None,
    ) -> None:
        if not 1 <= life <= 0xFFFF:
            raise ValueError(f"life is {life}: it must be from 1 to 65535")
        self.master = master
        self.configuration = configuration
        self.timing = timing or SupervisionTiming()
        self.life = life
        self.state = LinkState.CHECK
        self.why = "the local check has not been made"
        self.signal = False
        self.peer_hears = False
        self.delivering = False
        # poll_transmit runs once a slot, so it notices a loss up to a slot late.
        self._silence_ns = max(
            self.timing.loss_ns - configuration.transmit.slot_ns,
            _LEAST_SLOTS * configuration.receive.slot_ns,
        )
        self._fault: str | None = self.why
        self._contexts: tuple[int, int, int, int] = _NO_CONTEXTS
        self._frame_ns = now_ns
        self.next_ns = now_ns
        self._negotiation = Negotiation(
            master=master,
            configuration=configuration,
            life=life,
            timing=self.timing,
            now_ns=now_ns,
        )
        self._application = ApplicationWatch(self.timing, now_ns)
        self._pacing = MessagePacing(self.timing, now_ns)
        self._events: deque[SupervisionEvent] = deque(maxlen=_EVENTS_DEPTH)
        self._record = SupervisionRecord(self.state, self.why, now_ns)
        self._counts = self._record.counts

    @property
    def peer_life(self) -> int:
        """The life of the peer that was checked; 0 before the first."""
        return self._negotiation.peer_life

    def handle_frame(self, now_ns: int) -> None:
        """A good frame of the peer arrived, whatever it carries."""
        self._frame_ns = now_ns
        if not self.signal:
            self._acquire(now_ns)

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

    def handle_contexts(self, ids: Sequence[int], now_ns: int) -> None:
        """Set what the local receiver holds: an id (1 to 255, 0 none) for up to four flows.

        After `PeerMet` and `handle_restart`, let the receiver forget first: ids of a former life
        must not be reported.
        """
        first, second, third, fourth = (*ids, *_NO_CONTEXTS)[:4]
        contexts = (first, second, third, fourth)
        if contexts != self._contexts:
            self._contexts = contexts
            self._update(now_ns)

    def handle_local_check(self, fault: str | None, now_ns: int) -> None:
        """None: this end works. A line: what does not; then nothing is delivered."""
        if fault != self._fault:
            self._fault = fault
            self._update(now_ns)

    def handle_restart(self, now_ns: int) -> None:
        """The frame count shows that the peer restarted.

        Nothing of it is delivered before its first message. This covers the time between its first
        frame and that message.
        """
        self._negotiation.checked = False
        self._negotiation.forget_peer()
        self._contexts = _NO_CONTEXTS
        self._note_hearing(now_ns)
        self._update(now_ns)

    def handle_message(self, message: bytes, now_ns: int) -> None:
        """Take twelve octets from a good frame. Invalid ones are counted; this never raises."""
        negotiation, counts = self._negotiation, self._counts
        self.handle_frame(now_ns)
        before, before_life = negotiation.peer, negotiation.peer_life
        verdict = negotiation.handle_message(message, now_ns)
        if verdict is MessageVerdict.MALFORMED:
            counts["messages_malformed"] += 1
            return
        counts["messages_received"] += 1
        if verdict is MessageVerdict.SUSPECT or verdict is MessageVerdict.REFUSED:
            counts["messages_mismatched"] += 1
        if verdict is MessageVerdict.SUSPECT:
            return
        if verdict is MessageVerdict.MET:
            counts["peer_restarts"] += before_life != 0
            before = None
            # Contexts from the peer's former life must not be reported as held.
            self._contexts = _NO_CONTEXTS
            self._events.append(PeerMet(now_ns, negotiation.peer_life, before_life != 0))
        if verdict is not MessageVerdict.FITS:
            self._application.handle_contact(now_ns)
        self._note_hearing(now_ns)
        peer = negotiation.peer
        if peer is not None:
            self._handle_peer_report(peer, before, now_ns)
        self._update(now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the message for this slot, or None. Call once each slot."""
        if now_ns < self.next_ns:
            return None
        return self._run_slot(now_ns)

    def poll_timeout(self) -> int:
        """When `poll_transmit` has something to do."""
        return self.next_ns

    def next_event(self) -> SupervisionEvent | None:
        """The oldest event that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def report(self, now_ns: int) -> SupervisionFigures:
        """Return state, peer, counts, contact windows and the last transitions with reasons."""
        peer = self._negotiation.peer
        record = self._record
        return SupervisionFigures(
            role="master" if self.master else "slave",
            life=self.life,
            state=self.state.name.lower(),
            why=self.why,
            signal=self.signal,
            peer_hears=self.peer_hears,
            delivering=self.delivering,
            peer=PeerFigures(
                life=self.peer_life, state=None if peer is None else peer.state.name.lower()
            ),
            begun_ns=record.begun_ns,
            since_ns=record.since_ns,
            in_state_ns=record.in_state_ns(now_ns),
            counts=dict(record.counts),
            contact_ns=record.contact_ns(now_ns),
            longest_gap_ns=record.longest_gap_ns,
            contacts=record.contacts(),
            history=record.history(),
        )

    def _acquire(self, now_ns: int) -> None:
        self.signal = True
        self._negotiation.handle_contact(now_ns)
        self._application.handle_contact(now_ns)
        self._events.append(SignalAcquired(now_ns, self._record.handle_signal_acquired(now_ns)))
        self._update(now_ns)

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

    def _handle_peer_report(
        self, peer: SupervisionMessage, before: SupervisionMessage | None, now_ns: int
    ) -> None:
        """Process the contexts that the peer holds, and the state of its applications."""
        if self.peer_hears and peer.kind in (MessageKind.ALIVE, MessageKind.CONFIRM):
            self._events.append(ContextsHeld(now_ns, peer.contexts))
        was_reset = before is not None and before.application and not peer.application
        self._application.handle_peer(was_reset=was_reset, sends=peer.sending, now_ns=now_ns)

    def _run_slot(self, now_ns: int) -> bytes | None:
        """Check the timeouts, then return the message if it is due."""
        cause = None
        if self.signal and now_ns >= self._frame_ns + self._silence_ns:
            self._lose(now_ns)
        elif now_ns >= self._pacing.due_ns:
            cause = self._supervise(now_ns)
        self._update(now_ns, cause)
        if now_ns < self._pacing.due_ns:
            return None
        self._pacing.handle_sent(self._content(), self._contexts, now_ns)
        self._counts["messages_sent"] += 1
        self._schedule(now_ns)
        return pack_message(self._message(now_ns))

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
        if not self.signal:
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
        """Derive the state, the delivery and the next message from what is known.

        cause: what happened, if that says more than the state's own reason.
        """
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
        pacing.handle_content(
            self._content(), self._contexts, now_ns, heard=self.peer_hears, settled=settled
        )
        self.next_ns = pacing.due_ns
        if self.signal:
            self.next_ns = min(self.next_ns, self._frame_ns + self._silence_ns)

    def _content(self) -> tuple[int, ...]:
        """Return the parts of a message whose change the peer must learn at once."""
        peer = self._negotiation.peer
        kind = self._negotiation.kind(self.state)
        heard = 0 if peer is None else peer.life
        return (kind, self.state, self.signal, self._application.arrived, heard)

    def _message(self, now_ns: int) -> SupervisionMessage:
        negotiation, application = self._negotiation, self._application
        peer = negotiation.peer
        return SupervisionMessage(
            version=negotiation.version,
            kind=negotiation.kind(self.state),
            state=self.state,
            master=self.master,
            signal=self.signal,
            application=application.arrived,
            fresh=application.fresh(now_ns),
            sending=application.sending(now_ns),
            life=self.life,
            heard=0 if peer is None else peer.life,
            digest=negotiation.digest,
            contexts=self._contexts,
            rates_kbps=negotiation.rates_kbps,
        )
