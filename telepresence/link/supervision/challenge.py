"""Challenges by which a peer proves that it is there.

A stream of frames that this end does not follow may be a peer that has restarted, or a stray, an
old recording, a guess. So this end asks by a HELLO with a number that it has never sent before.
Only an echo of it makes the stream the peer's (`Supervisor.handle_unknown_sender`).
They are no signature: who reads both ways can answer as well as the peer.
"""

from random import Random

from kontur_av.clock import NS_PER_MS
from telepresence.link.supervision.message import (
    NUMBER_BITS,
    SupervisionMessage,
    SupervisionTiming,
)

#: With a peer, unknown senders are challenged at this interval, and no longer than this after
#: their last frame.
_ASK_NS = 100 * NS_PER_MS


class Proof:
    """The challenges of this end, and whether the peer has answered one.

    seed: of the numbers; nobody else may know it.
    proven: the stream that is followed has echoed a number.
    """

    def __init__(self, seed: int, timing: SupervisionTiming) -> None:
        self.proven = False
        self._random = Random(seed)
        #: A number may be asked for a round trip, and its echo may take another.
        self._life_ns = timing.round_trip_ns
        self._number = self._last = 0
        self._drawn_ns = 0

    def number(self, now_ns: int) -> int:
        """The number to ask for now."""
        age_ns = now_ns - self._drawn_ns
        if not self._number or age_ns >= self._life_ns:
            self._last = self._number if age_ns < 2 * self._life_ns else 0
            self._number = 1 + self._random.randrange((1 << NUMBER_BITS) - 1)
            self._drawn_ns = now_ns
        return self._number

    def answers(self, echo: int, now_ns: int) -> bool:
        """Whether `echo` answers a question that is not too old. Each question counts once."""
        age_ns = now_ns - self._drawn_ns
        if not echo or not (
            (echo == self._number and age_ns < 2 * self._life_ns)
            or (echo == self._last and age_ns < self._life_ns)
        ):
            return False
        self._number = self._last = 0
        return True


class HelloSchedule:
    """When to send a HELLO out of turn: to challenge an unknown sender, or to answer a challenge.

             ┌─handle_candidate─> DUE (`_ASK_NS` after the last challenge) ─┐
        IDLE ┼─handle_challenge─> DUE (paced: answered before, or settled) ─┼─handle_sent─> IDLE
             └─handle_challenge─> PROMPT (a first answer)                  ─┘

    Of two causes the earlier counts. PROMPT keeps a distance only to other first answers.

    challenge: the number to echo, which came last; 0 without any.
    """

    def __init__(self, timing: SupervisionTiming, now_ns: int) -> None:
        self.challenge = 0
        self._timing = timing
        #: The number that was echoed last.
        self._echoed = 0
        self._due_ns: int | None = None
        self._prompt = False
        #: When the last HELLO was sent, the last challenge, the last first answer; and when a frame
        #: came of an unknown sender that may be the peer.
        self._sent_ns = self._asked_ns = self._answered_ns = now_ns - timing.silence_ns
        self._candidate_ns = self._sent_ns

    def handle_candidate(self, now_ns: int, *, alone: bool) -> bool:
        """An unknown sender may be the peer. Return whether a HELLO has become due.

        alone: without a signal every message is a HELLO.
        """
        self._candidate_ns = now_ns
        if alone or self._due_ns is not None:
            return False
        self._due_ns = self._asked_ns + _ASK_NS
        return True

    def handle_challenge(self, number: int, now_ns: int, *, settled: bool) -> None:
        """Answer at once, but not so often that the answers take the packets' place.

        settled: the peer is known, so nobody waits for the answer.
        """
        self.challenge = number
        if settled or number == self._echoed:
            due_ns = max(now_ns, self._sent_ns + self._timing.fast_ns)
        else:
            # Both ends wait for this answer: it need not keep the distance to other messages.
            due_ns = max(now_ns, self._answered_ns + self._timing.spacing_ns)
            self._prompt = True
        self._due_ns = due_ns if self._due_ns is None else min(self._due_ns, due_ns)

    def handle_met(self, now_ns: int) -> None:
        """The unknown sender is followed."""
        self._candidate_ns = now_ns - _ASK_NS

    def handle_sent(self, hello: SupervisionMessage, now_ns: int) -> None:
        if self._prompt:
            self._answered_ns = now_ns
        self._due_ns, self._prompt = None, False
        self._sent_ns, self._echoed = now_ns, hello.echo
        if hello.number:
            self._asked_ns = now_ns

    def asks(self, now_ns: int) -> bool:
        """Whether there is an unknown sender to challenge."""
        return now_ns - self._candidate_ns < _ASK_NS

    def next_ns(self, earliest_ns: int) -> int | None:
        """When to send a HELLO, or None. earliest_ns: no message that keeps its distance before."""
        if self._due_ns is None or self._prompt:
            return self._due_ns
        return max(self._due_ns, earliest_ns)

    def is_next(self, now_ns: int, *, regular: bool) -> bool:
        """Whether a HELLO is due.

        regular: so is a regular message, which goes before a repeated answer.
        """
        if self._due_ns is None or now_ns < self._due_ns:
            return False
        return not (regular and self.challenge == self._echoed)
