"""What the peer's messages show: whether it matches, hears this end now, and has agreed."""

from enum import Enum, auto
from typing import NamedTuple

from telepresence.link.supervision.message import (
    KINDS_WITH_RATES,
    Configuration,
    LinkState,
    MessageKind,
    SupervisionMessage,
    SupervisionTiming,
    message_version,
    parse_message,
)

#: After so many messages in a row of a peer without repair, this end does without it, too. They
#: outlast those of a peer with repair that has not met this end yet.
_PLAIN_MESSAGES = 50
#: Each missing answer doubles the next wait, up to this factor.
_LARGEST_TIMEOUT_FACTOR = 32


class MessageVerdict(Enum):
    """Result of checking a message.

    MALFORMED: it is no message. SUSPECT: it does not match, for the first time. REFUSED: the same
    mismatch again. DOUBTED: it matches, but another life sends it, for the second time. MET: it
    matches, and is the first one. FITS: it matches.
    """

    MALFORMED = auto()
    SUSPECT = auto()
    REFUSED = auto()
    DOUBTED = auto()
    MET = auto()
    FITS = auto()


class _Mismatch(NamedTuple):
    """Why a message does not match. exact: `why` is as precise as possible."""

    signature: tuple[int, ...]
    why: str
    exact: bool = False


class Negotiation:
    """One end's view of the other.

    peer: the newest matching message of this contact, or None.
    message_ns: when it came, or when the contact began.
    peer_boot_id: the life that was checked; 0 before the first.
    checked: nothing indicates that another life sends.
    hears: the peer is heard and says that it hears this end.
    agreed: master and slave have agreed in these two starts.
    refusal: why the peer does not match, or None.
    repair: both ends restore lost frames, as far as this end knows.
    """

    def __init__(
        self,
        *,
        master: bool,
        configuration: Configuration,
        boot_id: int,
        timing: SupervisionTiming,
        now_ns: int,
    ) -> None:
        self.version = configuration.version
        #: By whether both ends have repair.
        self._digests = {
            repair: configuration.digest(master=master, repair=repair) for repair in (False, True)
        }
        self.repair = configuration.repair != "off"
        self._plain_messages = 0
        self.rates_kbps = configuration.rates_kbps()
        self.peer: SupervisionMessage | None = None
        self.peer_boot_id = 0
        self.checked = False
        self.hears = False
        self.agreed = False
        self.refusal: str | None = None
        self.message_ns = now_ns
        self._master = master
        self._boot_id = boot_id
        self._configuration = configuration
        self._timing = timing
        #: Signature of a mismatching message; only its repetition counts.
        self._suspect: tuple[int, ...] = ()
        self._refused: tuple[int, ...] = ()
        self._unanswered_ns: int | None = None
        self._timeout = 1
        #: The peer's last message but HELLO was a CONFIGURE.
        self._asked = False

    @property
    def digest(self) -> int:
        """The digest of what both ends have, as far as this end knows."""
        return self._digests[self.repair]

    def handle_message(self, data: bytes, now_ns: int) -> MessageVerdict:
        """Check twelve octets from a good frame of the peer's stream."""
        message = self._matching(data)
        if isinstance(message, MessageVerdict):
            return message
        if isinstance(message, _Mismatch):
            if not self._repeated(message.signature):
                return MessageVerdict.SUSPECT
            self.forget_peer()
            self.peer_boot_id = 0
            self.checked = self.agreed = False
            self._refuse(message)
            return MessageVerdict.REFUSED
        if message.boot_id != self.peer_boot_id and self.peer_boot_id:
            signature = (message.master, message.boot_id, message.digest)
            return MessageVerdict.DOUBTED if self._repeated(signature) else MessageVerdict.SUSPECT
        return self._accept(message, now_ns)

    def handle_unknown_sender(
        self, data: bytes, *, alone: bool
    ) -> SupervisionMessage | MessageVerdict:
        """Check twelve octets from a good frame of another stream; return them if they match.

        alone: the peer's own stream is silent, so a repeated mismatch is a reason to refuse.
        """
        message = self._matching(data)
        if not isinstance(message, _Mismatch):
            if alone and isinstance(message, SupervisionMessage):
                self._suspect, self.refusal = (), None
            return message
        if not alone or not self._repeated(message.signature):
            return MessageVerdict.SUSPECT
        self._refuse(message)
        return MessageVerdict.REFUSED

    def meet(self, boot_id: int) -> bool:
        """The peer with this start is found; return whether that is another one than before."""
        self.checked = True
        self._suspect, self.refusal = (), None
        if boot_id == self.peer_boot_id:
            return False
        self.peer_boot_id = boot_id
        self.agreed = False
        self.forget_peer()
        return True

    def handle_contact(self, now_ns: int) -> None:
        """The signal came or went: nothing has been heard in this contact yet."""
        self.message_ns = now_ns
        self.refusal = None
        self._suspect = ()
        self.forget_peer()

    def forget_peer(self) -> None:
        """Discard the peer's last message, but not the fact that its life was checked."""
        self.peer = self._unanswered_ns = None
        self.hears = self._asked = False

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
        if now_ns - self._unanswered_ns <= timing.answer_ns * self._timeout:
            return None
        self._timeout = min(2 * self._timeout, _LARGEST_TIMEOUT_FACTOR)
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
        return MessageKind.CONFIRM if self._asked and self.agreed else MessageKind.ALIVE

    def handle_answer(self) -> None:
        """The peer has echoed a fresh number of this end, so it hears this end."""
        if self.peer is not None and self.peer.signal:
            self.hears = True

    def _difference(self, message: SupervisionMessage) -> str:
        """Describe what does not match, as far as the message shows it."""
        fix = "give both ends the same setup"
        if message.digest in self._digests.values():
            return 'repair is on at one end only: give both the same, or "auto"'
        if message.kind not in KINDS_WITH_RATES:
            return f"the configuration differs: {fix}"
        here = self._configuration
        theirs = message.rates_kbps[::-1]
        wrong = [
            f"{profile.name} has {mine} kbit/s here and {other} there"
            for profile, mine, other in zip(
                (here.transmit, here.receive), self.rates_kbps, theirs, strict=True
            )
            if mine != other
        ]
        return f"{', '.join(wrong) or 'frames or flows differ (rates agree)'}: {fix}"

    def _matching(self, data: bytes) -> SupervisionMessage | MessageVerdict | _Mismatch:
        """Parse `data`; return the message if it matches, else why not."""
        version = message_version(data)
        if not version:
            return MessageVerdict.MALFORMED
        if version != self.version:
            why = f"the peer speaks version {version} of the link, this end {self.version}"
            # The layout of other versions is unknown, so the repetition must be identical.
            return _Mismatch(tuple(data), f"{why}: install the same on both")
        message = parse_message(data)
        if message is None:
            return MessageVerdict.MALFORMED
        signature = (message.master, message.boot_id, message.digest)
        if message.master is self._master:
            role = "master" if self._master else "slave"
            return _Mismatch(signature, f"both ends are {role}: start one as the other")
        if message.digest != self.digest and not self._follow_repair(message.digest):
            exact = message.kind in KINDS_WITH_RATES
            return _Mismatch(signature, self._difference(message), exact)
        self._plain_messages = 0
        return message

    def _follow_repair(self, digest: int) -> bool:
        """The peer has another digest; return whether it fits now."""
        if digest == self._digests[True]:
            # This end did without repair for a peer before.
            self.repair = True
        elif digest == self._digests[False] and self._configuration.repair == "auto":
            self._plain_messages += 1
            self.repair = self._plain_messages < _PLAIN_MESSAGES
        return digest == self.digest

    def _repeated(self, signature: tuple[int, ...]) -> bool:
        """Whether this is the same as last time; once may be an error that the FECF missed."""
        repeated = signature == self._suspect
        self._suspect = signature
        return repeated

    def _refuse(self, mismatch: _Mismatch) -> None:
        if mismatch.exact or self.refusal is None or mismatch.signature != self._refused:
            self.refusal, self._refused = mismatch.why, mismatch.signature

    def _accept(self, message: SupervisionMessage, now_ns: int) -> MessageVerdict:
        verdict = MessageVerdict.FITS
        if self.meet(message.boot_id):
            verdict = MessageVerdict.MET
        self.message_ns = now_ns
        if message.kind is MessageKind.HELLO:
            # It does not say which life it hears; an answer does (`handle_answer`).
            self.peer = message
            self.hears = self.hears and message.signal
            return verdict
        self.peer = message
        self._asked = message.kind is MessageKind.CONFIGURE
        self.hears = hears = message.signal and message.heard == self._boot_id
        told = MessageKind.CONFIRM if self._master else MessageKind.CONFIGURE
        if hears and message.kind is told:
            self.agreed = True
        # The peer hears its master, and nothing prevents it from confirming.
        waiting = message.state in (LinkState.SEARCH, LinkState.CONFIGURE)
        if not (self._master and hears and waiting):
            self._unanswered_ns, self._timeout = None, 1
        elif self._unanswered_ns is None:
            self._unanswered_ns = now_ns
        return verdict
