"""What the peer's messages show: whether it matches, hears this end, and has agreed."""

from enum import Enum, auto

from telepresence.link.supervision.configuration import Configuration, SupervisionTiming
from telepresence.link.supervision.message import (
    LinkState,
    MessageKind,
    SupervisionMessage,
    message_version,
    parse_message,
)

#: Each missing answer doubles the next wait, up to this factor.
_LARGEST_PATIENCE = 32
_TELLS_RATES = (MessageKind.CONFIGURE, MessageKind.REJECT)


class MessageVerdict(Enum):
    """Result of checking a message.

    MALFORMED: it is no message. SUSPECT: it does not match, for the first time. REFUSED: the same
    mismatch again. MET: it matches and begins a new life of the peer. FITS: it matches.
    """

    MALFORMED = auto()
    SUSPECT = auto()
    REFUSED = auto()
    MET = auto()
    FITS = auto()


class Negotiation:
    """One end's view of the other.

    peer: the newest matching message of this contact, or None.
    message_ns: when it came, or when the contact began.
    peer_life: the life that was checked; 0 before the first.
    checked: nothing indicates that another life sends.
    hears: the peer is heard and says that it hears this end.
    agreed: master and slave have agreed in these two lives.
    refusal: why the peer does not match, or None.
    """

    def __init__(
        self,
        *,
        master: bool,
        configuration: Configuration,
        life: int,
        timing: SupervisionTiming,
        now_ns: int,
    ) -> None:
        self.version = configuration.version
        self.digest = configuration.digest(master=master)
        self.rates_kbps = configuration.rates_kbps()
        self.peer: SupervisionMessage | None = None
        self.peer_life = 0
        self.checked = False
        self.hears = False
        self.agreed = False
        self.refusal: str | None = None
        self.message_ns = now_ns
        self._master = master
        self._life = life
        self._configuration = configuration
        self._timing = timing
        #: Signature of a mismatching message; only its repetition counts.
        self._suspect: tuple[int, ...] = ()
        self._refused: tuple[int, ...] = ()
        self._unanswered_ns: int | None = None
        self._patience = 1

    def handle_message(self, data: bytes, now_ns: int) -> MessageVerdict:
        """Check twelve octets from a good frame."""
        version = message_version(data)
        if not version:
            return MessageVerdict.MALFORMED
        if version != self.version:
            why = f"the peer speaks version {version} of the link, this end {self.version}"
            # The layout of other versions is unknown, so the repetition must be identical.
            return self._mismatch(tuple(data), f"{why}: install the same on both")
        message = parse_message(data)
        if message is None:
            return MessageVerdict.MALFORMED
        signature = (message.master, message.life, message.digest)
        if message.master is self._master:
            role = "master" if self._master else "slave"
            return self._mismatch(signature, f"both ends are {role}: start one as the other")
        if message.digest != self.digest:
            exact = message.kind in _TELLS_RATES
            return self._mismatch(signature, self._difference(message), exact=exact)
        return self._accept(message, now_ns)

    def handle_contact(self, now_ns: int) -> None:
        """The signal came or went: nothing has been heard in this contact yet."""
        self.message_ns = now_ns
        self.refusal = None
        self._suspect = ()
        self.forget_peer()

    def forget_peer(self) -> None:
        """Discard the peer's last message, but not the fact that its life was checked."""
        self.peer = self._unanswered_ns = None
        self.hears = False

    def timeout(self, now_ns: int) -> str | None:
        """Return the timeout that has passed, or None; its waiting starts again.

        `silence`: frames, but no message for long. `answer`: the slave does not confirm.
        """
        timing = self._timing
        if self.peer is None:
            return None
        if now_ns - self.message_ns > timing.silence_ns + timing.round_trip_ns:
            self.forget_peer()
            return "silence"
        if self._unanswered_ns is None:
            return None
        if now_ns - self._unanswered_ns <= timing.answer_ns * self._patience:
            return None
        self._patience = min(2 * self._patience, _LARGEST_PATIENCE)
        self._unanswered_ns = now_ns
        self.agreed = False
        return "answer"

    def obstacle(self) -> tuple[LinkState, str] | None:
        """Return the state while the two have not agreed, and why; None once they have."""
        if self.refusal is not None:
            return LinkState.REFUSED, self.refusal
        if self.peer is None:
            return LinkState.SEARCH, "signal, and no message of the peer yet"
        if not self.hears:
            return LinkState.CONFIGURE, "the peer does not hear this end"
        if self.peer.state is LinkState.CHECK:
            return LinkState.CONFIGURE, "the peer's local check has not passed"
        if not self.agreed:
            awaited = "the slave to confirm" if self._master else "the master to configure"
            return LinkState.CONFIGURE, f"waits for {awaited}"
        return None

    def kind(self, state: LinkState) -> MessageKind:
        """Return the kind of message that an end in `state` sends."""
        if state is LinkState.REFUSED:
            return MessageKind.REJECT
        if self.peer is None or state is LinkState.CHECK:
            return MessageKind.ALIVE
        if self._master:
            return MessageKind.ALIVE if self.agreed else MessageKind.CONFIGURE
        asked = self.peer.kind is MessageKind.CONFIGURE
        return MessageKind.CONFIRM if asked and self.agreed else MessageKind.ALIVE

    def _difference(self, message: SupervisionMessage) -> str:
        """Describe what does not match, as far as the message shows it."""
        mend = "give both ends the same setup"
        if message.kind not in _TELLS_RATES:
            return f"the configuration differs: {mend}"
        here = self._configuration
        theirs = message.rates_kbps[::-1]
        wrong = [
            f"{profile.name} has {mine} kbit/s here and {other} there"
            for profile, mine, other in zip(
                (here.transmit, here.receive), self.rates_kbps, theirs, strict=True
            )
            if mine != other
        ]
        return f"{', '.join(wrong) or 'frames or flows differ (rates agree)'}: {mend}"

    def _mismatch(
        self, signature: tuple[int, ...], why: str, *, exact: bool = False
    ) -> MessageVerdict:
        """Handle a mismatch. A single one may be an error that the FECF did not detect.

        exact: `why` is as precise as possible and replaces an earlier reason.
        """
        if signature != self._suspect:
            self._suspect = signature
            return MessageVerdict.SUSPECT
        self.forget_peer()
        self.peer_life = 0
        self.checked = self.agreed = False
        if exact or self.refusal is None or signature != self._refused:
            self.refusal, self._refused = why, signature
        return MessageVerdict.REFUSED

    def _accept(self, message: SupervisionMessage, now_ns: int) -> MessageVerdict:
        """Handle a message of a matching peer."""
        verdict = MessageVerdict.FITS
        self._suspect, self.refusal = (), None
        if message.life != self.peer_life:
            verdict = MessageVerdict.MET
            self.peer_life = message.life
            self.agreed = False
        self.checked = True
        self.peer = message
        self.message_ns = now_ns
        self.hears = hears = message.signal and message.heard == self._life
        told = MessageKind.CONFIRM if self._master else MessageKind.CONFIGURE
        if hears and message.kind is told:
            self.agreed = True
        # The peer hears its master, and nothing prevents it from confirming.
        waiting = message.state in (LinkState.SEARCH, LinkState.CONFIGURE)
        if not (self._master and hears and waiting):
            self._unanswered_ns, self._patience = None, 1
        elif self._unanswered_ns is None:
            self._unanswered_ns = now_ns
        return verdict
