"""Negotiation, loss of signal and supervision of the link, at one of its two ends.

After Stelzer et al., "Software Architecture and Design of the Kontur-2 Mission" (2017): each end
checks itself, alive messages show the other side, the master configures and checks the slave, the
first application data both ways approves the connection, and supervision resets what went idle
or broke. docs/link-contact.md has the states, the timing and what happens on each event.

Strategy: each end tells again and again what it *is*, never what the other shall have got. The
state is a function of what this end knows, so a lost message costs time and nothing else, and
no order of losses and restarts can leave the two waiting for each other.

A gateway needs six lines:

1. `handle_local_check(None, now_ns)` once it is ready, with a fault when it is not (any more).
2. `handle_frame(now_ns)` for each good frame, before anything else is made of it.
3. `handle_message(message, now_ns)` for each supervision message that the receiver found in it.
4. `handle_application(now_ns)` for each sample and packet that came out, and
   `handle_application_sent(now_ns)` for each that goes in.
5. Each slot: `poll_transmit(now_ns)`; 12 octets make it a supervision slot.
6. After each of these: `next_event()` until None. The receiver delivers while `delivering`.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

from telepresence.link.supervision_application import ApplicationWatch
from telepresence.link.supervision_configuration import Configuration, SupervisionTiming
from telepresence.link.supervision_events import (
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
from telepresence.link.supervision_message import (
    LinkState,
    MessageKind,
    SupervisionMessage,
    message_version,
    pack_message,
    parse_message,
)
from telepresence.link.supervision_pacing import MessagePacing
from telepresence.link.supervision_record import SupervisionRecord

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
#: For a gateway that does not fetch them; then the oldest go.
_EVENTS_DEPTH = 256
#: Each answer that does not come makes the next wait twice as long, up to so many times.
_LARGEST_PATIENCE = 32
#: However slow the slots are: so many of them without a frame are no loss of signal yet.
_LEAST_SLOTS = 3
_TELLS_RATES = (MessageKind.CONFIGURE, MessageKind.REJECT)


class Supervisor:
    """One end's supervision; see the module for the run loop.

    master: whether this end configures the other; exactly one does.
    life: 1..65535, another one each time this end starts (the shell draws it at random).

    state, why: where the link stands. signal: good frames arrive. peer_hears: the peer is heard
    and says that it hears this end. delivering: what arrives may be given to the applications,
    because the peer of this life has been checked; it stays so over a loss of signal.
    peer_life: the life of the peer that was checked, 0 before there was one.
    """

    # More attributes than Python shares the keys of, read a thousand times a second.
    __slots__ = (
        "_agreed",
        "_answer_patience",
        "_application",
        "_contexts",
        "_counts",
        "_digest",
        "_events",
        "_fault",
        "_frame_ns",
        "_message_ns",
        "_next_ns",
        "_pacing",
        "_peer",
        "_rates",
        "_record",
        "_refusal",
        "_refused",
        "_silence_ns",
        "_suspect",
        "_unanswered_ns",
        "_unchecked",
        "_version",
        "configuration",
        "delivering",
        "life",
        "master",
        "peer_hears",
        "peer_life",
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
        self.peer_life = 0
        self._version = configuration.version
        self._digest = configuration.digest(master=master)
        self._rates = configuration.rates_kbps()
        # Whoever looks once a slot sees a loss up to a slot after it could.
        self._silence_ns = max(
            self.timing.loss_ns - configuration.transmit.slot_ns,
            _LEAST_SLOTS * configuration.receive.slot_ns,
        )
        self._fault: str | None = self.why
        self._refusal: str | None = None
        self._refused: tuple[int, ...] = ()
        #: What a message that did not fit looked like: only its repetition is believed.
        self._suspect: tuple[int, ...] = ()
        self._unchecked = True
        #: The newest message that fits, of this contact.
        self._peer: SupervisionMessage | None = None
        #: Master and slave of these two lives have agreed.
        self._agreed = False
        self._contexts: tuple[int, int, int, int] = _NO_CONTEXTS
        self._frame_ns = now_ns
        self._message_ns = now_ns
        self._unanswered_ns: int | None = None
        self._answer_patience = 1
        self._application = ApplicationWatch(self.timing, now_ns)
        self._pacing = MessagePacing(self.timing, now_ns)
        self._next_ns = now_ns
        self._events: deque[SupervisionEvent] = deque(maxlen=_EVENTS_DEPTH)
        self._record = SupervisionRecord(self.state, self.why, now_ns)
        self._counts = self._record.counts

    def handle_frame(self, now_ns: int) -> None:
        """A good frame of the peer, whatever it carries."""
        self._frame_ns = now_ns
        if not self.signal:
            self._acquire(now_ns)

    def handle_application(self, now_ns: int) -> None:
        """A sample or a packet of the peer's applications came out."""
        application = self._application
        application.arrived_ns = now_ns
        if not application.arrived:
            application.handle_first()
            self._update(now_ns)

    def handle_application_sent(self, now_ns: int) -> None:
        """A sample or a packet of the local applications goes out."""
        self._application.sent_ns = now_ns

    def handle_contexts(self, ids: Sequence[int], now_ns: int) -> None:
        """What the local receiver holds: an id (1..255, 0 none) for each of up to four flows.

        After `PeerMet`, have the receiver forget first: ids of a former life must not get here.
        """
        first, second, third, fourth = (*ids, *_NO_CONTEXTS)[:4]
        contexts = (first, second, third, fourth)
        if contexts != self._contexts:
            self._contexts = contexts
            self._update(now_ns)

    def handle_local_check(self, fault: str | None, now_ns: int) -> None:
        """All is well here (None), or a line that says what is not: then nothing is delivered."""
        if fault != self._fault:
            self._fault = fault
            self._update(now_ns)

    def handle_restart(self, now_ns: int) -> None:
        """The frame count says that the peer has begun anew: nothing of it is delivered before
        its first message. Closes the gap between its first frame and that."""
        self._unchecked = True
        self._forget_peer(now_ns)
        self._update(now_ns)

    def handle_message(self, message: bytes, now_ns: int) -> None:
        """Twelve octets out of a good frame. What is no message is counted; this never raises."""
        version = message_version(message)
        parsed = parse_message(message) if version == self._version else None
        if not version or (parsed is None and version == self._version):
            self._counts["messages_malformed"] += 1
            return
        self._counts["messages_received"] += 1
        self.handle_frame(now_ns)
        if parsed is None:
            why = f"the peer speaks version {version} of the link, this end {self._version}"
            # Nothing but the version is known of its layout: the repetition must be exact.
            self._mismatch(tuple(message), f"{why}: install the same on both", now_ns)
            return
        signature = (parsed.master, parsed.life, parsed.digest)
        if parsed.master is self.master:
            role = "master" if self.master else "slave"
            self._mismatch(signature, f"both ends are {role}: start one as the other", now_ns)
        elif parsed.digest != self._digest:
            exact = parsed.kind in _TELLS_RATES
            self._mismatch(signature, self._difference(parsed), now_ns, exact=exact)
        else:
            self._accept(parsed, now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The message that this slot shall carry, or None. Ask once each slot."""
        if now_ns < self._next_ns:
            return None
        return self._work(now_ns)

    def poll_timeout(self) -> int:
        """When `poll_transmit` has something to do."""
        return self._next_ns

    def next_event(self) -> SupervisionEvent | None:
        """What happened, oldest first. Call until None."""
        return self._events.popleft() if self._events else None

    def report(self, now_ns: int) -> dict[str, Any]:
        """State, peer, counts, contact windows and the last transitions with their reasons."""
        peer = self._peer
        return {
            "role": "master" if self.master else "slave",
            "life": self.life,
            "state": self.state.name.lower(),
            "why": self.why,
            "signal": self.signal,
            "peer_hears": self.peer_hears,
            "delivering": self.delivering,
            "peer": {
                "life": self.peer_life,
                "state": None if peer is None else peer.state.name.lower(),
            },
            **self._record.report(now_ns),
        }

    def _acquire(self, now_ns: int) -> None:
        self.signal = True
        self._message_ns = now_ns
        self._application.handle_contact(now_ns)
        self._events.append(SignalAcquired(now_ns, self._record.handle_signal_acquired(now_ns)))
        self._update(now_ns)

    def _lose(self, now_ns: int) -> None:
        self.signal = self.peer_hears = False
        self._peer = self._refusal = self._unanswered_ns = None
        self._suspect = ()
        self._application.handle_contact(now_ns)
        self._record.handle_signal_lost(self._frame_ns)
        self._events.append(SignalLost(now_ns, self._frame_ns))

    def _forget_peer(self, now_ns: int) -> None:
        self._peer = self._unanswered_ns = None
        self._set_peer_hears(False, now_ns)

    def _difference(self, peer: SupervisionMessage) -> str:
        """What does not fit, as far as the message tells."""
        mend = "give both ends the same setup"
        if peer.kind not in _TELLS_RATES:
            return f"the configuration differs: {mend}"
        here = self.configuration
        pairs = zip((here.transmit, here.receive), self._rates, peer.rates_kbps[::-1], strict=True)
        wrong = [
            f"{profile.name} has {mine} kbit/s here and {theirs} there"
            for profile, mine, theirs in pairs
            if mine != theirs
        ]
        return f"{', '.join(wrong) or 'frames or flows differ (rates agree)'}: {mend}"

    def _mismatch(
        self, signature: tuple[int, ...], why: str, now_ns: int, *, exact: bool = False
    ) -> None:
        """A message that does not fit. One alone may be an error that the FECF let through."""
        self._counts["messages_mismatched"] += 1
        if signature != self._suspect:
            self._suspect = signature
            return
        self._forget_peer(now_ns)
        self.peer_life = 0
        self._unchecked = True
        self._agreed = False
        self._application.handle_contact(now_ns)
        if exact or self._refusal is None or signature != self._refused:
            self._refusal, self._refused = why, signature
        self._update(now_ns)

    def _accept(self, message: SupervisionMessage, now_ns: int) -> None:
        """A message of a peer that fits."""
        self._suspect, self._refusal = (), None
        self._unchecked = False
        if message.life != self.peer_life:
            self._meet(message.life, now_ns)
        before, self._peer = self._peer, message
        self._message_ns = now_ns
        hears = message.signal and message.heard == self.life
        self._set_peer_hears(hears, now_ns)
        if hears:
            told = MessageKind.CONFIRM if self.master else MessageKind.CONFIGURE
            if message.kind is told:
                self._agreed = True
            if message.kind not in _TELLS_RATES:
                self._events.append(ContextsHeld(now_ns, message.contexts))
        was_reset = before is not None and before.application and not message.application
        self._application.handle_peer(was_reset=was_reset, sends=message.sending, now_ns=now_ns)
        # The slave hears its master, and nothing keeps it from doing as it is told.
        stuck = self.master and hears and message.state in (LinkState.SEARCH, LinkState.CONFIGURE)
        if not stuck:
            self._unanswered_ns, self._answer_patience = None, 1
        elif self._unanswered_ns is None:
            self._unanswered_ns = now_ns
        self._update(now_ns)

    def _meet(self, life: int, now_ns: int) -> None:
        restarted = self.peer_life != 0
        self._counts["peer_restarts"] += restarted
        self.peer_life = life
        self._peer = None
        self._agreed = False
        self._application.handle_contact(now_ns)
        # Contexts that its former life gave must not be said to be held.
        self._contexts = _NO_CONTEXTS
        self._events.append(PeerMet(now_ns, life, restarted))

    def _set_peer_hears(self, hears: bool, now_ns: int) -> None:
        if hears != self.peer_hears:
            self.peer_hears = hears
            self._counts["peer_deaf"] += not hears
            self._events.append(PeerHears(now_ns) if hears else PeerDeaf(now_ns))

    def _work(self, now_ns: int) -> bytes | None:
        """Time-outs, then the message if it is due."""
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
        """What took too long. Looked at whenever a message is due: that is often enough."""
        timing, peer = self.timing, self._peer
        if peer is None:
            return None
        if now_ns - self._message_ns > timing.silence_ns + timing.round_trip_ns:
            self._counts["timeouts_silence"] += 1
            self._forget_peer(now_ns)
            return "time-out: frames, but no message of the peer"
        if self._unanswered_ns is not None:
            if now_ns - self._unanswered_ns <= timing.answer_ns * self._answer_patience:
                return None
            self._counts["timeouts_answer"] += 1
            self._answer_patience = min(2 * self._answer_patience, _LARGEST_PATIENCE)
            self._unanswered_ns = now_ns
            self._agreed = False
            return "time-out: the slave does not confirm, it is configured anew"
        if self.state not in (LinkState.APPROVE, LinkState.CONNECTED):
            return None
        approved = self.state is LinkState.CONNECTED
        reset = self._application.reset_due(peer_fresh=peer.fresh, approved=approved, now_ns=now_ns)
        if reset is None:
            return None
        self._counts[f"resets_{reset}"] += 1
        self._events.append(ApplicationReset(now_ns, reset))
        if reset == "idle":
            return "reset: no application data either way"
        return "reset: the peer sends application data, none comes out here"

    def _find_state(self) -> tuple[LinkState, str]:
        """The state that follows from what is known, and why it is no better one."""
        peer = self._peer
        if self._fault is not None:
            return LinkState.CHECK, self._fault
        if not self.signal:
            return LinkState.SEARCH, "no signal"
        if self._refusal is not None:
            return LinkState.REFUSED, self._refusal
        if peer is None:
            return LinkState.SEARCH, "signal, and no message of the peer yet"
        if not self.peer_hears:
            return LinkState.CONFIGURE, "the peer does not hear this end"
        if peer.state is LinkState.CHECK:
            return LinkState.CONFIGURE, "the peer's local check has not passed"
        if not self._agreed:
            awaited = "the slave to confirm" if self.master else "the master to configure"
            return LinkState.CONFIGURE, f"waits for {awaited}"
        if self._application.arrived and peer.application:
            return LinkState.CONNECTED, "application data both ways"
        if self._application.arrived or peer.application:
            where = "here" if peer.application else "at the peer"
        else:
            where = "either way"
        return LinkState.APPROVE, f"agreed; no application data {where} yet"

    def _update(self, now_ns: int, cause: str | None = None) -> None:
        """State, delivery and the instant of the next message follow from what is known.

        cause: what happened, where that says more than the state's own reason.
        """
        state, why = self._find_state()
        before = self.state
        refined = state is LinkState.REFUSED and why != self.why
        self.state, self.why = state, why
        self.delivering = self._fault is None and not self._unchecked
        if state is not before or cause is not None or refined:
            self._record.handle_state(state, cause or why, now_ns)
            self._events.append(StateChanged(now_ns, before, state, cause or why))
        self._schedule(now_ns)

    def _schedule(self, now_ns: int) -> None:
        peer, pacing = self._peer, self._pacing
        settled = (
            self.state is LinkState.CONNECTED
            and peer is not None
            and peer.state is LinkState.CONNECTED
        )
        pacing.handle_content(
            self._content(), self._contexts, now_ns, heard=self.peer_hears, settled=settled
        )
        self._next_ns = pacing.due_ns
        if self.signal:
            self._next_ns = min(self._next_ns, self._frame_ns + self._silence_ns)

    def _kind(self) -> MessageKind:
        peer = self._peer
        if self.state is LinkState.REFUSED:
            return MessageKind.REJECT
        if peer is None or self.state is LinkState.CHECK:
            return MessageKind.ALIVE
        if self.master:
            return MessageKind.ALIVE if self._agreed else MessageKind.CONFIGURE
        asked = peer.kind is MessageKind.CONFIGURE
        return MessageKind.CONFIRM if asked and self._agreed else MessageKind.ALIVE

    def _content(self) -> tuple[int, ...]:
        """All of a message whose change the peer must learn at once."""
        heard = 0 if self._peer is None else self._peer.life
        return (self._kind(), self.state, self.signal, self._application.arrived, heard)

    def _message(self, now_ns: int) -> SupervisionMessage:
        return SupervisionMessage(
            version=self._version,
            kind=self._kind(),
            state=self.state,
            master=self.master,
            signal=self.signal,
            application=self._application.arrived,
            fresh=self._application.fresh(now_ns),
            sending=self._application.sending(now_ns),
            life=self.life,
            heard=0 if self._peer is None else self._peer.life,
            digest=self._digest,
            contexts=self._contexts,
            rates_kbps=self._rates,
        )
